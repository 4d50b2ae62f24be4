"""An image of a surface: precision and what the truth says of it."""

from dataclasses import replace

import numpy as np

from gelform.simulate import Ball, Optics, simulate_press
from made.sensors import PLAIN


def test_single_and_double_precision_agree():
    grey = simulate_press(PLAIN, Ball(2), depth_mm=0.5, rng=None).image
    exact = simulate_press(PLAIN, Ball(2), depth_mm=0.5, rng=None, quantise=False).image
    assert np.abs(grey - np.clip(exact, 0, 255)).max() < 0.501


def test_the_truth_says_which_pixels_are_saturated():
    bright = replace(PLAIN, optics=Optics(exposure=4.0))
    press = simulate_press(bright, Ball(2), depth_mm=0.5, rng=None)
    exact = simulate_press(bright, Ball(2), depth_mm=0.5, rng=None, quantise=False).image
    np.testing.assert_array_equal(press.saturated, (exact > 255.5).any(axis=-1))
    assert np.all((press.image == 255).any(axis=-1)[press.saturated])
    assert 0 < press.saturated.mean() < 1
