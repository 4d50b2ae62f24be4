"""A camera that is plugged in, and which of several is meant: by serial first, name second, path last."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gelform.errors import SensorError

NOTHING_THERE = (
    'No camera is plugged in. Plug one in, look at its cable, or take "simulated", which needs none. A camera of another '
    "machine is reached by its address (http://...)."
)


@dataclass(frozen=True)
class Camera:
    """A camera as the system knows it.

    Attributes
    ----------
    name : as it calls itself
    path : what opens it: /dev/video0, or its number where the system has no paths
    serial : of the USB device; None where it has none
    usb_id : vendor and product, such as "0c45:636d"; None where it is not on USB
    by_path : the name that belongs to the socket it is plugged into; None where the system has none
    kind : the row of `SENSORS` that it is; None for a camera of no known sensor
    """

    name: str
    path: str
    serial: str | None = None
    usb_id: str | None = None
    by_path: str | None = None
    kind: str | None = None

    def described(self) -> str:
        """For a list: name, serial, path."""
        serial = f"serial {self.serial}" if self.serial else "no serial"
        return f"{self.name} ({serial}, {self.path}{f', {self.by_path}' if self.by_path else ''})"


def chosen_camera(spec: str, cameras: Sequence[Camera]) -> Camera:
    """The camera that is meant.

    Parameters
    ----------
    spec : a serial, else a name (also a part of one, in capitals or not; or a row of `SENSORS`, such as "digit"), else a
        path (also the one by its socket); empty: the only camera there is
    cameras : those that are plugged in

    Raises
    ------
    SensorError
        None or several answer to it; the message lists what is there.
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
    raise SensorError(f"{_none_named(spec)} Plugged in: {listed_cameras(cameras)}.")


def listed_cameras(cameras: Sequence[Camera]) -> str:
    """All of them in one sentence's end."""
    return "; ".join(camera.described() for camera in cameras)


def _none_named(spec: str) -> str:
    """A name that is no camera's may have been meant as a file's."""
    return f"No camera {spec!r}, and no file or folder of that name."


def _only(matches: list[Camera], several: str, cameras: Sequence[Camera]) -> Camera:
    if len(matches) == 1:
        return matches[0]
    serials = [camera.serial for camera in matches]
    unique = None not in serials and len(set(serials)) == len(serials)
    by = "serial" if unique else "path (the one by its socket stays the same)"
    raise SensorError(f"{several}: name one by its {by}. Plugged in: {listed_cameras(cameras)}.")
