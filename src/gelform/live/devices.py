"""The devices that the page lists, which of them somebody unplugs, and how a camera is set."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any

from gelform.errors import GelformError
from gelform.live.replay.player import Player
from gelform.live.station import Station
from gelform.sensors.cameras.camera import Camera
from gelform.sensors.cameras.settings import CONTROLS, settings_mismatch
from gelform.sensors.cameras.sysfs import cameras_in_sysfs

LOOK_EVERY_S = 0.5
SETTABLE = (*CONTROLS, "led_level")


def listed_cameras() -> list[Camera]:
    """The cameras that are plugged in, where the system lists them; elsewhere they would have to be opened for it."""
    return cameras_in_sysfs() if sys.platform.startswith("linux") else []


class Devices:
    """What is plugged in or open, and which of it went away since somebody asked.

    Parameters
    ----------
    stations : those of the hub, whose sources are listed, recordings left out
    cameras : lists the cameras that are plugged in
    """

    def __init__(
        self, stations: Sequence[Station], cameras: Callable[[], Sequence[Camera]] = listed_cameras
    ) -> None:
        self._stations, self._cameras = stations, cameras
        self._lock = threading.Lock()
        self._looked_s, self._seen = float("-inf"), tuple[Camera, ...]()
        self._before: dict[str, str] | None = None
        self._gone = ""

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
        rows = [_row_of_station(one) for one in tuple(self._stations) if not isinstance(one.source, Player)]
        shown = {row["serial"] or row["name"] for row in rows}
        others = [camera for camera in self._plugged_in() if (camera.serial or camera.name) not in shown]
        return [*rows, *(_row_of_camera(camera) for camera in others)]

    def _plugged_in(self) -> tuple[Camera, ...]:
        with self._lock:
            if time.monotonic() - self._looked_s > LOOK_EVERY_S:
                self._looked_s, self._seen = time.monotonic(), tuple(self._cameras())
            return self._seen


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
    calibrated = {} if calibration is None else calibration.settings.get("camera", {})
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
    grabber = station.grabber if station.source is not None else None
    row: dict[str, Any] = {
        "key": f"station {station.number}",
        "station": station.number,
        "name": station.spec if grabber is None else grabber.name,
        "serial": None if grabber is None else grabber.serial,
        "state": "missing" if grabber is None else grabber.state,
        "rate_hz": None,
        "age_ms": None,
        "drops": None,
    }
    if grabber is not None:
        stats = grabber.stats
        age_ms = None if stats.age_s is None else 1e3 * stats.age_s
        row |= {"rate_hz": stats.rate_hz, "age_ms": age_ms, "drops": stats.drops}
    return row | {"there": row["state"] == "running"}


def _row_of_camera(camera: Camera) -> dict[str, Any]:
    return {
        "key": camera.by_path or camera.path,
        "station": None,
        "name": camera.name,
        "serial": camera.serial,
        "state": "not shown",
        "rate_hz": None,
        "age_ms": None,
        "drops": None,
        "there": True,
    }


def _text(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:g}"
