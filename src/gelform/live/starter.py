"""A station without a calibration: its make, and the starter's calibration from its gel at rest."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from gelform.calibration.starters import Starter, load_starter, make_name, starter_names, starter_of_source
from gelform.calibration_file import Calibration
from gelform.errors import GelformError
from gelform.image.frame import Frame
from gelform.live.station import Station
from gelform.sensors.streams.starting import UntouchedImage


def starters() -> list[list[str]]:
    """[name, display name] of the makes with a starter."""
    return [[name, make_name(name)] for name in starter_names()]


def starter_facts(station: Station) -> dict[str, Any] | None:
    """The starter's state for the page: `ask` for the gel at rest, or `used`; None for a calibrated unit.

    `sensor` is the starter's name, empty if the make is unknown; `said` are sentences for the user.
    """
    calibration, problem = station.setup.calibration, station.starter_problem
    if calibration is None:
        sensor = starter_of_station(station)
        return {
            "state": "ask",
            "sensor": sensor,
            "make": make_name(sensor),
            "said": [problem] if problem else [],
        }
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
    """The starter that the station was started with, else that of its camera's make; "" if neither is known."""
    return station.sensor or (starter_of_source(station.source) if station.source is not None else None) or ""


def starter_calibration(
    sensor: str, frames: Iterable[Frame], serial: str | None, before: Calibration | None
) -> Calibration:
    """The calibration of a unit from frames of its gel at rest.

    Parameters
    ----------
    sensor : the starter's name
    before : the calibration in use; a scale that the user gave to a starter's calibration is kept

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
    # Whole gray levels, so that the background in a recording is exactly the image in use.
    pitch = _own_pitch(starter, before)
    return starter.for_unit(np.rint(image), view=untouched.view, mm_per_px=pitch, serial=serial)


def _own_pitch(starter: Starter, before: Calibration | None) -> float | None:
    """The scale of a starter's calibration of the same make, if it differs from the make's."""
    record = None if before is None else before.settings.starter
    if before is None or record is None or record["sensor"] != starter.sensor:
        return None
    return None if before.mm_per_px == starter.calibration.mm_per_px else before.mm_per_px
