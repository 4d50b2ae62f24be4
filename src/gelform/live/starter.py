"""A station that was never calibrated: of which make it is, and the starter's calibration of its untouched gel."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from gelform.calibration_file import Calibration
from gelform.errors import GelformError
from gelform.frames import Frame
from gelform.live.lists import Origin
from gelform.live.station import Station
from gelform.sensors.profiles import SENSORS
from gelform.starters import Starter, load_starter, starter_names, starter_of_source
from gelform.streams.starting import UntouchedImage

STARTERS = tuple(starter_names())
IMPORTS = ("from gelform.starters import load_starter", "from gelform.view import View")


def starters() -> list[list[str]]:
    """[name, as people write it] of the makes that have a starter."""
    return [[name, _make(name)] for name in STARTERS]


def starter_facts(station: Station) -> dict[str, Any] | None:
    """What the page says of it: `ask` for the untouched gel, or a starter's is `used`; None of a unit that was calibrated.

    `sensor` is the starter's name, empty where the make is not known; `said` is what should be known of it, in sentences.
    """
    calibration, problem = station.setup.calibration, station.starter_problem
    if calibration is None:
        sensor = starter_of_station(station)
        return {"state": "ask", "sensor": sensor, "make": _make(sensor), "said": [problem] if problem else []}
    record = calibration.settings.starter
    if record is None:
        return None
    said = [finding.message for finding in calibration.findings if finding.name != "starter"]
    return {
        "state": "used",
        "sensor": record["sensor"],
        "make": calibration.sensor_name,
        "percent": 100 * calibration.unit_spread,
        "said": [*said, *([problem] if problem else [])],
    }


def starter_of_station(station: Station) -> str:
    """The name of the starter that a station was started with, else of its camera's make; "" where neither is known."""
    return station.sensor or (starter_of_source(station.source) if station.source is not None else None) or ""


def starter_calibration(
    sensor: str, frames: Iterable[Frame], serial: str | None, before: Calibration | None
) -> tuple[Calibration, Origin]:
    """The calibration of the unit that gave frames of its untouched gel, and how Python makes it again of a snapshot.

    Parameters
    ----------
    sensor : the starter's name
    before : what was in use: a scale that somebody gave a starter's calibration is kept

    Raises
    ------
    GelformError
        Something moved, or the gel's light is not that of the make.
    """
    starter = load_starter(sensor)
    untouched = UntouchedImage(starter)
    for frame in frames:
        untouched.keep(frame)
    image = untouched.mean()
    if image is None:
        raise GelformError(untouched.reason)
    # In whole grey levels: what the file background.png of a snapshot or a recording holds is what was used.
    pitch = _own_pitch(starter, before)
    made = starter.for_unit(np.rint(image), view=untouched.view, mm_per_px=pitch, serial=serial)
    scale = "" if pitch is None else f", mm_per_px={pitch!r}"
    expression = (
        f"load_starter({sensor!r}).for_unit(\n"
        f'    gelform.read_image("background.png"), view=View.from_dict({untouched.view.to_dict()!r}){scale}\n)'
    )
    return made, Origin(expression, IMPORTS)


def _own_pitch(starter: Starter, before: Calibration | None) -> float | None:
    """The scale of a starter's calibration of the same make where it is not the make's."""
    record = None if before is None else before.settings.starter
    if before is None or record is None or record["sensor"] != starter.sensor:
        return None
    return None if before.mm_per_px == starter.calibration.mm_per_px else before.mm_per_px


def _make(sensor: str) -> str:
    profile = SENSORS[sensor].profile if sensor in SENSORS else None
    return sensor if profile is None else profile.name
