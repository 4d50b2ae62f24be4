"""A station without a calibration, or with that of a starter, for the page."""

from __future__ import annotations

from typing import Any

from gelform.calibration.starters import make_name, starter_names, starter_of_source
from gelform.live.station import Station


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
