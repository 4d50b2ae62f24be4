"""From levels to the image: noise, response, rounding, JPEG."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.simulate import Ball, Optics, exposed, simulate_background, simulate_press
from gelform.simulate.sensor import grey_levels
from gelform.simulate.sensor.grey_levels import draws, normal_table, saturated_from_levels
from kernel_agreement import assert_kernel_agrees
from made.sensors import PLAIN, SMALL


def test_noise_is_as_asked_and_quantisation_rounds():
    sensor = replace(SMALL, noise_sd=1.5, noise_gain=0.02)
    clean = simulate_background(sensor, None, quantise=False)
    noisy = simulate_background(sensor, np.random.default_rng(0), quantise=False)
    scaled = (noisy - clean) / np.sqrt(1.5**2 + 0.02 * clean)
    assert scaled.std() == pytest.approx(1, abs=0.03)
    assert scaled.mean() == pytest.approx(0, abs=0.03)
    rounded = simulate_background(sensor, None)
    assert rounded.dtype == np.uint8
    np.testing.assert_array_equal(rounded, np.rint(clean))


def test_noise_is_normal():
    drawn = normal_table()[draws(np.random.default_rng(5), 400_001)].astype(np.float64)
    assert drawn.shape == (400_001,)
    moments = [np.mean(drawn**k) for k in (1, 2, 3, 4)]
    np.testing.assert_allclose(moments, [0, 1, 0, 3], atol=0.03)
    assert np.mean(np.abs(drawn) > 2.5758) == pytest.approx(0.01, rel=0.1)
    neighbours = drawn[: 4 * 100_000].reshape(-1, 4)
    np.testing.assert_allclose(np.corrcoef(neighbours.T), np.eye(4), atol=0.015)


def test_the_response_curve_is_a_power():
    linear = simulate_background(PLAIN, None, quantise=False)
    curved = simulate_background(replace(PLAIN, optics=Optics(response_gamma=2.2)), None, quantise=False)
    np.testing.assert_allclose(curved, 255 * (linear / 255) ** (1 / 2.2), rtol=1e-6)


@pytest.mark.parametrize("gamma", [0.6, 1.2, 2.2])
def test_the_table_of_the_response_is_the_response(gamma):
    sensor = exposed(replace(PLAIN, optics=Optics(response_gamma=gamma)), 100)
    grey = simulate_press(sensor, Ball(2), depth_mm=0.5, rng=None).image
    exact = simulate_press(sensor, Ball(2), depth_mm=0.5, rng=None, quantise=False).image
    assert np.abs(grey - np.clip(exact, 0, 255)).max() < 0.51


def test_levels_under_zero_are_saturated_too():
    cut = np.full((2, 3, 3), 100.0)
    cut[0, 1, 2], cut[1, 0, 0] = -2.0, 300.0
    assert np.argwhere(saturated_from_levels(cut)).tolist() == [[0, 1], [1, 0]]


def test_jpeg_leaves_its_blocks():
    sensor = exposed(replace(PLAIN, leds=PLAIN.leds, noise_sd=3.0), 100)
    rough = replace(sensor, optics=Optics(jpeg_quality=10))
    image = simulate_background(rough, np.random.default_rng(0)).astype(float)
    steps = np.abs(np.diff(image, axis=1)).mean(axis=(0, 2))
    borders = steps[7::8].mean()
    assert borders > 1.5 * np.delete(steps, np.arange(7, 79, 8)).mean()


@pytest.mark.parametrize("gamma", [1.0, 2.2])
@pytest.mark.parametrize("noisy", [True, False])
def test_the_kernel_rounds_what_numpy_makes(noisy, gamma):
    rng = np.random.default_rng(0)
    levels = rng.uniform(-20, 280, (30, 41, 3)).astype(np.float32)
    drawn = draws(rng, levels.size).reshape(levels.shape) if noisy else None
    curve = None if gamma == 1 else grey_levels.response_table(gamma)

    def reference(levels, drawn, normal, curve, grey, variance, gain):
        if drawn is not None:
            levels = levels + np.sqrt(variance + gain * np.maximum(levels, 0)) * normal[drawn]
        if curve is not None:
            place = (len(curve) - 1) * np.sqrt(np.maximum(levels, 0) * np.float32(1 / 255))
            whole = np.minimum(place.astype(int), len(curve) - 2)
            levels = curve[whole] + (place - whole) * (curve[whole + 1] - curve[whole])
        return np.rint(np.clip(levels, 0, 255)).astype(np.uint8)

    grey = np.empty(levels.shape, np.uint8)
    assert_kernel_agrees(
        grey_levels._grey_levels, reference, levels, drawn, normal_table(), curve, grey,
        np.float32(1.5), np.float32(0.02),
    )  # fmt: skip
