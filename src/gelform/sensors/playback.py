"""Frames from files as a source: as fast as they are read, or at the pace at which they were taken."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from gelform.errors import DataError
from gelform.foundations.checks import check_positive
from gelform.frames import Frame
from gelform.sensors.files import IMAGE_SUFFIXES, read_image
from gelform.sensors.video_files import USUAL_RATE_HZ, Video


class Pace:
    """The times of evenly spaced frames, the first one now."""

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz, self._start_s = rate_hz, time.monotonic()

    def wait_for(self, index: int) -> float:
        """Wait for the time of a frame; that time, on the clock."""
        return self.wait_until(index / self._rate_hz)

    def wait_until(self, after_s: float) -> float:
        """Wait until so many seconds after the start; that time, on the clock."""
        due = self._start_s + after_s
        time.sleep(max(0.0, due - time.monotonic()))
        return due

    def next_after(self, index: int) -> int:
        """The next frame whose time is not past by a whole frame: a late reader does not get old frames."""
        return max(index + 1, int(self.late_s(0.0) * self._rate_hz))

    def late_s(self, after_s: float) -> float:
        """How long ago the moment `after_s` after the start was, s; negative where it is to come."""
        return time.monotonic() - self._start_s - after_s


class Playback:
    """Frames that were taken before.

    Parameters
    ----------
    frames : gives the frames anew from the start each time it is called
    name : for people
    rate_hz : frames a second, where it is known
    serial, settings : of the camera that took them, where they are known
    paced : False: each frame as fast as it is read, its `time_s` as the file has it. True: at the pace at which they
        were taken, `time_s` on the monotonic clock; frames that come too late by more than one frame are passed over.
    """

    def __init__(
        self,
        frames: Callable[[], Iterable[Frame]],
        *,
        name: str,
        rate_hz: float | None = None,
        serial: str | None = None,
        settings: Mapping[str, float | str] | None = None,
        paced: bool = False,
    ) -> None:
        self.name, self.serial, self.rate_hz = name, serial, rate_hz
        self.settings = dict(settings or {})
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
        """End the loop over it."""
        self._closed = True

    def __enter__(self) -> Playback:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def video_playback(path: Path, *, paced: bool = False) -> Playback:
    """The frames of a video file; DataError where it is none (see `Video`)."""
    video = Video(path)
    height, width = video.facts.shape
    return Playback(
        lambda: video,
        name=path.name,
        rate_hz=video.facts.frame_rate_hz or None,
        settings={"width": width, "height": height},
        paced=paced,
    )


def folder_playback(path: Path, *, rate_hz: float | None = None, paced: bool = False) -> Playback:
    """The images of a folder in the order of their names, evenly spaced in time.

    Parameters
    ----------
    path : a folder of images
    rate_hz : images a second; 25 by default

    Raises
    ------
    DataError
        The folder holds no image; in a loop: one cannot be read.
    """
    rate = check_positive(rate_hz or USUAL_RATE_HZ, "rate_hz")
    frame, count = images_by_number(path, rate)
    return Playback(lambda: map(frame, range(count)), name=path.resolve().name, rate_hz=rate, paced=paced)


def images_by_number(path: Path, rate_hz: float) -> tuple[Callable[[int], Frame], int]:
    """number -> frame of a folder's images in the order of their names, and how many there are; DataError for none."""
    files = sorted(file for file in path.iterdir() if file.suffix.lower() in IMAGE_SUFFIXES)
    if not files:
        raise DataError(f"Expected images ({', '.join(IMAGE_SUFFIXES)}) in the folder {path}, got none.")
    return lambda number: Frame(read_image(files[number]), number / rate_hz, 0, number), len(files)
