"""The kinds of films, and opening one: folders and files of images, videos, recordings, data sets."""

from __future__ import annotations

import os
from collections.abc import Container, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np

from gelform.errors import DataError, GelformError
from gelform.foundations.checks import check_path, check_positive
from gelform.foundations.files import way_for
from gelform.image.view import Frame
from gelform.sensors.containers import (
    OF_DATA_SETS,
    FilmRef,
    films_inside,
    frames_inside,
    is_container,
    is_data_set,
    values_of,
)
from gelform.sensors.files import (
    FILM_SUFFIXES,
    images_of_stack,
    is_stack,
    is_video,
    read_image,
)
from gelform.sensors.mcap import Recording, is_bag_folder
from gelform.sensors.pictures import IMAGE_SUFFIXES, image_from_values
from gelform.sensors.playback import USUAL_RATE_HZ, Film, RecordingFacts


def open_film(
    path: Path, *, dataset: str = "", rate_hz: float | None = None, bgr: bool = False, scan: bool = False
) -> Film:
    """Open a folder of images, a file of several, a video, a recording (*.mcap, or a rosbag2 folder) or a data set.

    Of an HDF5 file, a Zarr store or a LeRobot data set, the frames that `dataset` names (see `films_inside`) come one film
    after the other. Images come at `rate_hz` per second, or as blue, green, red with `bgr`. With `scan` it is scanned now,
    so that a damaged or empty one is refused.

    DataError: it is missing, damaged, of an unknown kind, or without a frame.
    """
    film: Film
    if is_data_set(path):
        film = Stored(path, films_inside(path, path.name, dataset), rate_hz)
    elif dataset:
        raise DataError(f"{OF_DATA_SETS} ({dataset}); got {path}. Leave it out.")
    elif path.suffix.lower() == ".mcap" or is_bag_folder(path):
        film = Recording(path)
    elif path.is_dir() or is_stack(path):
        film = Images(path, rate_hz)
    elif is_video(path):
        film = Video(path)
    else:
        raise DataError(f"{path} is no video, no folder of images and no recording (*.mcap).{way_for(path)}")
    film.bgr = bgr
    if scan and not film.times_s:
        raise DataError(f"{path} holds no frame.")
    return film


def film_of(listed: FilmRef, most_pixels: float) -> Film:
    """Open a film that was listed; pictures of more pixels are not decoded. Errors as in `open_film`."""
    if listed.dataset:
        film: Film = Stored(listed.path, [listed])
    elif listed.images:
        film = Images(listed.path, names=listed.images)
    else:
        film = open_film(listed.path)
    film.bgr, film.most_pixels = listed.bgr, most_pixels
    return film


def is_film(spec: str) -> bool:
    """Whether a spec is a file or a folder of frames, not a device."""
    return os.path.exists(spec) and not spec.startswith("/dev/")


def films_in(folder: Path) -> list[Path]:
    """The recordings, videos and files of several images in a folder; an array of anything else is none of them."""

    def is_one(path: Path) -> bool:
        try:
            suffix = path.suffix.lower()
            return (
                suffix in FILM_SUFFIXES
                or is_stack(path)
                or (is_container(path) and bool(frames_inside(path)))
            )
        except DataError:  # opening it says why
            return False

    return list(filter(is_one, sorted(folder.iterdir()))) if folder.is_dir() else []


class Images(Film):
    """The images of a folder, ordered by name, or of a file of several images, evenly spaced in time.

    The file is a TIFF of several pages, or an array (N, H, W, 3) of numpy (`.npy`).

    DataError: the folder contains no image; in a loop: an image cannot be read.
    """

    def __init__(self, path: Path, rate_hz: float | None = None, names: Sequence[str] = ()) -> None:
        super().__init__(path, _evenly(path, rate_hz))
        if path.is_file():
            self._image, self.count = images_of_stack(path)
            return
        here = (file.name for file in path.iterdir() if file.suffix.lower() in IMAGE_SUFFIXES)
        files = names or sorted(here)
        if not files:
            raise DataError(f"Expected images ({', '.join(IMAGE_SUFFIXES)}) in the folder {path}, got none.")
        self._image = lambda number: read_image(path / files[number], most_pixels=self.most_pixels)
        self.count = len(files)

    def _each(self, start: int, count: int) -> Iterator[Frame | BaseException]:
        for number in range(start, start + count):
            try:
                yield self._frame(number)
            except (GelformError, MemoryError) as problem:
                yield problem

    def _frame(self, number: int) -> Frame:
        return Frame(self._image(number), self.times_s[number], 0, number)


class Stored(Film):
    """The frames of one film after the other in an HDF5 file, a Zarr store or a LeRobot data set, evenly spaced in time.

    DataError: the data set cannot be read; in a loop: a frame cannot.
    """

    def __init__(self, path: Path, films: Sequence[FilmRef], rate_hz: float | None = None) -> None:
        super().__init__(path, _evenly(path, films[0].rate_hz or rate_hz))
        self._films, self.count = films, sum(film.count for film in films)
        self._ahead: Iterator[Frame | BaseException] = iter(())
        self._next = -1  # number of the first frame ahead: the next one is not looked for

    def _each(self, start: int, count: int) -> Iterator[Frame | BaseException]:
        """As `each`, with the time that is stored, in its film."""
        number, stop = start, start + count
        for film in self._films:
            begin, end = max(start, 0), min(stop, film.count)
            start, stop = start - film.count, stop - film.count
            if begin >= end and film.count:
                continue
            for time_s, values in values_of(film, begin, end - begin):
                found: Frame | BaseException
                try:
                    found = Frame(image_from_values(values, self.most_pixels), time_s, 0, number)
                except (GelformError, MemoryError) as problem:
                    found = problem
                yield found
                number += 1

    def _frame(self, number: int) -> Frame:
        number = range(self.count)[number]
        ahead = self._ahead if number == self._next else self._each(number, self.count - number)
        self._next = -1
        found = next(ahead)
        self._ahead, self._next = ahead, number + 1
        if isinstance(found, BaseException):
            raise found
        return replace(found, time_s=self.times_s[number])


def _evenly(path: Path, rate_hz: float | None) -> RecordingFacts:
    """The facts of frames without times, which come `rate_hz` per second."""
    rate_hz = check_positive(USUAL_RATE_HZ if rate_hz is None else rate_hz, "rate_hz")
    return RecordingFacts(path.resolve().name, rate_hz=rate_hz)


class Video(Film):
    """The frames of a video file; each loop over it reads them from the start, and `video[number]` gives any.

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

    Most frames of a video are stored as changes against others. OpenCV seeks by time, which is inexact in some files. If
    the frame after a seek has another time than in the first pass, the video is read again from its start.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = check_path(path)
        capture = self._opened()
        sides = {"width": cv2.CAP_PROP_FRAME_WIDTH, "height": cv2.CAP_PROP_FRAME_HEIGHT}
        settings = {side: float(int(capture.get(which))) for side, which in sides.items()}
        rate = float(capture.get(cv2.CAP_PROP_FPS))
        rate_hz = rate if 0 < rate < 1000 else None
        self.count = max(0, int(capture.get(cv2.CAP_PROP_FRAME_COUNT)))
        capture.release()
        super().__init__(self.path, RecordingFacts(self.path.name, settings=settings, rate_hz=rate_hz))

    def _frames(self, only: Container[int] | None = None) -> Iterator[Frame]:
        capture = self._opened()
        index = 0
        try:
            while capture.grab():
                if only is None or index in only:
                    time_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
                    if index and not time_s > 0:  # no time stamps: use the frame rate
                        time_s = index / (self.camera.rate_hz or USUAL_RATE_HZ)
                    yield self._grabbed(capture, float(time_s), index)
                index += 1
        finally:
            capture.release()
        if index == 0:
            raise DataError(f"{self.path} has no frame that can be decoded. Record it again, as AVI or MP4.")
        if index < 0.9 * self.count:  # containers may declare a few too many
            raise DataError(
                f"{self.path} ends after {index} of {self.count} frames: truncated or damaged. "
                "Copy or record it again."
            )

    def _opened(self) -> cv2.VideoCapture:
        if not self.path.is_file():
            raise DataError(f"No video file {self.path}. Check the path.")
        if self.path.stat().st_size == 0:
            raise DataError(f"{self.path} is empty. Copy or record it again.")
        try:
            str(self.path).encode()
        except UnicodeEncodeError:  # on which OpenCV crashes
            raise DataError(f"The name of the video {str(self.path)!a} is no UTF-8. Rename it.") from None
        capture = cv2.VideoCapture(str(self.path))
        if not capture.isOpened():
            raise DataError(
                f"{self.path} cannot be decoded as a video: damaged, or a codec that OpenCV lacks here. "
                "Record it as AVI (MJPG) or MP4."
            )
        return capture

    @cached_property
    def times_s(self) -> Sequence[float]:
        """Time of each frame, counted from the first."""
        self._capture, self._stamps = self._opened(), list[float]()
        while self._capture.grab():
            self._stamps.append(self._capture.get(cv2.CAP_PROP_POS_MSEC))
        self._next = len(self._stamps)
        if self._next >= 2 and np.diff(self._stamps).min() <= 0:  # no time stamps
            rate_hz = self.camera.rate_hz or USUAL_RATE_HZ
            return tuple(number / rate_hz for number in range(self._next))
        return tuple((stamp - self._stamps[0]) / 1000 for stamp in self._stamps)

    def _frame(self, number: int) -> Frame:
        time_s = self.times_s[number]
        if number != self._next:
            self._capture.set(cv2.CAP_PROP_POS_FRAMES, number)
        if not self._is_next(number):  # a seek that missed: from the start
            self._capture.release()
            self._capture = self._opened()
            for _ in range(number):
                self._capture.grab()
            if not self._is_next(number):
                raise DataError(f"Frame {number} of {self.path} cannot be read again.")
        return self._grabbed(self._capture, time_s, number)

    def _is_next(self, number: int) -> bool:
        """Whether the next frame has the time of that number; it is grabbed."""
        self._next = number + 1
        grabbed = self._capture.grab()
        return grabbed and abs(self._capture.get(cv2.CAP_PROP_POS_MSEC) - self._stamps[number]) < 0.5

    def _grabbed(self, capture: cv2.VideoCapture, time_s: float, number: int) -> Frame:
        decoded, pixels = capture.retrieve()
        if not decoded or pixels is None or pixels.ndim != 3 or pixels.shape[2] != 3:
            raise DataError(f"Frame {number} of {self.path} is damaged or no color. Record the video again.")
        return Frame(np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)), time_s, 0, number)
