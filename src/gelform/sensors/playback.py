"""Frames from files as a source: as fast as they can be read, or at their original pace."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from gelform.errors import DataError
from gelform.foundations.checks import check_positive
from gelform.image.frame import Frame
from gelform.sensors.files import IMAGE_SUFFIXES, images_of_stack, read_image
from gelform.sensors.recordings.facts import RecordingFacts
from gelform.sensors.video_files import USUAL_RATE_HZ, Video


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
