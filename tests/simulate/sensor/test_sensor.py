"""A sensor as settings and back; sensors that cannot be."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from gelform.sensors.profiles import SENSORS
from gelform.sensors.simulated.settings import sensor_from_settings
from gelform.simulate import LAYOUTS, Coating, Led, SimulatedSensor
from gelform.simulate.sensor.sensor import settings_from_sensor
from made.sensors import PLAIN, SMALL


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


REFUSED = [
    (lambda: replace(PLAIN, leds=(Led((1, 0, 1), (1, 1, 1)),)), "outside the gel"),
    (lambda: replace(PLAIN, shading=((1, 2),)), "shading"),
    (lambda: SimulatedSensor(()), "at least one LED"),
    (lambda: replace(SMALL, noise_sd=-1), "noise_sd >= 0"),
    (lambda: replace(SMALL, noise_gain=-0.1), "noise_gain >= 0"),
    (lambda: replace(SMALL, vignetting=1.0), "vignetting"),
    (lambda: replace(SMALL, crosstalk=((1, 0), (0, 1))), "crosstalk"),
    (lambda: replace(SMALL, mm_per_px=0.0), "mm_per_px"),
    (lambda: replace(SMALL, shape=(0, 3)), "shape"),
]


@pytest.mark.parametrize(("make", "message"), REFUSED)
def test_bad_settings_are_refused_with_the_reason(make, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        make()
