"""Lists the connected cameras and chooses one by its serial number, else its name, else its path."""

from __future__ import annotations

import os
import re
import stat
import sys
import unicodedata
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2

from gelform.errors import SensorError
from gelform.sensors.profiles import SENSORS

NOTHING_THERE = (
    'No camera is plugged in. Plug one in, look at its cable, or take "simulated", which needs none. A camera of another '
    "machine is reached by its address (http://...)."
)
CLASS, BY_PATH = "sys/class/video4linux", "dev/v4l/by-path"


@dataclass(frozen=True)
class Camera:
    """A camera as the system lists it.

    Attributes
    ----------
    name : the name that the camera reports
    path : opens the camera: /dev/video0, or its number on systems without paths
    serial : serial number of the USB device; None if it has none
    usb_id : vendor and product, such as "0c45:636d"; None if it is not on USB
    by_path : path named after the USB socket; None if the system has none
    kind : its row of `SENSORS`; None for a camera of no known sensor
    """

    name: str
    path: str
    serial: str | None = None
    usb_id: str | None = None
    by_path: str | None = None
    kind: str | None = None

    def described(self) -> str:
        """Name, serial and path for a list."""
        serial = f"serial {self.serial}" if self.serial else "no serial"
        return f"{self.name} ({serial}, {self.path}{f', {self.by_path}' if self.by_path else ''})"


def chosen_camera(spec: str, cameras: Sequence[Camera]) -> Camera:
    """Choose one camera.

    Parameters
    ----------
    spec : a serial number; else a name, a part of one in any case, or a row of `SENSORS` such as "digit"; else a path, also
        the one by USB socket. Empty: the only camera
    cameras : the connected cameras

    Raises
    ------
    SensorError
        No camera or several match; the message lists the connected ones.
    """
    if not cameras:
        raise SensorError(NOTHING_THERE if not spec else f"{_none_named(spec)} {NOTHING_THERE}")
    if not spec:
        return _only(list(cameras), "Several cameras are plugged in", cameras)
    folded = spec.casefold()
    for matches in (
        [camera for camera in cameras if camera.serial == spec],
        [camera for camera in cameras if camera.name == spec],
        [camera for camera in cameras if camera.kind == folded or folded in camera.name.casefold()],
        [camera for camera in cameras if spec in (camera.path, camera.by_path)],
    ):
        if matches:
            return _only(matches, f"Several cameras answer to {spec!r}", cameras)
    said = almost(spec, (camera.serial for camera in cameras))
    raise SensorError(f"{_none_named(spec)}{said} Plugged in: {listed_cameras(cameras)}.")


def almost(word: str, serials: Iterable[str | None]) -> str:
    """A sentence about a serial that differs from a word only in what the eye does not see or takes for equal, or ""."""
    for serial in serials:
        if serial and serial != word and _folded(serial) == _folded(word):
            return (
                f" The serial {serial!a} differs from {word!a} in capitals, or in how its letters are coded, and "
                "serials are compared letter by letter."
            )
    return ""


def _folded(serial: str) -> str:
    return unicodedata.normalize("NFKC", serial).casefold().strip()


def listed_cameras(cameras: Sequence[Camera]) -> str:
    """All cameras, as the end of a sentence."""
    return "; ".join(camera.described() for camera in cameras)


def _none_named(spec: str) -> str:
    """A hint for a name that may be a file's."""
    return f"No camera {spec!r}, and no file or folder of that name."


def _only(matches: list[Camera], several: str, cameras: Sequence[Camera]) -> Camera:
    if len(matches) == 1:
        return matches[0]
    serials = [camera.serial for camera in matches]
    unique = None not in serials and len(set(serials)) == len(serials)
    by = "serial" if unique else "path (the one by its socket stays the same)"
    raise SensorError(f"{several}: name one by its {by}. Plugged in: {listed_cameras(cameras)}.")


def cameras_in_sysfs(root: Path = Path("/")) -> list[Camera]:
    """The cameras of this machine, ordered by number.

    Parameters
    ----------
    root : the folder that contains sys and dev
    """
    entries = [entry for entry in (root / CLASS).glob("video*") if _text(entry / "index") in ("0", None)]
    by_path = _links(root)
    return [_camera(entry, by_path) for entry in sorted(entries, key=_number)]


def _camera(entry: Path, by_path: dict[str, str]) -> Camera:
    """The camera of an entry in sysfs and its USB device."""
    usb = _usb_device(entry)
    vendor, product = (_text(usb / name) if usb else None for name in ("idVendor", "idProduct"))
    usb_id = f"{vendor}:{product}" if vendor and product else None
    name = (_text(usb / "product") if usb else None) or _text(entry / "name") or entry.name
    return Camera(
        name=name,
        path=f"/dev/{entry.name}",
        serial=(_text(usb / "serial") if usb else None) or None,
        usb_id=usb_id,
        by_path=by_path.get(entry.name),
        kind=kind_of(usb_id),
    )


def kind_of(usb_id: str | None) -> str | None:
    """The known sensor with this USB id."""
    known = (name for name, row in SENSORS.items() if row.camera is not None and row.camera.usb_id == usb_id)
    return next(known, None)


def _usb_device(entry: Path) -> Path | None:
    """The folder of the USB device: the nearest one above the entry's device that has idVendor."""
    device = (entry / "device").resolve()
    return next((folder for folder in (device, *device.parents[:3]) if (folder / "idVendor").is_file()), None)


def _links(root: Path) -> dict[str, str]:
    """Map from videoN to its path by USB socket."""
    folder = root / BY_PATH
    links = sorted(folder.iterdir()) if folder.is_dir() else []
    return {link.resolve().name: f"/{BY_PATH}/{link.name}" for link in reversed(links)}


def _number(entry: Path) -> int:
    digits = re.search(r"\d+$", entry.name)
    return int(digits.group()) if digits else 0


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
    return [Camera(f"camera {number}", str(number)) for number in range(4) if _opens(number)]


def _opens(number: int) -> bool:
    capture = cv2.VideoCapture(number)
    try:
        return bool(capture.isOpened())
    finally:
        capture.release()


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
