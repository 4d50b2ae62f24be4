"""Frames from files as a source, at any pace or their own; and the facts of a recording about its camera."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.errors import DataError
from gelform.foundations.checks import check_positive
from gelform.foundations.pictures import FAST_PNG, picture_bytes
from gelform.image.frame import Frame
from gelform.sensors.files import IMAGE_SUFFIXES, USUAL_RATE_HZ, Video, images_of_stack, read_image
from gelform.sensors.pictures import check_declared, image_from_jpeg

FORMAT_VERSION = 1
CALIBRATION, BACKGROUND = "calibration.npz", "background.png"
ATTACHABLE = {
    CALIBRATION: "application/x-npz",
    BACKGROUND: "image/png",
}  # facts that a recording may contain, with their types


@dataclass(frozen=True)
class RecordingFacts:
    """The recorded camera and its settings.

    Attributes
    ----------
    name, serial, settings, rate_hz : as of a `Source`
    calibration_digest : digest of the calibration in use; empty without one
    library_version : gelform's version
    """

    name: str
    serial: str | None = None
    settings: Mapping[str, float | str] = field(default_factory=dict)
    rate_hz: float | None = None
    calibration_digest: str = ""
    library_version: str = ""

    def to_json(self) -> str:
        """All facts as one JSON object."""
        content = {**vars(self), "settings": dict(self.settings), "format_version": FORMAT_VERSION}
        return json.dumps(content)

    @classmethod
    def from_json(cls, text: str, where: str) -> RecordingFacts:
        """The facts that `to_json` wrote; DataError if the text is damaged or of a newer format."""
        try:
            content: dict[str, Any] = json.loads(text)
            version = content.pop("format_version")
            if version > FORMAT_VERSION:
                raise DataError(
                    f"{where} has format version {version}, written by gelform {content.get('library_version')}; this "
                    f"one reads up to {FORMAT_VERSION}. Install that release."
                )
            return cls(**content)
        except (ValueError, TypeError, KeyError, AttributeError) as problem:
            raise DataError(f"{where} is damaged: its facts about the camera cannot be read.") from problem


@dataclass(frozen=True)
class RecordingSummary:
    """Summary of a recording: camera, number of frames, seconds from first to last, whether it was finished."""

    facts: RecordingFacts
    frames: int
    duration_s: float
    finished: bool


def encoded_from_frame(frame: Frame) -> tuple[str, bytes]:
    """("jpeg", the bytes as the camera sent them), or ("png", the pixels without loss)."""
    if frame.encoded is not None:
        return "jpeg", frame.encoded
    return "png", picture_bytes(frame.image, settings=FAST_PNG)


def image_from_encoded(content: bytes, reduction: int, where: str) -> NDArray[np.uint8]:
    """The pixels (H, W, 3) uint8 RGB of the result of `encoded_from_frame`; JPEGs are reduced as the camera's frames were.

    DataError: the bytes are damaged.
    """
    try:
        check_declared(content)
    except ValueError as problem:
        raise DataError(f"{where}: {problem}. It is damaged.") from problem
    if content.startswith(b"\xff\xd8"):
        image = image_from_jpeg(content, reduction)
    else:
        pixels = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR) if content else None
        image = None if pixels is None else np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB), np.uint8)
    if image is None:
        raise DataError(f"{where} is damaged: its picture cannot be decoded.")
    return image


def reduction_in(settings: Mapping[str, float | str]) -> int:
    """The reduction of the camera's JPEGs during decoding."""
    return int(float(settings.get("reduced", 1)))


class Pace:
    """The times of evenly spaced frames; the first time is now."""

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz, self._start_s = rate_hz, time.monotonic()

    def wait_for(self, index: int) -> float:
        """Wait for the time of a frame; return that time, on the clock."""
        return self.wait_until(index / self._rate_hz)

    def wait_until(self, after_s: float) -> float:
        """Wait until `after_s` seconds after the start; return that time, on the clock."""
        due = self._start_s + after_s
        time.sleep(max(0.0, due - time.monotonic()))
        return due

    def next_after(self, index: int) -> int:
        """The next frame that is less than one frame period late: a slow reader gets no old frames."""
        return max(index + 1, int(self.late_s(0.0) * self._rate_hz))

    def late_s(self, after_s: float) -> float:
        """Seconds since the moment `after_s` after the start; negative if it is in the future."""
        return time.monotonic() - self._start_s - after_s


class Playback:
    """Recorded frames.

    Parameters
    ----------
    frames : each call returns the frames from the start
    facts : of the recording camera, as far as they are known
    paced : False: each frame as fast as it can be read, with the file's `time_s`. True: at the original pace, `time_s` on
        the monotonic clock; frames more than one frame period late are skipped
    """

    def __init__(
        self,
        frames: Callable[[], Iterable[Frame]],
        facts: RecordingFacts,
        *,
        paced: bool = False,
    ) -> None:
        self.name, self.serial, self.rate_hz = facts.name, facts.serial, facts.rate_hz
        self.settings = dict(facts.settings)
        self.live = paced
        self._frames = frames
        self._closed = False

    def __iter__(self) -> Iterator[Frame]:
        for frame in self._paced() if self.live else self._frames():
            if self._closed:
                return
            yield frame

    def _paced(self) -> Iterator[Frame]:
        pace, first_s = Pace(self.rate_hz or USUAL_RATE_HZ), None
        for frame in self._frames():
            first_s = frame.time_s if first_s is None else first_s
            after_s = frame.time_s - first_s
            if pace.late_s(after_s) > 1 / (self.rate_hz or USUAL_RATE_HZ) and after_s > 0:
                continue
            time_s = pace.wait_until(after_s)
            yield replace(frame, time_s=time_s, wall_time_ns=frame.wall_time_ns or time.time_ns())

    def close(self) -> None:
        """End the loop over this source."""
        self._closed = True

    def __enter__(self) -> Playback:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def video_playback(path: Path, *, paced: bool = False) -> Playback:
    """The frames of a video file; DataError if it is no video (see `Video`)."""
    video = Video(path)
    return Playback(lambda: video, facts_of_video(video), paced=paced)


def facts_of_video(video: Video) -> RecordingFacts:
    """What a video file tells of its camera."""
    height, width = map(float, video.facts.shape)
    rate = video.facts.frame_rate_hz or None
    return RecordingFacts(video.path.name, settings={"width": width, "height": height}, rate_hz=rate)


def folder_playback(path: Path, *, rate_hz: float | None = None, paced: bool = False) -> Playback:
    """The images of a folder, ordered by name, or of a file of several images, evenly spaced in time.

    Parameters
    ----------
    path : a folder of images, a TIFF of several pages, or an array (N, H, W, 3) of numpy (`.npy`)
    rate_hz : images per second; 25 by default

    Raises
    ------
    DataError
        The folder contains no image; in a loop: an image cannot be read.
    """
    rate = check_positive(rate_hz or USUAL_RATE_HZ, "rate_hz")
    frame, count = images_by_number(path, rate)
    facts = RecordingFacts(path.resolve().name, rate_hz=rate)
    return Playback(lambda: map(frame, range(count)), facts, paced=paced)


def images_by_number(path: Path, rate_hz: float) -> tuple[Callable[[int], Frame], int]:
    """(number -> frame, number of frames) of a folder's images, ordered by name, or of a file's; DataError for none."""
    if path.is_file():
        image, count = images_of_stack(path)
        return lambda number: Frame(image(number), number / rate_hz, 0, number), count
    files = sorted(file for file in path.iterdir() if file.suffix.lower() in IMAGE_SUFFIXES)
    if not files:
        raise DataError(f"Expected images ({', '.join(IMAGE_SUFFIXES)}) in the folder {path}, got none.")
    return lambda number: Frame(read_image(files[number]), number / rate_hz, 0, number), len(files)
