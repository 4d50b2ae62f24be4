"""Layouts and presets: at the levels that they say, like real sensors where their data is there."""

import cv2
import numpy as np
import pytest

from gelform.sensors.profiles import SENSORS
from gelform.simulate import LAYOUTS, Ball, simulate_background, simulate_press

REAL = {"gelsight-mini": "mini-ball", "digit": "digit-ball"}


@pytest.mark.parametrize("name", [*LAYOUTS, *SENSORS])
def test_every_sensor_makes_a_picture_that_can_be_used(name):
    sensor = LAYOUTS[name] if name in LAYOUTS else SENSORS[name].simulated()
    background = simulate_background(sensor, None)
    press = simulate_press(sensor, Ball(3), depth_mm=0.6, rng=None, oversample=1)
    change = np.abs(press.image.astype(float) - background)
    assert 50 < background.mean() < 150
    assert np.mean(background == 255) < 0.01
    assert np.quantile(change[press.contact].max(axis=-1), 0.5) > 15
    assert change[:8, :8].mean() < 3


def test_every_layout_is_exposed_as_it_says():
    said = {"three-edges": (78, 95, 105), "ring-120": (110, 110, 110), "homemade": (85, 80, 75)}
    for name, sensor in LAYOUTS.items():
        background = simulate_background(sensor, None, quantise=False)
        np.testing.assert_allclose(background.mean(axis=(0, 1)), said[name], rtol=1e-4)


@pytest.mark.parametrize("name", REAL)
def test_untouched_presets_look_like_the_real_sensor(name, data):
    real = cv2.imread(str(data / REAL[name] / "background.png"))[..., ::-1].astype(np.float64)
    made = simulate_background(SENSORS[name].simulated(), None, quantise=False)
    assert made.shape == real.shape
    np.testing.assert_allclose(made.mean((0, 1)), real.mean((0, 1)), atol=2)
    np.testing.assert_allclose(made.std((0, 1)), real.std((0, 1)), rtol=0.1)
    smooth = cv2.GaussianBlur(real, (0, 0), 2) - cv2.GaussianBlur(made, (0, 0), 2)
    assert np.sqrt(np.mean(smooth**2)) < 7
