"""Frames from a video file in RGB, in sequence; one frame at a time is in memory."""

from __future__ import annotations

from collections.abc import Container, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.errors import DataError
from gelform.foundations.checks import check_path
from gelform.image.frame import Frame

VIDEO_SUFFIXES = (".avi", ".mp4", ".mov", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg", ".wmv")
USUAL_RATE_HZ = 25.0  # usual rate of videos and images without time stamps


@dataclass(frozen=True)
class VideoFacts:
    """Facts that a video file states: shape (H, W), frame rate in Hz, number of frames; 0 where unknown."""

    shape: tuple[int, int]
    frame_rate_hz: float
    count: int


class Video:
    """The frames of a video file; each loop over it reads them from the start.

    `for frame in Video("presses.avi")` gives `Frame`s: image (H, W, 3) uint8 RGB, `time_s` from the file's time stamps,
    `index` from 0, `wall_time_ns` 0, because a file does not store its recording time.

    Parameters
    ----------
    path : a file that this build of OpenCV can decode (AVI, MP4, MOV, MKV, WebM ...)

    Raises
    ------
    DataError
        The file is missing, empty or cannot be decoded; in a loop also: its frames end well before the declared number, or
        change their size.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = check_path(path)
        capture = self._opened()
        width, height, rate, count = (
            capture.get(which)
            for which in (
                cv2.CAP_PROP_FRAME_WIDTH,
                cv2.CAP_PROP_FRAME_HEIGHT,
                cv2.CAP_PROP_FPS,
                cv2.CAP_PROP_FRAME_COUNT,
            )
        )
        capture.release()
        rate = float(rate) if np.isfinite(rate) and 0 < rate < 1000 else 0.0
        self.facts = VideoFacts((int(height), int(width)), rate, max(0, int(count)))

    def __iter__(self) -> Iterator[Frame]:
        return self.frames()

    def frames(self, only: Container[int] | None = None) -> Iterator[Frame]:
        """The frames, or those with an index in `only`; the others are not decoded."""
        capture = self._opened()
        index = 0
        try:
            while capture.grab():
                if only is None or index in only:
                    yield self._frame(capture, index)
                index += 1
        finally:
            capture.release()
        if index == 0:
            raise DataError(f"{self.path} has no frame that can be decoded. Record it again, as AVI or MP4.")
        if index < 0.9 * self.facts.count:  # containers may declare a few too many
            raise DataError(
                f"{self.path} ends after {index} of {self.facts.count} frames: truncated or damaged. "
                "Copy or record it again."
            )

    def _frame(self, capture: cv2.VideoCapture, index: int) -> Frame:
        time_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
        if index and not time_s > 0:  # no time stamps: use the frame rate
            time_s = index / (self.facts.frame_rate_hz or USUAL_RATE_HZ)
        return Frame(grabbed_image(capture, f"Frame {index} of {self.path}"), float(time_s), 0, index)

    def _opened(self) -> cv2.VideoCapture:
        if not self.path.is_file():
            raise DataError(f"No video file {self.path}. Check the path.")
        if self.path.stat().st_size == 0:
            raise DataError(f"{self.path} is empty. Copy or record it again.")
        capture = opened_video(self.path)
        if not capture.isOpened():
            raise DataError(
                f"{self.path} cannot be decoded as a video: damaged, or a codec that OpenCV lacks here. "
                "Record it as AVI (MJPG) or MP4."
            )
        return capture


def opened_video(path: Path) -> cv2.VideoCapture:
    """OpenCV's reader of a file, opened or not; DataError for a name that is no UTF-8, on which OpenCV crashes."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise DataError(f"The name of the video {str(path)!a} is no UTF-8. Rename it.") from None
    return cv2.VideoCapture(str(path))


def grabbed_image(capture: cv2.VideoCapture, where: str) -> NDArray[Any]:
    """The grabbed frame, (H, W, 3) RGB; DataError, naming `where`, if it is damaged or not a color image."""
    decoded, pixels = capture.retrieve()
    if not decoded or pixels is None or pixels.ndim != 3 or pixels.shape[2] != 3:
        raise DataError(f"{where} is damaged or no color. Record the video again.")
    return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB))


def is_video(path: str | Path) -> bool:
    """Whether a path has the ending of a video file."""
    return Path(path).suffix.lower() in VIDEO_SUFFIXES
