"""USB cameras: list them, choose one, set its controls, and read its frames, from BGR to RGB here."""

from __future__ import annotations

import errno
import math
import os
import re
import stat
import sys
import threading
import time
import unicodedata
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from gelform.arrays import Array
from gelform.errors import SensorError, SourceLostError
from gelform.image.view import Frame
from gelform.sensors.pictures import MAX_TORN, image_from_jpeg, reduction_of
from gelform.sensors.playback import Closing, FrameReader
from gelform.sensors.profiles import SENSORS, KnownCamera

NOTHING_THERE = (
    'No camera is plugged in. Plug one in, look at its cable, or take "simulated", which needs none. A camera of another '
    "machine is reached by its address (http://...)."
)


@dataclass(frozen=True)
class Camera:
    """A camera as the system lists it."""

    name: str  # that the camera reports
    path: str  # opens the camera: /dev/video0, or its number on systems without paths
    serial: str | None = None  # of the USB device; None if it has none
    usb_id: str | None = None  # vendor and product, such as "0c45:636d"; None if it is not on USB
    by_path: str | None = None  # path named after the USB socket; None if the system has none
    kind: str | None = None  # its row of `SENSORS`; None for a camera of no known sensor

    def described(self) -> str:
        """Name, serial and path for a list."""
        serial = f"serial {self.serial}" if self.serial else "no serial"
        return f"{self.name} ({serial}, {self.path}{f', {self.by_path}' if self.by_path else ''})"


def chosen_camera(spec: str, cameras: Sequence[Camera]) -> Camera:
    """The one of the connected cameras that `spec` means.

    A serial number; else a name; else the number of a device, if it is digits alone; else a part of a name in any case, of
    three letters or more, or a row of `SENSORS` such as "digit"; else a path, also the one by USB socket. Empty: the only
    camera.

    SensorError: no camera or several match; the message lists the connected ones.
    """
    none = f"No camera {spec!r}, and no file or folder of that name."
    if not cameras:
        raise SensorError(NOTHING_THERE if not spec else f"{none} {NOTHING_THERE}")
    folded, answer = spec.casefold(), f"Several cameras answer to {spec!r}"
    is_number = spec.isascii() and spec.isdecimal()
    is_part = folded if len(spec) > 2 and not is_number else "\0"  # which no name has
    for several, matches in (
        ("Several cameras are plugged in", [camera for camera in cameras if not spec]),
        (answer, [camera for camera in cameras if camera.serial == spec]),
        (answer, [camera for camera in cameras if camera.name == spec]),
        (answer, [camera for camera in cameras if is_number and camera.path == path_of_number(spec)]),
        (
            answer,
            [camera for camera in cameras if camera.kind == folded or is_part in camera.name.casefold()],
        ),
        (answer, [camera for camera in cameras if spec in (camera.path, camera.by_path)]),
    ):
        if len(matches) == 1:
            return matches[0]
        if matches:
            serials = [camera.serial for camera in matches]
            unique = None not in serials and len(set(serials)) == len(serials)
            by = "serial" if unique else "path (the one by its socket stays the same)"
            raise SensorError(f"{several}: name one by its {by}. Plugged in: {listed_cameras(cameras)}.")
    said = almost(spec, (camera.serial for camera in cameras))
    raise SensorError(f"{none}{said} Plugged in: {listed_cameras(cameras)}.")


def path_of_number(number: str) -> str:
    """The path of the camera with the system's number, "0", "1", ..."""
    plain = number.lstrip("0") or "0"
    return f"/dev/video{plain}" if sys.platform.startswith("linux") else plain


def almost(word: str, serials: Iterable[str | None]) -> str:
    """A sentence about a serial that differs from a word only in what the eye does not see or takes for equal, or ""."""

    def folded(serial: str) -> str:
        return unicodedata.normalize("NFKC", serial).casefold().strip()

    for serial in serials:
        if serial and serial != word and folded(serial) == folded(word):
            return (
                f" The serial {serial!a} differs from {word!a} in capitals, or in how its letters are coded, and "
                "serials are compared letter by letter."
            )
    return ""


def listed_cameras(cameras: Sequence[Camera]) -> str:
    """All cameras, as the end of a sentence."""
    return "; ".join(camera.described() for camera in cameras)


def cameras_in_sysfs(root: Path = Path("/")) -> list[Camera]:
    """The cameras of this machine, ordered by number; `root` contains sys and dev."""
    by_path = root / "dev/v4l/by-path"
    links = sorted(by_path.iterdir()) if by_path.is_dir() else []
    sockets = {link.resolve().name: f"/dev/v4l/by-path/{link.name}" for link in reversed(links)}
    entries = (root / "sys/class/video4linux").glob("video*")
    first = [entry for entry in entries if _text(entry / "index") in ("0", None)]  # others hold its metadata
    first.sort(key=lambda entry: list(map(int, re.findall(r"\d+$", entry.name))))
    return [_camera(entry, sockets.get(entry.name)) for entry in first]


def _camera(entry: Path, socket: str | None) -> Camera:
    """The camera of an entry in sysfs and of its USB device, the nearest folder above that has idVendor."""
    device = (entry / "device").resolve()
    above = (device, *device.parents[:3])
    usb = next((folder for folder in above if (folder / "idVendor").is_file()), None)
    files = ("idVendor", "idProduct", "product", "serial")
    vendor, product, name, serial = (_text(usb / file) if usb else None for file in files)
    usb_id = f"{vendor}:{product}" if vendor and product else None
    name = name or _text(entry / "name") or entry.name
    return Camera(name, f"/dev/{entry.name}", serial or None, usb_id, socket, kind_of(usb_id))


def kind_of(usb_id: str | None) -> str | None:
    """The known sensor with this USB id."""
    known = (name for name, row in SENSORS.items() if row.camera is not None and row.camera.usb_id == usb_id)
    return next(known, None)


def _text(file: Path) -> str | None:
    """The only line of a file; None if the file is missing, or vanishes with its device."""
    try:
        return file.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return None


def cameras_there(root: Path = Path("/")) -> list[Camera]:
    """The cameras of this machine.

    Linux lists them with serial, name and path. On macOS and Windows OpenCV only knows whether camera number n opens. There
    numbers up to 3 are opened for a moment; the cameras are named "camera 0", "camera 1" ..., and their path is the number.
    """
    if sys.platform.startswith("linux"):
        return cameras_in_sysfs(root)
    found = []
    for number in range(4):
        capture = cv2.VideoCapture(number)
        if capture.isOpened():
            found.append(Camera(f"camera {number}", str(number)))
        capture.release()
    return found


def camera_named(spec: str, cameras: list[Camera] | None = None) -> Camera:
    """The camera with this serial, name or path (see `chosen_camera`); a path may also lie outside the list."""
    there = cameras_there() if cameras is None else cameras
    path = Path(spec)
    if spec.startswith("/dev/") and os.path.exists(path):
        real = str(path.resolve())
        listed = next((camera for camera in there if camera.path == real), None)
        if listed is None and not _is_video_device(path):
            raise SensorError(f"{spec} is no camera. Plugged in: {listed_cameras(there) or 'none'}.")
        return listed or Camera(spec, real)
    return chosen_camera(spec, there)


def _is_video_device(path: Path) -> bool:
    """Whether the kernel lists the path as a video device. True where the kernel cannot be asked: opening will show it."""
    if not sys.platform.startswith("linux"):
        return True
    status = path.stat()
    # 81 is the major number of video devices (Documentation/admin-guide/devices.txt of the kernel).
    return stat.S_ISCHR(status.st_mode) and os.major(status.st_rdev) == 81


Settings = Mapping[str, float | str]
# name: (OpenCV's property, the automatic control that must be off)
CONTROLS = {
    "exposure": (cv2.CAP_PROP_EXPOSURE, "auto_exposure"),
    "gain": (cv2.CAP_PROP_GAIN, None),
    "white_balance": (cv2.CAP_PROP_WB_TEMPERATURE, "auto_white_balance"),
}
AUTOMATIC = {"auto_exposure": cv2.CAP_PROP_AUTO_EXPOSURE, "auto_white_balance": cv2.CAP_PROP_AUTO_WB}
OFF = {"auto_exposure": 1.0, "auto_white_balance": 0.0}  # 1: V4L2_EXPOSURE_MANUAL
LED = cv2.CAP_PROP_ZOOM  # of a DIGIT: four bits each for red, green and blue
LED_OF_LEVEL = 0x111  # one brightness step of all three colors
SETTABLE = ("width", "height", "fps", "fourcc", *CONTROLS, "led_level")
COMPARED = ("width", "height", "reduced", "fourcc", *CONTROLS, *AUTOMATIC, "led_level")
UNKNOWN = -1.0  # OpenCV's value of a control that the camera lacks


def check_settings(settings: Settings) -> dict[str, float | str]:
    """Check that settings can be applied; ValueError for an unknown name or a value that is no finite number or format."""
    if not isinstance(settings, Mapping):
        raise TypeError(
            f"Expected settings as a mapping of names to values, got a {type(settings).__name__}."
        )
    unknown = [name for name in settings if name not in SETTABLE]
    if unknown:
        raise ValueError(
            f"Expected settings of a camera among {', '.join(SETTABLE)}, got {', '.join(unknown)}."
        )
    fourcc = str(settings.get("fourcc", "MJPG"))
    if len(fourcc) != 4 or not fourcc.isascii():
        raise ValueError(f"Expected fourcc as four letters, such as MJPG or YUYV, got {fourcc!r}.")
    for name, value in settings.items():
        if name != "fourcc" and not math.isfinite(float(value)):
            raise ValueError(f"Expected {name} as a finite number, got {value}.")
    return {name: str(value) if name == "fourcc" else float(value) for name, value in settings.items()}


def set_controls(capture: cv2.VideoCapture, settings: Settings, led_levels: int, name: str) -> None:
    """Set exposure, gain, white balance and LED level of an open camera of that name, and read each back.

    `led_levels` are the LED steps of the known camera; 0 if its LEDs cannot be set.

    SensorError: the camera lacks a control, or reports another value after setting it.
    """
    for setting, (which, automatic) in CONTROLS.items():
        if setting in settings:
            if automatic is not None:
                capture.set(AUTOMATIC[automatic], OFF[automatic])
            _set(capture, which, float(settings[setting]), setting, name)
    if "led_level" in settings:
        level = float(settings["led_level"])
        if not (led_levels and level == int(level) and 0 <= level <= led_levels):
            allowed = (
                f"a whole number from 0 to {led_levels}" if led_levels else "none: it cannot be set here"
            )
            raise SensorError(f"{name}: expected led_level as {allowed}, got {level:g}.")
        _set(capture, LED, level * LED_OF_LEVEL, "led_level", name)


def controls_of(capture: cv2.VideoCapture, led_levels: int) -> dict[str, float]:
    """The current values of the controls that the camera has."""
    properties = {**{name: which for name, (which, _) in CONTROLS.items()}, **AUTOMATIC}
    found = {name: float(capture.get(which)) for name, which in properties.items()}
    if led_levels:
        found["led_level"] = float(capture.get(LED)) / LED_OF_LEVEL
    return {name: value for name, value in found.items() if value != UNKNOWN}


def settings_mismatch(calibrated: Settings, used: Settings) -> dict[str, tuple[Any, Any]]:
    """Settings in which a camera differs from its calibration: name -> (calibrated, used).

    Parameters
    ----------
    calibrated : from the calibration, `calibration.settings.camera or {}`
    used : from the source, `source.settings`

    Compares the settings that affect colors: size, reduction, picture format, exposure, gain, white balance and LED level. A
    setting counts only if both sides know it: a video does not record its camera's exposure. Empty: no known difference.
    """
    return {
        name: (calibrated[name], used[name])
        for name in COMPARED
        if name in calibrated and name in used and not _same(calibrated[name], used[name])
    }


def calibrated_settings(calibrated: Settings) -> dict[str, float | str]:
    """Settings for `open_source(settings=...)` that restore the camera's state during calibration.

    Parameters
    ----------
    calibrated : from the calibration, `calibration.settings.camera or {}`

    Automatic exposure and white balance are left out, because setting a value would switch them off.
    """
    by_hand = {
        name: automatic is None or calibrated.get(automatic, OFF[automatic]) == OFF[automatic]
        for name, (_, automatic) in CONTROLS.items()
    }
    names = [name for name in SETTABLE if name != "fps" and by_hand.get(name, True)]
    return {name: calibrated[name] for name in names if name in calibrated}


def _set(capture: cv2.VideoCapture, which: int, value: float, setting: str, name: str) -> None:
    accepted = capture.set(which, value)
    found = float(capture.get(which))
    if not accepted or not _same(found, value):
        why = "it lacks this control" if found == UNKNOWN else f"it has {found:g} afterwards"
        raise SensorError(
            f"{name}: expected to set {setting} to {value:g}, but {why}. Choose a value within its range (v4l2-ctl -d "
            "PATH --list-ctrls shows it on Linux)."
        )


def _same(one: float | str, other: float | str) -> bool:
    if isinstance(one, str) or isinstance(other, str):
        return str(one) == str(other)
    return abs(one - other) <= 1e-3 * max(abs(one), abs(other))


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
        if problem.errno == errno.EBUSY:
            raise in_use(camera) from problem
        if problem.errno in (errno.EACCES, errno.EPERM):
            reason = (
                "may not be opened: permission denied. Write this line into /etc/udev/rules.d/60-gelform.rules: "
                f"{udev_rule(camera.usb_id)} Then: sudo udevadm control --reload-rules && sudo udevadm trigger, and plug "
                "the camera in again; or add yourself to the group video."
            )
        elif problem.errno in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
            reason = "is not there any more: it was unplugged. Plug it in again."
        else:
            reason = f"cannot be opened: {problem.strerror}."
        raise SensorError(f"{camera.described()} {reason}") from problem


def in_use(camera: Camera) -> SensorError:
    """The error for a camera that opens but gives no frames, because another program reads them."""
    holders = programs_that_hold(camera.path)
    holders = holders[:4] + ["others"] * (len(holders) > 4)
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


class UsbCamera(Closing, FrameReader):
    """The frames of a USB camera, one of `cameras_there`, with these settings: width, height, fps, fourcc, exposure ...

    A known sensor's camera runs in its usual mode, any other camera in its current mode. Large frames that the camera sends
    as JPEG are decoded at reduced size (see `reduction_of`). `time_s` is the driver's time stamp if it is on the monotonic
    clock.

    SensorError: the camera is missing, access is denied, it is in use, or it rejects a setting.
    """

    live = True

    def __init__(self, camera: Camera, settings: Settings | None = None) -> None:
        wanted = check_settings(settings or {})
        if sys.platform.startswith("linux"):
            check_access(camera)
        known = SENSORS[camera.kind].camera if camera.kind is not None else None
        self._led_levels = known.led_levels if known else 0
        self.camera, self.name, self.serial = camera, camera.name, camera.serial
        self._lock, self._closed = threading.Lock(), False
        self._capture = _opened(camera)
        with ExitStack() as undone:
            undone.callback(self._capture.release)
            _set_mode(self._capture, wanted, known, camera.name)
            set_controls(self._capture, wanted, self._led_levels, camera.name)
            self.settings = self._read_back()
            undone.pop_all()  # everything is set; the camera stays open
        rate = self._capture.get(cv2.CAP_PROP_FPS)
        self.rate_hz: float | None = float(rate) if rate > 0 else None

    def _frames(self) -> Iterator[Frame]:
        index, torn = -1, 0
        while not self._closed:
            with self._lock:
                grabbed = not self._closed and self._capture.grab()
                now_s, wall_time_ns = time.monotonic(), time.time_ns()
                stamp_s = float(self._capture.get(cv2.CAP_PROP_POS_MSEC)) / 1000
                pixels = self._capture.retrieve()[1] if grabbed else None
            if self._closed:
                return
            if not grabbed:
                raise SourceLostError(f"{self.name} gives no frame: it was unplugged, or hangs.")
            index += 1
            time_s = stamp_s if 0 <= now_s - stamp_s < 5 else now_s  # an older stamp is of another clock
            frame = self._frame(pixels, time_s, wall_time_ns, index)
            torn = torn + 1 if frame is None else 0
            if torn > MAX_TORN:
                raise SourceLostError(f"{self.name} gave {torn} torn pictures in a row.")
            if frame is not None:
                yield frame

    def set_controls(self, settings: Settings) -> dict[str, float | str]:
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

    def _frame(self, pixels: Array | None, time_s: float, wall_time_ns: int, index: int) -> Frame | None:
        """The RGB image, decoded if it is a JPEG; None if it is torn."""
        if pixels is None or pixels.size == 0:
            return None
        if not self._undecoded:
            return Frame(np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB)), time_s, wall_time_ns, index)
        content = pixels.tobytes()
        image = image_from_jpeg(content, self._reduction)
        return None if image is None else Frame(image, time_s, wall_time_ns, index, content)

    def _read_back(self) -> dict[str, float | str]:
        """The camera's current settings, once the way of decoding is chosen."""
        capture = self._capture
        shape = int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)), int(capture.get(cv2.CAP_PROP_FRAME_WIDTH))
        fourcc = fourcc_text(capture.get(cv2.CAP_PROP_FOURCC))
        self._reduction = reduction_of(shape) if fourcc == "MJPG" else 1
        self._undecoded = self._reduction > 1 and bool(capture.set(cv2.CAP_PROP_CONVERT_RGB, 0))
        self._reduction = self._reduction if self._undecoded else 1
        facts: dict[str, float | str] = {"width": shape[1], "height": shape[0], "fourcc": fourcc}
        facts |= {"fps": float(capture.get(cv2.CAP_PROP_FPS)), "reduced": self._reduction}
        return facts | controls_of(capture, self._led_levels)


def fourcc_text(code: float) -> str:
    """The four letters of a picture format; empty if there are none."""
    return int(max(0, code)).to_bytes(8, "little")[:4].decode("latin-1").rstrip("\0 ")


def _opened(camera: Camera) -> cv2.VideoCapture:
    is_linux = sys.platform.startswith("linux")
    capture = cv2.VideoCapture(camera.path, cv2.CAP_V4L2) if is_linux else cv2.VideoCapture(int(camera.path))
    if not capture.isOpened():
        raise in_use(camera)
    return capture


def _set_mode(capture: cv2.VideoCapture, wanted: Settings, known: KnownCamera | None, name: str) -> None:
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
