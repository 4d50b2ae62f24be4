"""A USB camera through OpenCV, and the reason if it cannot be opened. Frames are converted from BGR to RGB here."""

from __future__ import annotations

import errno
import os
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.errors import SensorError, SourceLostError
from gelform.image.frame import Frame
from gelform.sensors.cameras.camera import Camera
from gelform.sensors.cameras.settings import check_settings, controls_of, set_controls
from gelform.sensors.jpeg import MAX_TORN, image_from_jpeg, reduction_of
from gelform.sensors.profiles import SENSORS, KnownCamera

RULE_FILE = "/etc/udev/rules.d/60-gelform.rules"
NAMED_PROGRAMS = 4  # programs that an error message names at most
JPEG = "MJPG"
SIZE = {  # OpenCV applies a size only when both sides are set
    "width": cv2.CAP_PROP_FRAME_WIDTH,
    "height": cv2.CAP_PROP_FRAME_HEIGHT,
    "fps": cv2.CAP_PROP_FPS,
}


def udev_rule(usb_id: str | None) -> str:
    """A udev rule that lets the user at the machine and the group video use a camera."""
    vendor, _, product = (usb_id or "").partition(":")
    which = f'ATTRS{{idVendor}}=="{vendor}", ATTRS{{idProduct}}=="{product}", ' if product else ""
    return f'SUBSYSTEM=="video4linux", {which}MODE="0660", GROUP="video", TAG+="uaccess"'


def check_access(camera: Camera) -> None:
    """Open the camera's path for a moment.

    SensorError: the camera is missing, access is denied (with the udev rule), or another program uses it (named if known).
    """
    try:
        os.close(os.open(camera.path, os.O_RDWR | getattr(os, "O_NONBLOCK", 0)))
    except OSError as problem:
        raise SensorError(f"{camera.described()} {_reason(camera, problem)}") from problem


def in_use(camera: Camera) -> SensorError:
    """The error for a camera that opens but gives no frames, because another program reads them."""
    holders = programs_that_hold(camera.path)
    holders = holders[:NAMED_PROGRAMS] + ["others"] * (len(holders) > NAMED_PROGRAMS)
    who = f"by {', '.join(holders)}" if holders else "by another program"
    return SensorError(
        f"{camera.described()} is in use {who}, or has no picture format that OpenCV reads. Close the other program; one "
        "Grabber serves several consumers."
    )


def programs_that_hold(path: str) -> list[str]:
    """Names and process ids of other programs that have the file open, as far as this user may see."""
    target, found = os.path.realpath(path), []
    for process in sorted(Path("/proc").glob("[0-9]*")):
        if process.name == str(os.getpid()):
            continue
        try:
            if any(os.readlink(link) == target for link in (process / "fd").iterdir()):
                found.append(f"{(process / 'comm').read_text().strip()} (process {process.name})")
        except OSError:
            continue  # another user's process, or it has ended
    return found


def _reason(camera: Camera, problem: OSError) -> str:
    if problem.errno in (errno.EACCES, errno.EPERM):
        return (
            f"may not be opened: permission denied. Write this line into {RULE_FILE}: {udev_rule(camera.usb_id)} "
            "Then: sudo udevadm control --reload-rules && sudo udevadm trigger, and plug the camera in again; or add "
            "yourself to the group video."
        )
    if problem.errno in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
        return "is not there any more: it was unplugged. Plug it in again."
    if problem.errno == errno.EBUSY:
        return str(in_use(camera)).removeprefix(f"{camera.described()} ")
    return f"cannot be opened: {problem.strerror}."


class UsbCamera:
    """The frames of a USB camera.

    A known sensor's camera runs in its usual mode, any other camera in its current mode. Large frames that the camera sends
    as JPEG are decoded at reduced size (see `reduction_of`). `time_s` is the driver's time stamp if it is on the monotonic
    clock.

    Parameters
    ----------
    camera : one of `cameras_there`
    settings : the values to set: width, height, fps, fourcc, exposure, gain, white_balance, led_level

    Raises
    ------
    SensorError
        The camera is missing, access is denied, it is in use, or it rejects a setting.
    """

    live = True

    def __init__(self, camera: Camera, settings: Mapping[str, float | str] | None = None) -> None:
        wanted = check_settings(settings or {})
        if sys.platform.startswith("linux"):
            check_access(camera)
        known = SENSORS[camera.kind].camera if camera.kind is not None else None
        self._led_levels = known.led_levels if known else 0
        self.camera, self.name = camera, camera.name
        self.serial = camera.serial
        self._lock = threading.Lock()
        self._closed = False
        self._capture = _opened(camera)
        with ExitStack() as undone:
            undone.callback(self._capture.release)
            _set_mode(self._capture, wanted, known, camera.name)
            set_controls(self._capture, wanted, self._led_levels, camera.name)
            self.settings = self._read_back(known)
            undone.pop_all()  # everything is set; the camera stays open
        rate = self._capture.get(cv2.CAP_PROP_FPS)
        self.rate_hz: float | None = float(rate) if rate > 0 else None

    def __iter__(self) -> Iterator[Frame]:
        index, torn = -1, 0
        while not self._closed:
            with self._lock:
                grabbed = not self._closed and self._capture.grab()
                time_s, wall_time_ns = self._captured_s(), time.time_ns()
                pixels = self._capture.retrieve()[1] if grabbed else None
            if self._closed:
                return
            if not grabbed:
                raise SourceLostError(f"{self.name} gives no frame: it was unplugged, or hangs.")
            index += 1
            frame = self._frame(pixels, time_s, wall_time_ns, index)
            torn = torn + 1 if frame is None else 0
            if torn > MAX_TORN:
                raise SourceLostError(f"{self.name} gave {torn} torn pictures in a row.")
            if frame is not None:
                yield frame

    def set_controls(self, settings: Mapping[str, float | str]) -> dict[str, float | str]:
        """Set exposure, gain, white_balance or led_level between two frames; return all settings as read back.

        SensorError: the camera lacks a control, reports another value after setting it, or is closed.
        """
        wanted = check_settings(settings)
        with self._lock:
            if self._closed:
                raise SensorError(f"{self.name} is closed.")
            try:
                set_controls(self._capture, wanted, self._led_levels, self.name)
            finally:
                self.settings = {**self.settings, **controls_of(self._capture, self._led_levels)}
            return self.settings

    def close(self) -> None:
        """Release the camera after the frame that is being read."""
        self._closed = True
        with self._lock:
            self._capture.release()

    def __enter__(self) -> UsbCamera:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _frame(
        self, pixels: NDArray[Any] | None, time_s: float, wall_time_ns: int, index: int
    ) -> Frame | None:
        """The RGB image, decoded if it is a JPEG; None if it is torn."""
        if pixels is None or pixels.size == 0:
            return None
        if not self._undecoded:
            return Frame(np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)), time_s, wall_time_ns, index)
        content = pixels.tobytes()
        image = image_from_jpeg(content, self._reduction)
        return None if image is None else Frame(image, time_s, wall_time_ns, index, content)

    def _captured_s(self) -> float:
        """The driver's time stamp; the current time if it is more than 5 s old, of another clock."""
        now = time.monotonic()
        stamp = float(self._capture.get(cv2.CAP_PROP_POS_MSEC)) / 1000
        return stamp if 0 <= now - stamp < 5 else now

    def _read_back(self, known: KnownCamera | None) -> dict[str, float | str]:
        """The camera's current settings, once the way of decoding is chosen."""
        capture = self._capture
        shape = int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)), int(capture.get(cv2.CAP_PROP_FRAME_WIDTH))
        fourcc = fourcc_text(capture.get(cv2.CAP_PROP_FOURCC))
        self._reduction = reduction_of(shape) if fourcc == JPEG else 1
        self._undecoded = self._reduction > 1 and bool(capture.set(cv2.CAP_PROP_CONVERT_RGB, 0))
        self._reduction = self._reduction if self._undecoded else 1
        facts: dict[str, float | str] = {"width": shape[1], "height": shape[0], "fourcc": fourcc}
        facts |= {"fps": float(capture.get(cv2.CAP_PROP_FPS)), "reduced": self._reduction}
        return facts | controls_of(capture, self._led_levels)


def fourcc_text(code: float) -> str:
    """The four letters of a picture format; empty if there are none."""
    number = int(code) if code > 0 else 0
    return number.to_bytes(8, "little")[:4].decode("latin-1").rstrip("\0 ")


def _opened(camera: Camera) -> cv2.VideoCapture:
    if sys.platform.startswith("linux"):
        capture = cv2.VideoCapture(camera.path, cv2.CAP_V4L2)
    else:
        capture = cv2.VideoCapture(int(camera.path))
    if not capture.isOpened():
        raise in_use(camera)
    return capture


def _set_mode(
    capture: cv2.VideoCapture, wanted: Mapping[str, float | str], known: KnownCamera | None, name: str
) -> None:
    """Set picture format, size and rate: the given ones, else the usual ones of a known camera."""
    mode: dict[str, float | str] = {}
    if known is not None:
        height, width = known.frame_shape
        mode = {"fourcc": known.fourcc, "height": height, "width": width, "fps": known.rate_hz}
    mode |= {key: value for key, value in wanted.items() if key in ("fourcc", *SIZE)}
    if "fourcc" in mode:
        capture.set(cv2.CAP_PROP_FOURCC, float(cv2.VideoWriter.fourcc(*str(mode["fourcc"]))))
    for key, which in SIZE.items():
        if key in mode:
            capture.set(which, float(mode[key]))
    for key, which in SIZE.items():
        found = float(capture.get(which))
        if key in wanted and abs(found - float(wanted[key])) > 0.5:
            raise _other_mode(name, key, f"{float(wanted[key]):g}", f"{found:g}")
    fourcc = fourcc_text(capture.get(cv2.CAP_PROP_FOURCC))
    if wanted.get("fourcc", fourcc) != fourcc:
        raise _other_mode(name, "fourcc", wanted["fourcc"], fourcc)


def _other_mode(name: str, key: str, wanted: float | str, found: str) -> SensorError:
    return SensorError(
        f"{name}: expected {key} {wanted}, but it has {found} afterwards. Choose a mode that it offers "
        "(v4l2-ctl -d PATH --list-formats-ext shows them on Linux)."
    )
