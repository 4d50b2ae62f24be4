"""LEDs, what changes from frame to frame, a sensor as settings and back."""

import json
from dataclasses import replace

import numpy as np
import pytest

from gelform.sensors.profiles import SENSORS
from gelform.sensors.simulated.settings import sensor_from_settings
from gelform.simulate import LAYOUTS, Ball, Coating, Pose, Timing, led_color, simulate_pose
from gelform.simulate.sensor.sensor import led_ring, settings_from_sensor
from made.sensors import PLAIN


def test_a_ring_goes_round_as_its_angles_say():
    right, down = led_ring(10.0, 5.0, (0, 90), ((1, 0, 0), (0, 1, 0)))
    np.testing.assert_allclose(right.position_mm, (10, 0, 5), atol=1e-9)
    np.testing.assert_allclose(down.position_mm, (0, 10, 5), atol=1e-9)


def test_colors_of_leds_land_in_their_channels():
    assert np.argmax(led_color(625)) == 0
    assert np.argmax(led_color(530)) == 1
    assert np.argmax(led_color(465)) == 2
    assert led_color(465)[2] > led_color(480)[2]


def test_leds_drift_and_flicker():
    sensor = replace(PLAIN, timing=Timing(drift=(0.2, -0.1, 0.0), drift_time_s=10.0))
    settings = {"rng": None, "quantise": False}
    first, later = (simulate_pose(sensor, Ball(2), Pose(0), time_s=t, **settings).image for t in (0.0, 10.0))
    part = 1 - np.exp(-1)
    np.testing.assert_allclose((later / first).mean((0, 1)), [1 + 0.2 * part, 1 - 0.1 * part, 1], rtol=1e-6)
    rolling = replace(PLAIN, timing=Timing(flicker=0.1, flicker_hz=100, readout_s=0.03))
    rows = (simulate_pose(rolling, Ball(2), Pose(0), time_s=0.0013, **settings).image / first)[:, 0, 0]
    crossings = np.count_nonzero(np.diff(np.sign(rows - 1)))
    assert crossings == 6
    assert rows.max() == pytest.approx(1.1, abs=0.01)


def test_settings_make_the_same_sensor_again():
    for sensor in (*LAYOUTS.values(), *(known.simulated() for known in SENSORS.values())):
        assert sensor_from_settings(json.loads(json.dumps(settings_from_sensor(sensor)))) == sensor


def test_an_albedo_map_comes_through():
    sensor = replace(LAYOUTS["ring-120"], coating=Coating(albedo=np.linspace(0.2, 1, 12).reshape(3, 4)))
    again = sensor_from_settings(json.loads(json.dumps(settings_from_sensor(sensor))))
    np.testing.assert_array_equal(again.coating.albedo.values, sensor.coating.albedo.values)
