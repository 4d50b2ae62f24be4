"""A recording whose frames are at hand by their number, in any order: folders, videos, MCAP files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from gelform.errors import DataError
from gelform.frames import Frame
from gelform.live.replay.indexed_mcap import McapIndex
from gelform.sensors.files import IMAGE_SUFFIXES, read_image
from gelform.sensors.playback import USUAL_RATE_HZ
from gelform.sensors.recordings.facts import RecordingFacts, reduction_in
from gelform.sensors.recordings.image_folder import FACTS, frame_of_row, is_recorded_folder, rows_of
from gelform.sensors.recordings.mcap_reader import is_bag_folder, mcap_file_in
from gelform.sensors.video_files import Video, is_video


@dataclass(frozen=True)
class Indexed:
    """A recording.

    Attributes
    ----------
    path : of the file or folder
    name, serial, settings, rate_hz : as of a `Source`
    times_s : of each frame, counted from the first, growing
    frame : number from 0 -> Frame; DataError where it is damaged
    """

    path: Path
    times_s: tuple[float, ...]
    frame: Callable[[int], Frame]
    name: str
    rate_hz: float | None = None
    serial: str | None = None
    settings: Mapping[str, float | str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.times_s)


def is_recording(spec: str) -> bool:
    """Whether what was asked for is a file or a folder of frames; a device is none."""
    path = Path(spec)
    return path.exists() and not spec.startswith("/dev/")


def indexed(path: Path) -> Indexed:
    """Look through a recording once.

    Raises
    ------
    DataError
        It is missing, damaged, empty, or nothing that frames can be read from.
    """
    found = _indexed(path)
    if not found.times_s:
        raise DataError(f"{path} holds no frame.")
    return found


def _indexed(path: Path) -> Indexed:
    if path.suffix.lower() == ".mcap":
        return _of_mcap(path, path)
    if path.is_dir():
        if is_recorded_folder(path):
            return _of_recorded_folder(path)
        return _of_mcap(path, mcap_file_in(path)) if is_bag_folder(path) else _of_images(path)
    if is_video(path):
        return _of_video(path)
    raise DataError(f"{path} is no video, no folder of images and no recording (*.mcap).")


def _of_mcap(path: Path, file: Path) -> Indexed:
    index = McapIndex(file)
    facts = index.facts
    return Indexed(path, index.times_s, index.frame, facts.name, facts.rate_hz, facts.serial, facts.settings)


def _of_recorded_folder(path: Path) -> Indexed:
    facts = RecordingFacts.from_json((path / FACTS).read_text(encoding="utf-8"), str(path / FACTS))
    rows, reduction = sorted(rows_of(path)), reduction_in(facts.settings)
    return Indexed(
        path,
        tuple(row[0] - rows[0][0] for row in rows),
        lambda number: frame_of_row(path, rows[number], reduction),
        facts.name,
        facts.rate_hz,
        facts.serial,
        facts.settings,
    )


def _of_images(path: Path) -> Indexed:
    files = sorted(file for file in path.iterdir() if file.suffix.lower() in IMAGE_SUFFIXES)
    if not files:
        raise DataError(f"Expected images ({', '.join(IMAGE_SUFFIXES)}) in the folder {path}, got none.")

    def frame(number: int) -> Frame:
        return Frame(read_image(files[number]), number / USUAL_RATE_HZ, 0, number)

    times_s = tuple(number / USUAL_RATE_HZ for number in range(len(files)))
    return Indexed(path, times_s, frame, path.resolve().name, USUAL_RATE_HZ)


def _of_video(path: Path) -> Indexed:
    video = Video(path)
    reel = _Reel(path, video.facts.frame_rate_hz or USUAL_RATE_HZ)
    height, width = video.facts.shape
    settings = {"width": float(width), "height": float(height)}
    return Indexed(
        path, reel.times_s, reel.frame, path.name, video.facts.frame_rate_hz or None, None, settings
    )


class _Reel:
    """Frames of a video in any order.

    Videos hold most frames as changes against others. OpenCV seeks by time, which some files answer inexactly: where the
    frame that comes has another time than the wanted one had in the first pass, the video is read from its start.
    """

    def __init__(self, path: Path, rate_hz: float) -> None:
        self._path, self._rate_hz = path, rate_hz
        self._capture = cv2.VideoCapture(str(path))
        self._stamps: list[float] = []
        while self._capture.grab():
            self._stamps.append(self._capture.get(cv2.CAP_PROP_POS_MSEC))
        self._next = len(self._stamps)
        grows = len(self._stamps) < 2 or float(np.diff(self._stamps).min()) > 0
        first = self._stamps[0] if self._stamps else 0.0
        self.times_s = tuple(
            (stamp - first) / 1000 if grows else number / rate_hz for number, stamp in enumerate(self._stamps)
        )

    def frame(self, number: int) -> Frame:
        if not self._grabbed(number):
            raise DataError(f"Frame {number} of {self._path} cannot be read again.")
        decoded, pixels = self._capture.retrieve()
        if not decoded or pixels is None or pixels.ndim != 3 or pixels.shape[2] != 3:
            raise DataError(f"Frame {number} of {self._path} is damaged or no colour.")
        return Frame(np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)), self.times_s[number], 0, number)

    def _grabbed(self, number: int) -> bool:
        """Whether the frame was reached: as the next one, by a seek, or from the start."""
        if number != self._next:
            self._capture.set(cv2.CAP_PROP_POS_FRAMES, number)
        if self._is_now(number):
            return True
        self._capture.release()
        self._capture = cv2.VideoCapture(str(self._path))
        for _ in range(number):
            self._capture.grab()
        return self._is_now(number)

    def _is_now(self, number: int) -> bool:
        grabbed = self._capture.grab()
        self._next = number + 1
        return grabbed and abs(self._capture.get(cv2.CAP_PROP_POS_MSEC) - self._stamps[number]) < 0.5
