"""Every layout can be used, at the levels that it says."""

import numpy as np
import pytest

from gelform.simulate import LAYOUTS, Ball, simulate_background, simulate_press


@pytest.mark.parametrize("name", LAYOUTS)
def test_every_layout_makes_a_picture_that_can_be_used(name):
    sensor = LAYOUTS[name]
    background = simulate_background(sensor, None, quantise=False)
    press = simulate_press(sensor, Ball(3), depth_mm=0.8, rng=None, quantise=False)
    change = np.abs(press.image - background)
    assert background.min() > 5
    assert background.max() < 250
    assert np.all(change[press.contact].max(axis=0) > 15)
    assert change[:10].max() < 0.5


@pytest.mark.parametrize(
    ("name", "levels"),
    [("three-edges", (78, 95, 105)), ("ring-120", (110, 110, 110)), ("homemade", (85, 80, 75))],
)
def test_every_layout_is_exposed_as_it_says(name, levels):
    background = simulate_background(LAYOUTS[name], None, quantise=False)
    np.testing.assert_allclose(background.mean(axis=(0, 1)), levels, rtol=1e-4)
