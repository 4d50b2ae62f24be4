"""Why a camera cannot be opened: not there, not allowed, or in use; and the udev rule that allows it."""

from __future__ import annotations

import errno
import os
from pathlib import Path

from gelform.errors import SensorError
from gelform.sensors.cameras.camera import Camera

RULE_FILE = "/etc/udev/rules.d/60-gelform.rules"
NAMED = 4  # programs in a message


def udev_rule(usb_id: str | None) -> str:
    """A line for udev that lets whoever sits at the machine, and the group video, use a camera."""
    vendor, _, product = (usb_id or "").partition(":")
    which = f'ATTRS{{idVendor}}=="{vendor}", ATTRS{{idProduct}}=="{product}", ' if product else ""
    return f'SUBSYSTEM=="video4linux", {which}MODE="0660", GROUP="video", TAG+="uaccess"'


def check_access(camera: Camera) -> None:
    """Open the camera's path for a moment.

    Raises
    ------
    SensorError
        It is not there, not allowed (with the udev rule), or in use by another program (which is named where it can
        be seen).
    """
    try:
        os.close(os.open(camera.path, os.O_RDWR | getattr(os, "O_NONBLOCK", 0)))
    except OSError as problem:
        raise SensorError(f"{camera.described()} {_reason(camera, problem)}") from problem


def in_use(camera: Camera) -> SensorError:
    """The error for a camera that opens but gives no frames: somebody else has them."""
    holders = programs_that_hold(camera.path)
    holders = holders[:NAMED] + ["others"] * (len(holders) > NAMED)
    who = f"by {', '.join(holders)}" if holders else "by another program"
    return SensorError(
        f"{camera.described()} is in use {who}, or has no picture format that OpenCV reads. Close the other program; one "
        "Grabber serves several consumers."
    )


def programs_that_hold(path: str, proc: Path = Path("/proc")) -> list[str]:
    """Name and number of the programs that have a file open, as far as this user may see; without this one."""
    target, found = os.path.realpath(path), []
    for process in sorted(proc.glob("[0-9]*")):
        if process.name == str(os.getpid()):
            continue
        try:
            if any(os.readlink(link) == target for link in (process / "fd").iterdir()):
                found.append(f"{(process / 'comm').read_text().strip()} (process {process.name})")
        except OSError:
            continue  # another user's, or it ended
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
