"""Linear levels: exposure, shading, vignetting, crosstalk."""

from dataclasses import replace

import numpy as np

from gelform.simulate import Led, Optics, SimulatedSensor, simulate_background
from made.sensors import PLAIN, SMALL


def test_exposure_times_light_and_noise_with_it():
    quiet = simulate_background(PLAIN, None, quantise=False)
    twice = simulate_background(replace(PLAIN, optics=Optics(exposure=2.0)), None, quantise=False)
    np.testing.assert_allclose(twice, 2 * quiet, rtol=1e-9)


def test_shading_is_a_gain_over_the_image():
    shading = ((2, 0.1, 0, 0, 0, 0), (1, 0, -0.2, 0, 0, 0), (1, 0, 0, 0.1, 0.05, 0.3))
    ratio = simulate_background(replace(PLAIN, shading=shading), None, quantise=False) / simulate_background(
        PLAIN, None, quantise=False
    )
    np.testing.assert_allclose(ratio[0, -1, :2], [2 * 1.1, 1.2], rtol=1e-9)
    np.testing.assert_allclose(ratio[-1, 0, 2], 1 + 0.1 - 0.05 + 0.3, rtol=1e-9)


def test_vignetting_darkens_the_corners():
    plain = replace(SMALL, vignetting=0.0, blur_px=0.0)
    ratio = simulate_background(replace(plain, vignetting=0.4), None, quantise=False) / simulate_background(
        plain, None, quantise=False
    )
    np.testing.assert_allclose(ratio[[0, 0, -1, -1], [0, -1, 0, -1]], 0.6, rtol=1e-9)
    assert ratio[24, 32].min() > 0.99


def test_too_bright_is_saturated_and_crosstalk_mixes_channels():
    sensor = SimulatedSensor(
        (Led((0, 0, 5), (1000, 0, 0)),), shape=(20, 20), crosstalk=((1, 0, 0), (0.25, 1, 0), (0, 0, 1))
    )
    levels = simulate_background(sensor, None, quantise=False)
    np.testing.assert_allclose(levels[..., 1], 0.25 * levels[..., 0])
    bright = simulate_background(replace(sensor, white_balance=(100, 1, 1)), None)
    assert np.all(bright[..., 0] == 255)
