"""A simulated sensor as settings, and back."""

import json
from dataclasses import replace

import numpy as np
import pytest

from gelform.sensors.profiles import SENSORS
from gelform.sensors.simulated_settings import sensor_from_settings
from gelform.simulate import LAYOUTS, Coating
from gelform.simulate.settings import settings_from_sensor


@pytest.mark.parametrize(
    "sensor", [*LAYOUTS.values(), *(known.simulated() for known in SENSORS.values())], ids=lambda s: s.name
)
def test_settings_make_the_same_sensor_again(sensor):
    settings = json.loads(json.dumps(settings_from_sensor(sensor)))
    assert sensor_from_settings(settings) == sensor


def test_an_albedo_map_comes_through():
    sensor = replace(LAYOUTS["ring-120"], coating=Coating(albedo=np.linspace(0.2, 1, 12).reshape(3, 4)))
    again = sensor_from_settings(json.loads(json.dumps(settings_from_sensor(sensor))))
    np.testing.assert_array_equal(again.coating.albedo.values, sensor.coating.albedo.values)
