"""The devices that the page lists and may show, which of them somebody unplugs, and how a camera is set."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from gelform.errors import GelformError
from gelform.live.setup import Setup
from gelform.live.station import Opening, Station
from gelform.sensors.cameras.camera import Camera, cameras_in_sysfs
from gelform.sensors.cameras.settings import CONTROLS, settings_mismatch
from gelform.sensors.cameras.usb import UsbCamera
from gelform.sensors.source import Source

LOOK_EVERY_S = 0.5  # for the cameras that are plugged in
NOT_SHOWN = "not shown"  # of a camera that is plugged in
SETTABLE = (*CONTROLS, "led_level")

Opener = Callable[[Camera, Mapping[str, float | str]], Source]


def listed_cameras() -> list[Camera]:
    """The cameras that are plugged in, where the system lists them; elsewhere they would have to be opened for it."""
    return cameras_in_sysfs() if sys.platform.startswith("linux") else []


class Devices:
    """What is plugged in or open, and which of it went away since somebody asked.

    A camera is called by a number that is given here when it is first seen, and stays with the socket that it is plugged
    into: pages never send a path.

    Parameters
    ----------
    stations : those of the hub, whose sources are listed, recordings left out
    cameras : lists the cameras that are plugged in
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
        self._before: dict[str, str] | None = None
        self._gone = ""

    def cameras(self) -> tuple[Camera, ...]:
        """The cameras that are plugged in."""
        return self._plugged_in()

    def camera(self, number: int) -> Camera:
        """The camera of a number of the list; GelformError where it is not plugged in."""
        for camera in self._plugged_in():
            if self._number(camera) == number:
                return camera
        raise GelformError("That camera is not plugged in any more. Choose one of the list.")

    def show(self, station: Station, camera: Camera, setup: Setup) -> None:
        """Show a camera on a station; of several pages that ask for it at once the first one gets it.

        Raises
        ------
        GelformError
            It is shown already: a camera gives its pictures to one reader.
        """
        with self._showing:
            for other in tuple(self._stations):
                if other.camera is not None and _key(other.camera) == _key(camera):
                    raise GelformError(
                        f"{camera.name} is shown already, as sensor {other.number + 1}. Any number of pages may look at it."
                    )
            wanted: dict[str, float | str] = {}
            opening = Opening(partial(self._open_camera, camera, wanted), camera=camera, wanted=wanted)
            station.show(opening, setup)

    def identify(self, on: bool) -> None:
        """Remember what is there: what goes away from now on is named. Off: forget it."""
        rows = self._rows()
        with self._lock:
            self._before = {row["key"]: row["name"] for row in rows if row["there"]} if on else None
            self._gone = ""

    def facts(self) -> dict[str, Any]:
        """The list, whether somebody asks which device it is, what went away, and whether that is back."""
        rows = self._rows()
        there = {row["key"] for row in rows if row["there"]}
        with self._lock:
            if self._before is not None:
                lost = [key for key in self._before if key not in there]
                if lost and not self._gone:
                    self._gone = lost[0]
            asking = self._before is not None and not self._gone
            name = (self._before or {}).get(self._gone, "")
            return {
                "rows": rows,
                "asking": asking,
                "gone": self._gone,
                "gone_name": name,
                "back": bool(self._gone) and self._gone in there,
            }

    def _rows(self) -> list[dict[str, Any]]:
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
    """Set one setting of a station's camera; what the camera has afterwards. It is set again when the camera comes back.

    Raises
    ------
    GelformError
        The source has no settings, there is no such setting, or the camera does not take the value.
    """
    source: Any = station.source
    if not hasattr(source, "set_controls"):
        what = station.spec if source is None else source.name
        raise GelformError(
            f"{what} has no settings that can be changed from here: only a USB camera of this machine has."
        )
    if name not in SETTABLE:
        raise GelformError(f"Expected a setting among {', '.join(SETTABLE)}.")
    found = source.set_controls({name: value})
    station.wanted[name] = value
    return float(found[name])


def camera_facts(station: Station) -> dict[str, Any]:
    """The settings that can be changed, as read back, and which of all are not those of the calibration."""
    source: Any = station.source
    settings = {} if source is None else dict(source.settings)
    settable = {name: settings[name] for name in SETTABLE if name in settings}
    calibration = station.setup.calibration
    calibrated = {} if calibration is None else calibration.settings.camera or {}
    other = settings_mismatch(calibrated, settings)
    said = "; ".join(
        f"{name.replace('_', ' ')} {_text(mine)}, calibrated at {_text(then)}"
        for name, (then, mine) in other.items()
    )
    return {
        "settable": settable if hasattr(source, "set_controls") else {},
        "mismatch": f"Not set as calibrated: {said}." if said else "",
    }


def _row_of_station(station: Station) -> dict[str, Any]:
    key = f"station {station.number}"
    if station.source is None:
        return _row(key, station.spec, None, "missing", station=station.number)
    grabber, stats = station.grabber, station.grabber.stats
    age_ms = None if stats.age_s is None else 1e3 * stats.age_s
    figures = {"rate_hz": stats.rate_hz, "age_ms": age_ms, "lost": station.lost, "skipped": station.skipped}
    return _row(key, grabber.name, grabber.serial, grabber.state, station=station.number, **figures)


def _row(key: str, name: str, serial: str | None, state: str, **known: Any) -> dict[str, Any]:
    """A row of the list; `known` has its station or its camera, and figures of a station."""
    unknown = dict.fromkeys(("station", "camera", "rate_hz", "age_ms", "lost", "skipped"))
    there = state in ("running", NOT_SHOWN)
    return {**unknown, "key": key, "name": name, "serial": serial, "state": state, "there": there, **known}


def _key(camera: Camera) -> str:
    """What stays with the socket that a camera is plugged into, where the system says that."""
    return camera.by_path or camera.path


def _text(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:g}"
