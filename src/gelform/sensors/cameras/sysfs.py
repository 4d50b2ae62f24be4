"""Cameras as Linux lists them below /sys/class/video4linux.

A camera has several entries there: pictures come from the one whose `index` is 0, the others hold metadata. `device`
points to the interface of the USB device, whose own folder, one above it, holds idVendor, idProduct, serial and product.
"""

from __future__ import annotations

import re
from pathlib import Path

from gelform.sensors.cameras.camera import Camera
from gelform.sensors.profiles import SENSORS

CLASS, BY_PATH = "sys/class/video4linux", "dev/v4l/by-path"


def cameras_in_sysfs(root: Path = Path("/")) -> list[Camera]:
    """The cameras of this machine, in the order of their numbers.

    Parameters
    ----------
    root : the folder that holds sys and dev
    """
    entries = [entry for entry in (root / CLASS).glob("video*") if _text(entry / "index") in ("0", None)]
    by_path = _links(root)
    return [_camera(entry, by_path) for entry in sorted(entries, key=_number)]


def _camera(entry: Path, by_path: dict[str, str]) -> Camera:
    """What the entry and its USB device say."""
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
    """The known sensor of that USB id."""
    known = (name for name, row in SENSORS.items() if row.camera is not None and row.camera.usb_id == usb_id)
    return next(known, None)


def _usb_device(entry: Path) -> Path | None:
    """The folder of the USB device: the nearest one above the entry's device that has idVendor."""
    device = (entry / "device").resolve()
    return next((folder for folder in (device, *device.parents[:3]) if (folder / "idVendor").is_file()), None)


def _links(root: Path) -> dict[str, str]:
    """videoN -> its name by the socket that it is plugged into."""
    folder = root / BY_PATH
    links = sorted(folder.iterdir()) if folder.is_dir() else []
    return {link.resolve().name: f"/{BY_PATH}/{link.name}" for link in reversed(links)}


def _number(entry: Path) -> int:
    digits = re.search(r"\d+$", entry.name)
    return int(digits.group()) if digits else 0


def _text(file: Path) -> str | None:
    """A file's only line; None where it is not there, or went away with the device."""
    try:
        return file.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return None
