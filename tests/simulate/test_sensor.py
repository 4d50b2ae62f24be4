"""LEDs, coating, a sensor as settings and back; where pixels look, levels, noise, response, rounding, JPEG."""

import json
from dataclasses import replace

import numpy as np
import pytest

from gelform.sensors.profiles import SENSORS
from gelform.sensors.simulated import sensor_from_settings
from gelform.simulate import (
    LAYOUTS,
    Ball,
    Coating,
    Led,
    Optics,
    Pose,
    SimulatedSensor,
    Timing,
    exposed,
    led_color,
    light,
    simulate_background,
    simulate_pose,
    simulate_press,
)
from gelform.simulate.light import draws, maps_from_depth, normal_table, px_from_mm, texture_gradients
from gelform.simulate.sensor import led_ring, settings_from_sensor
from kernel_agreement import assert_kernel_agrees
from made.sources import PLAIN, SMALL


def test_a_ring_goes_round_as_its_angles_say_and_colors_land_in_their_channels():
    right, down = led_ring(10.0, 5.0, (0, 90), ((1, 0, 0), (0, 1, 0)))
    np.testing.assert_allclose(right.position_mm, (10, 0, 5), atol=1e-9)
    np.testing.assert_allclose(down.position_mm, (0, 10, 5), atol=1e-9)
    assert [np.argmax(led_color(peak_nm)) for peak_nm in (625, 530, 465)] == [0, 1, 2]
    assert led_color(465)[2] > led_color(480)[2]


def test_leds_drift_and_flicker():
    sensor = replace(PLAIN, timing=Timing(drift=(0.2, -0.1, 0.0), drift_time_s=10.0))
    settings = {"rng": None, "quantise": False}
    first, later = (simulate_pose(sensor, Ball(2), Pose(0), time_s=t, **settings).image for t in (0.0, 10.0))
    part = 1 - np.exp(-1)
    np.testing.assert_allclose((later / first).mean((0, 1)), [1 + 0.2 * part, 1 - 0.1 * part, 1], rtol=1e-6)
    rolling = replace(PLAIN, timing=Timing(flicker=0.1, flicker_hz=100, readout_s=0.03))
    rows = (simulate_pose(rolling, Ball(2), Pose(0), time_s=0.0013, **settings).image / first)[:, 0, 0]
    assert np.count_nonzero(np.diff(np.sign(rows - 1))) == 6
    assert rows.max() == pytest.approx(1.1, abs=0.01)


def test_settings_make_the_same_sensor_again():
    for sensor in (*LAYOUTS.values(), *(known.simulated() for known in SENSORS.values())):
        assert sensor_from_settings(json.loads(json.dumps(settings_from_sensor(sensor)))) == sensor


def test_an_albedo_map_comes_through():
    sensor = replace(LAYOUTS["ring-120"], coating=Coating(albedo=np.linspace(0.2, 1, 12).reshape(3, 4)))
    again = sensor_from_settings(json.loads(json.dumps(settings_from_sensor(sensor))))
    np.testing.assert_array_equal(again.coating.albedo.values, sensor.coating.albedo.values)


def test_the_texture_is_the_slope_of_one_surface():
    slopes = texture_gradients(Coating(roughness=0.05, scratches=4, grain_mm=0.4, seed=3), (60, 80), 0.1, 1)
    along_y, along_x = np.gradient(slopes[..., 0], axis=0), np.gradient(slopes[..., 1], axis=1)
    inner = (slice(2, -2), slice(2, -2))
    np.testing.assert_allclose(along_y[inner], along_x[inner], atol=1e-4)
    assert np.abs(along_y).max() > 0.01


def test_markers_are_as_large_as_said():
    coating = Coating(marker_pitch_mm=2.0, marker_radius_mm=0.3)
    press = simulate_pose(replace(PLAIN, coating=coating), Ball(2), Pose(0), rng=None)
    dark = (1 - press.albedo).sum() / 0.9 * 0.1**2
    assert dark / (60 * 80 * 0.1**2) == pytest.approx(np.pi * 0.3**2 / 2.0**2, rel=0.1)


def test_roughness_shades_but_is_no_depth():
    press, other, smooth = (
        simulate_press(replace(PLAIN, coating=coating), Ball(2), depth_mm=0.5, rng=None)
        for coating in (*(Coating(roughness=0.05, scratches=3, seed=k) for k in (1, 2)), Coating())
    )
    np.testing.assert_array_equal(press.depth_mm, smooth.depth_mm)
    assert 0.5 < (press.image.astype(float) - smooth.image).std() < 30
    assert np.any(other.image != press.image)


def test_albedo_and_dust_multiply_the_light():
    albedo = np.linspace(0.5, 1, 60 * 80).reshape(60, 80)
    painted = simulate_background(replace(PLAIN, coating=Coating(albedo=albedo)), None, quantise=False)
    np.testing.assert_allclose(painted, clean() * albedo[..., None], rtol=1e-6)
    dusty = simulate_pose(replace(PLAIN, coating=Coating(dust=5)), Ball(2), Pose(0), rng=None)
    assert 0 < np.count_nonzero(dusty.albedo != 1) < 200


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


@pytest.mark.parametrize("gamma", [0.6, 1.0, 1.2, 2.2])
def test_single_precision_and_the_table_of_the_response_are_exact(gamma):
    sensor = exposed(replace(PLAIN, optics=Optics(response_gamma=gamma)), 100)
    gray = simulate_press(sensor, Ball(2), depth_mm=0.5, rng=None).image
    exact = simulate_press(sensor, Ball(2), depth_mm=0.5, rng=None, quantise=False).image
    assert np.abs(gray - np.clip(exact, 0, 255)).max() < 0.51


def test_jpeg_leaves_its_blocks():
    sensor = exposed(replace(PLAIN, leds=PLAIN.leds, noise_sd=3.0), 100)
    rough = replace(sensor, optics=Optics(jpeg_quality=10))
    image = simulate_background(rough, np.random.default_rng(0)).astype(float)
    steps = np.abs(np.diff(image, axis=1)).mean(axis=(0, 2))
    borders = steps[7::8].mean()
    assert borders > 1.5 * np.delete(steps, np.arange(7, 79, 8)).mean()


def test_the_kernel_rounds_what_numpy_makes():
    def reference(levels, drawn, normal, curve, gray, variance, gain):
        if drawn is not None:
            levels = levels + np.sqrt(variance + gain * np.maximum(levels, 0)) * normal[drawn]
        if curve is not None:
            place = (len(curve) - 1) * np.sqrt(np.maximum(levels, 0) * np.float32(1 / 255))
            whole = np.minimum(place.astype(int), len(curve) - 2)
            levels = curve[whole] + (place - whole) * (curve[whole + 1] - curve[whole])
        return np.rint(np.clip(levels, 0, 255)).astype(np.uint8)

    assert_kernel_agrees(light._gray_levels, reference)
