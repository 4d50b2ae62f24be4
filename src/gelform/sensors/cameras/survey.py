"""Modes that a camera's driver offers (Video4Linux2), and its measured frame rate."""

from __future__ import annotations

import os
import struct
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from gelform.errors import GelformError
from gelform.sensors.cameras.camera import Camera
from gelform.sensors.cameras.usb import UsbCamera
from gelform.sensors.grabber import Grabber

CAPTURE, DISCRETE = 1, 1  # from linux/videodev2.h
MAX_ENTRIES = 64  # entries of one list; a faulty driver may never end it
# (request, size of the answer in bytes, offset of the index)
FORMATS, SIZES, INTERVALS = (0xC0405602, 64), (0xC02C564A, 44), (0xC034564B, 52)

Ask = Callable[[int, bytearray], object]
MEASURED_S, FIRST_S = 1.0, 3.0  # s: time in which frames are counted; longest wait for the first frame


@dataclass(frozen=True)
class Mode:
    """A mode of a camera: picture format (four letters, such as MJPG), size (H, W) and rate."""

    fourcc: str
    shape: tuple[int, int]
    rate_hz: float

    def __str__(self) -> str:
        return f"{self.fourcc} {self.shape[0]}x{self.shape[1]} at {self.rate_hz:g} Hz"


def modes_of(path: str) -> list[Mode]:
    """The modes of a camera; empty if the system or the driver does not list them.

    Parameters
    ----------
    path : such as /dev/video0
    """
    try:
        from fcntl import ioctl

        device = os.open(path, os.O_RDWR | os.O_NONBLOCK)
    except (ImportError, OSError):
        return []
    try:
        return list(modes_from_answers(lambda request, buffer: ioctl(device, request, buffer)))
    finally:
        os.close(device)


def modes_from_answers(ask: Ask) -> Iterator[Mode]:
    """Read the modes by `ask(request, buffer)`, which fills its buffer; OSError ends each list."""
    for answer in _answers(ask, FORMATS, struct.pack("<II", 0, CAPTURE)):
        (pixel_format,) = struct.unpack_from("<I", answer, 44)
        fourcc = struct.pack("<I", pixel_format).decode("latin-1").strip()
        for size in _answers(ask, SIZES, struct.pack("<II", 0, pixel_format)):
            kind, width, height = struct.unpack_from("<III", size, 8)
            if kind != DISCRETE:
                continue  # a range of sizes; the cameras of known sensors list each size
            asked = struct.pack("<IIII", 0, pixel_format, width, height)
            for interval in _answers(ask, INTERVALS, asked):
                kind, numerator, denominator = struct.unpack_from("<III", interval, 16)
                if kind == DISCRETE and numerator:
                    yield Mode(fourcc, (height, width), round(denominator / numerator, 3))


def _answers(ask: Ask, request: tuple[int, int], start: bytes) -> Iterator[bytearray]:
    """Each entry of a list; the first four bytes of the request count up."""
    number, size = request
    for index in range(MAX_ENTRIES):
        buffer = bytearray(size)
        buffer[: len(start)] = start
        struct.pack_into("<I", buffer, 0, index)
        try:
            ask(number, buffer)
        except OSError:
            return
        yield buffer


@dataclass(frozen=True)
class Survey:
    """The result of probing a camera.

    Attributes
    ----------
    camera : Camera
    modes : the modes that its driver lists
    rate_hz : measured rate in the mode that gelform uses; None if not measured
    settings : settings read back in that mode
    problem : why the camera could not be opened; empty if it could
    """

    camera: Camera
    modes: tuple[Mode, ...]
    rate_hz: float | None
    settings: dict[str, float | str]
    problem: str = ""


def survey_of(camera: Camera, *, measure: bool = True) -> Survey:
    """Ask a camera's driver for its modes and, unless `measure` is False, count its frames for a second."""
    modes = tuple(modes_of(camera.path))
    if not measure:
        return Survey(camera, modes, None, {})
    try:
        with Grabber(lambda: UsbCamera(camera)) as grabber:
            frame = grabber.newest(-1, FIRST_S)
            if frame is None:
                return Survey(camera, modes, None, grabber.settings, "it opens, but gives no frame")
            time.sleep(MEASURED_S)
            return Survey(camera, modes, grabber.stats.rate_hz, grabber.settings)
    except GelformError as problem:
        return Survey(camera, modes, None, {}, str(problem))
