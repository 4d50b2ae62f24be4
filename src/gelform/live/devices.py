"""The devices that the page lists and may show, and settings of cameras."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from gelform.errors import GelformError
from gelform.live.station import Opening, Setup, Station
from gelform.sensors.cameras.camera import Camera, cameras_in_sysfs
from gelform.sensors.cameras.settings import CONTROLS
from gelform.sensors.cameras.usb import UsbCamera
from gelform.sensors.source import Source

LOOK_EVERY_S = 0.5  # s between searches for connected cameras
NOT_SHOWN = "not shown"  # state of a connected camera that no station shows

SETTABLE = (*CONTROLS, "led_level")

Opener = Callable[[Camera, Mapping[str, float | str]], Source]


def listed_cameras() -> list[Camera]:
    """The connected cameras, if the system lists them; elsewhere each would have to be opened for that."""
    return cameras_in_sysfs() if sys.platform.startswith("linux") else []


class Devices:
    """The connected or open devices.

    A camera's number is assigned at its first appearance, and stays with its USB socket. Pages never send a path.

    Parameters
    ----------
    stations : the hub's stations; their sources are listed, except recordings
    cameras : lists the connected cameras
    open_camera : opens one of them, with settings
    """

    def __init__(
        self,
        stations: Sequence[Station],
        cameras: Callable[[], Sequence[Camera]] = listed_cameras,
        open_camera: Opener = UsbCamera,
    ) -> None:
        self._stations, self._cameras, self._open_camera = stations, cameras, open_camera
        self._lock, self._showing = threading.Lock(), threading.Lock()
        self._numbers: dict[str, int] = {}
        self._looked_s, self._there = float("-inf"), tuple[Camera, ...]()

    def cameras(self) -> tuple[Camera, ...]:
        """The connected cameras."""
        return self._plugged_in()

    def camera(self, number: int) -> Camera:
        """The camera with a number of the list; GelformError if it is not connected."""
        for camera in self._plugged_in():
            if self._number(camera) == number:
                return camera
        raise GelformError("That camera is no longer plugged in. Choose another one in the list.")

    def show(self, station: Station, camera: Camera, setup: Setup) -> None:
        """Show a camera on a station; if several pages ask at once, the first one gets it.

        Raises
        ------
        GelformError
            The camera is already shown, and only one reader can have its pictures.
        """
        with self._showing:
            for other in tuple(self._stations):
                if other.camera is not None and _key(other.camera) == _key(camera):
                    raise GelformError(
                        f"Sensor {other.number + 1} already shows {camera.name}. Any number of pages may show it."
                    )
            wanted: dict[str, float | str] = {}
            opening = Opening(partial(self._open_camera, camera, wanted), camera=camera, wanted=wanted)
            station.show(opening, setup)

    def facts(self) -> list[dict[str, Any]]:
        """The rows of the page's list."""
        rows = [_row_of_station(one) for one in tuple(self._stations) if one.player is None]
        shown = {_key(one.camera) for one in tuple(self._stations) if one.camera is not None}
        others = [camera for camera in self._plugged_in() if _key(camera) not in shown]
        numbered = [(self._number(camera), camera) for camera in others]
        return rows + [
            _row(f"camera {number}", camera.name, camera.serial, NOT_SHOWN, camera=number)
            for number, camera in numbered
        ]

    def _number(self, camera: Camera) -> int:
        with self._lock:
            return self._numbers.setdefault(_key(camera), len(self._numbers))

    def _plugged_in(self) -> tuple[Camera, ...]:
        with self._lock:
            if time.monotonic() - self._looked_s > LOOK_EVERY_S:
                self._looked_s, self._there = time.monotonic(), tuple(self._cameras())
            return self._there


def set_camera(station: Station, name: str, value: float) -> float:
    """Set one setting of a station's camera; return its new value. It is set again when the camera is reopened.

    Raises
    ------
    GelformError
        The source has no settings, the setting does not exist, or the camera rejects the value.
    """
    source: Any = station.source
    if not hasattr(source, "set_controls"):
        what = station.spec if source is None else source.name
        raise GelformError(
            f"{what} has no settings that the page can change. Only a USB camera of this machine has."
        )
    if name not in SETTABLE:
        raise GelformError(f"Expected a setting among {', '.join(SETTABLE)}.")
    found = source.set_controls({name: value})
    station.wanted[name] = value
    return float(found[name])


def camera_facts(station: Station) -> dict[str, Any]:
    """The settings that can be changed, as read back; a result's findings name those that differ from the calibration."""
    source: Any = station.source
    settings = dict(source.settings) if hasattr(source, "set_controls") else {}
    return {"settable": {name: settings[name] for name in SETTABLE if name in settings}}


def _row_of_station(station: Station) -> dict[str, Any]:
    key = f"station {station.number}"
    if station.source is None:
        return _row(key, station.spec, None, "missing", station=station.number)
    grabber, stats = station.grabber, station.grabber.stats
    age_ms = None if stats.age_s is None else 1e3 * stats.age_s
    figures = {"rate_hz": stats.rate_hz, "age_ms": age_ms, "lost": station.lost, "skipped": station.skipped}
    return _row(key, grabber.name, grabber.serial, grabber.state, station=station.number, **figures)


def _row(key: str, name: str, serial: str | None, state: str, **known: Any) -> dict[str, Any]:
    """A row of the list; `known` contains its station or its camera, and figures of a station."""
    unknown = dict.fromkeys(("station", "camera", "rate_hz", "age_ms", "lost", "skipped"))
    return {**unknown, "key": key, "name": name, "serial": serial, "state": state, **known}


def _key(camera: Camera) -> str:
    """An identifier that stays with the camera's USB socket, if the system states it."""
    return camera.by_path or camera.path
