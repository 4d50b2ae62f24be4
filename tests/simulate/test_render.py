"""The untouched gel, its exposure, and the truth behind a lens."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.simulate import Ball, Optics, exposed, simulate_background, simulate_press
from made.sensors import PLAIN, SMALL


def test_single_and_double_precision_agree():
    gray = simulate_press(PLAIN, Ball(2), depth_mm=0.5, rng=None).image
    exact = simulate_press(PLAIN, Ball(2), depth_mm=0.5, rng=None, quantise=False).image
    assert np.abs(gray - np.clip(exact, 0, 255)).max() < 0.501


def test_the_truth_says_which_pixels_are_saturated():
    bright = replace(PLAIN, optics=Optics(exposure=4.0))
    press = simulate_press(bright, Ball(2), depth_mm=0.5, rng=None)
    exact = simulate_press(bright, Ball(2), depth_mm=0.5, rng=None, quantise=False).image
    np.testing.assert_array_equal(press.saturated, (exact > 255.5).any(axis=-1))
    assert np.all((press.image == 255).any(axis=-1)[press.saturated])
    assert 0 < press.saturated.mean() < 1


def test_averaging_frames_lowers_the_noise():
    sensor = replace(SMALL, noise_sd=2.0, noise_gain=0.0)
    clean = simulate_background(sensor, None, quantise=False)
    mean = simulate_background(sensor, np.random.default_rng(0), frames=16)
    assert mean.dtype == np.float32
    assert (mean - clean).std() == pytest.approx(0.5, rel=0.1)


@pytest.mark.parametrize("gamma", [1.0, 1.8])
def test_exposed_gives_the_levels_behind_the_response(gamma):
    sensor = exposed(replace(PLAIN, optics=Optics(response_gamma=gamma)), (60, 80, 100))
    np.testing.assert_allclose(
        simulate_background(sensor, None, quantise=False).mean((0, 1)), (60, 80, 100), rtol=1e-6
    )
