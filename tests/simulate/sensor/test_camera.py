"""Where pixels look, linear levels, noise, response, rounding, JPEG."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.simulate import Ball, Led, Optics, SimulatedSensor, exposed, simulate_background, simulate_press
from gelform.simulate.sensor import camera
from gelform.simulate.sensor.camera import (
    draws,
    maps_from_depth,
    normal_table,
    px_from_mm,
    saturated_from_levels,
)
from kernel_agreement import assert_kernel_agrees
from made.sensors import PLAIN, SMALL


def clean(sensor=PLAIN, **settings):
    """The untouched gel without noise and rounding."""
    return simulate_background(replace(sensor, **settings), None, quantise=False)


def test_exposure_and_shading_are_gains_and_the_response_a_power():
    np.testing.assert_allclose(clean(optics=Optics(exposure=2.0)), 2 * clean(), rtol=1e-9)
    shading = ((2, 0.1, 0, 0, 0, 0), (1, 0, -0.2, 0, 0, 0), (1, 0, 0, 0.1, 0.05, 0.3))
    ratio = clean(shading=shading) / clean()
    np.testing.assert_allclose(ratio[0, -1, :2], [2 * 1.1, 1.2], rtol=1e-9)
    np.testing.assert_allclose(ratio[-1, 0, 2], 1 + 0.1 - 0.05 + 0.3, rtol=1e-9)
    curved = 255 * (clean() / 255) ** (1 / 2.2)
    np.testing.assert_allclose(clean(optics=Optics(response_gamma=2.2)), curved, rtol=1e-6)


def test_vignetting_darkens_the_corners():
    ratio = clean(SMALL, vignetting=0.4, blur_px=0.0) / clean(SMALL, vignetting=0.0, blur_px=0.0)
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


def test_a_pinhole_sees_what_is_pressed_larger():
    sensor = replace(PLAIN, optics=Optics(height_mm=10.0))
    ball = {"depth_mm": 0.9, "center_mm": (1.5, 1.0), "rng": None, "oversample": 1}
    straight, pinhole = simulate_press(PLAIN, Ball(3), **ball), simulate_press(sensor, Ball(3), **ball)
    assert pinhole.contact.sum() > 1.02 * straight.contact.sum()
    y, x = np.nonzero(pinhole.contact)
    assert pinhole.center_px == pytest.approx((x.mean(), y.mean()), abs=0.6)
    assert pinhole.contact_radius_px == pytest.approx(np.sqrt(pinhole.contact.sum() / np.pi), rel=0.02)
    top = np.unravel_index(np.argmax(pinhole.depth_mm), (60, 80))
    away = np.array([1.5, 1.0]) / 0.1 / (1 - 0.9 / 10)
    assert (top[1] - 39.5, top[0] - 29.5) == pytest.approx(tuple(away), abs=1.2)


@pytest.mark.parametrize("k1", [-0.15, 0.1])
def test_distortion_moves_points_as_its_formula_says(k1):
    sensor = replace(PLAIN, optics=Optics(distortion=(k1, 0.02)))
    maps = maps_from_depth(sensor, np.zeros(PLAIN.shape))
    corner = px_from_mm(sensor, [(2.0, -1.5)])[0]
    j, i = np.round(corner).astype(int)
    looked_at = np.array([maps[0][i, j], maps[1][i, j]])
    straight = px_from_mm(PLAIN, [(2.0, -1.5)])[0]
    assert np.linalg.norm(corner - straight) > 0.5
    np.testing.assert_allclose(looked_at - straight, [j, i] - corner, atol=0.2)


def test_noise_is_as_asked_and_quantisation_rounds():
    sensor = replace(SMALL, noise_sd=1.5, noise_gain=0.02)
    noisy = simulate_background(sensor, np.random.default_rng(0), quantise=False)
    scaled = (noisy - clean(sensor)) / np.sqrt(1.5**2 + 0.02 * clean(sensor))
    assert scaled.std() == pytest.approx(1, abs=0.03)
    assert scaled.mean() == pytest.approx(0, abs=0.03)
    rounded = simulate_background(sensor, None)
    assert rounded.dtype == np.uint8
    np.testing.assert_array_equal(rounded, np.rint(clean(sensor)))
    for one in (sensor, replace(SMALL, noise_sd=0.0, noise_gain=0.0)):
        with pytest.raises(TypeError, match="Expected rng as Generator, got int"):
            simulate_background(one, 3)


def test_noise_is_normal():
    drawn = normal_table()[draws(np.random.default_rng(5), 400_001)].astype(np.float64)
    assert drawn.shape == (400_001,)
    moments = [np.mean(drawn**k) for k in (1, 2, 3, 4)]
    np.testing.assert_allclose(moments, [0, 1, 0, 3], atol=0.03)
    assert np.mean(np.abs(drawn) > 2.5758) == pytest.approx(0.01, rel=0.1)
    neighbors = drawn[: 4 * 100_000].reshape(-1, 4)
    np.testing.assert_allclose(np.corrcoef(neighbors.T), np.eye(4), atol=0.015)


@pytest.mark.parametrize("gamma", [0.6, 1.2, 2.2])
def test_the_table_of_the_response_is_the_response(gamma):
    sensor = exposed(replace(PLAIN, optics=Optics(response_gamma=gamma)), 100)
    gray = simulate_press(sensor, Ball(2), depth_mm=0.5, rng=None).image
    exact = simulate_press(sensor, Ball(2), depth_mm=0.5, rng=None, quantise=False).image
    assert np.abs(gray - np.clip(exact, 0, 255)).max() < 0.51


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
    curve = None if gamma == 1 else camera.response_table(gamma)

    def reference(levels, drawn, normal, curve, gray, variance, gain):
        if drawn is not None:
            levels = levels + np.sqrt(variance + gain * np.maximum(levels, 0)) * normal[drawn]
        if curve is not None:
            place = (len(curve) - 1) * np.sqrt(np.maximum(levels, 0) * np.float32(1 / 255))
            whole = np.minimum(place.astype(int), len(curve) - 2)
            levels = curve[whole] + (place - whole) * (curve[whole + 1] - curve[whole])
        return np.rint(np.clip(levels, 0, 255)).astype(np.uint8)

    gray = np.empty(levels.shape, np.uint8)
    assert_kernel_agrees(
        camera._gray_levels, reference, levels, drawn, normal_table(), curve, gray,
        np.float32(1.5), np.float32(0.02),
    )  # fmt: skip
