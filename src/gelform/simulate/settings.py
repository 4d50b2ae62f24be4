"""Everything about a simulated sensor, as a data set's JSON holds it."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from gelform.simulate.sensor.sensor import SimulatedSensor


def settings_from_sensor(sensor: SimulatedSensor) -> dict[str, Any]:
    """A sensor as lists, numbers and words that JSON can hold; an albedo map as its values.

    `gelform.sensors.simulated_settings.sensor_from_settings` turns them back into the sensor.
    """
    return {field.name: _plain(getattr(sensor, field.name)) for field in fields(sensor)}


def _plain(value: Any) -> Any:
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    return np.asarray(getattr(value, "values", value)).tolist()
