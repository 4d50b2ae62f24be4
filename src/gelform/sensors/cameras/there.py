"""The cameras that are plugged in, on this system."""

from __future__ import annotations

import os
import stat
import sys
from pathlib import Path

import cv2

from gelform.errors import SensorError
from gelform.sensors.cameras.camera import Camera, chosen_camera, listed_cameras
from gelform.sensors.cameras.sysfs import cameras_in_sysfs

VIDEO4LINUX = 81  # major number of the kernel's video devices (Documentation/admin-guide/devices.txt)
LOOKED_AT = 4  # numbers, where the system has no list


def cameras_there(root: Path = Path("/")) -> list[Camera]:
    """The cameras of this machine.

    Linux lists them with serial, name and path. On macOS and Windows OpenCV knows no more than that the n-th camera
    opens: they are called "camera 0", "camera 1" ..., their path is the number, and to know them all are opened for a
    moment.
    """
    if sys.platform.startswith("linux"):
        return cameras_in_sysfs(root)
    return [Camera(f"camera {number}", str(number)) for number in range(LOOKED_AT) if _opens(number)]


def _opens(number: int) -> bool:
    capture = cv2.VideoCapture(number)
    try:
        return bool(capture.isOpened())
    finally:
        capture.release()


def camera_named(spec: str, cameras: list[Camera] | None = None) -> Camera:
    """The camera that a serial, a name or a path means (see `chosen_camera`); a device beside the list by its path."""
    there = cameras_there() if cameras is None else cameras
    path = Path(spec)
    if spec.startswith("/dev/") and path.exists():
        real = str(path.resolve())
        listed = next((camera for camera in there if camera.path == real), None)
        if listed is None and not _is_video_device(path):
            raise SensorError(f"{spec} is no camera. Plugged in: {listed_cameras(there) or 'none'}.")
        return listed or Camera(spec, real)
    return chosen_camera(spec, there)


def _is_video_device(path: Path) -> bool:
    """Whether the kernel calls it one; where it cannot be asked, opening it will tell."""
    if not sys.platform.startswith("linux"):
        return True
    status = path.stat()
    return stat.S_ISCHR(status.st_mode) and os.major(status.st_rdev) == VIDEO4LINUX
