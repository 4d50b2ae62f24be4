"""Coating, optics, timing and the camera."""

import re
from dataclasses import replace

import numpy as np
import pytest

from gelform.simulate import (
    LAYOUTS,
    Ball,
    Coating,
    Gel,
    Led,
    Optics,
    Pose,
    SimulatedSensor,
    Timing,
    exposed,
    led_color,
    simulate_background,
    simulate_pose,
    simulate_press,
)
from gelform.simulate.gel.gel import surface_from_ball
from gelform.simulate.light.scattering import spread_in_gel
from gelform.simulate.light.shadows import shadowed_from_surface, visible_from_surface
from gelform.simulate.sensor.coating import texture_gradients
from gelform.simulate.sensor.grey_levels import draws, normal_table, saturated_from_levels
from gelform.simulate.sensor.led import led_ring
from gelform.simulate.sensor.projection import maps_from_depth, px_seen

PLAIN = SimulatedSensor(
    (Led((-9, 2, 8), (9000, 500, 0)), Led((5, 9, 8), (0, 9000, 8000))), shape=(60, 80), mm_per_px=0.1
)
FAR = Led((1e5, 0, 1e5), (1e12, 1e12, 1e12), size_mm=0.0)


def levels(sensor, **settings):
    return simulate_press(
        sensor, Ball(2), **{"depth_mm": 0.5, "rng": None, "quantise": False, "oversample": 1} | settings
    ).image


def test_single_and_double_precision_agree():
    grey = simulate_press(PLAIN, Ball(2), depth_mm=0.5, rng=None).image
    exact = simulate_press(PLAIN, Ball(2), depth_mm=0.5, rng=None, quantise=False).image
    assert np.abs(grey - np.clip(exact, 0, 255)).max() < 0.501


def test_a_beam_falls_off_with_its_power_of_the_cosine():
    led = Led((0, 0, 5), (1000, 0, 0))
    wide, narrow = (
        simulate_background(replace(PLAIN, leds=(replace(led, beam_power=m),)), None, quantise=False)
        for m in (0, 3)
    )
    x, y = PLAIN.grid_mm()
    cosine = 5 / np.sqrt(x**2 + y**2 + 25)
    np.testing.assert_allclose(narrow[..., 0], wide[..., 0] * cosine**3, rtol=1e-9)


def test_gloss_is_brightest_where_the_surface_mirrors_the_light():
    led = Led((-20, 0, 20), (1e5, 0, 0))
    sensor = replace(PLAIN, leds=(led,), shape=(61, 81))
    press = simulate_press(
        replace(sensor, coating=Coating(specular=0.5, shininess=64)),
        Ball(3),
        depth_mm=1.0,
        rng=None,
        quantise=False,
    )
    matte = simulate_press(sensor, Ball(3), depth_mm=1.0, rng=None, quantise=False)
    gloss = press.image[..., 0] - matte.image[..., 0]
    row, column = np.unravel_index(np.argmax(gloss), gloss.shape)
    normal = press.normals[row, column]
    to_light = np.array([-20, 0, 20]) - np.array(
        [(column - 40) * 0.1, (row - 30) * 0.1, press.depth_mm[row, column]]
    )
    half = to_light / np.linalg.norm(to_light) + np.array([0, 0, 1])
    assert normal @ half / np.linalg.norm(half) > 0.999
    assert gloss.min() > -1e-9


@pytest.mark.parametrize("shininess", [1, 2, 16])
def test_gloss_is_the_power_of_the_half_angle(shininess):
    led = Led((-20, 0, 20), (1e5, 0, 0))
    settings = {"rng": None, "quantise": False, "oversample": 1}
    coating = Coating(specular=0.5, shininess=shininess)
    matte, glossy = (
        simulate_pose(replace(PLAIN, leds=(led,), coating=c), Ball(2), Pose(0), **settings).image[..., 0]
        for c in (Coating(), coating)
    )
    x, y = PLAIN.grid_mm()
    to_light = np.stack(np.broadcast_arrays(-20 - x, -y, 20.0), axis=-1)
    square = np.sum(to_light**2, axis=-1)
    half = to_light / np.sqrt(square)[..., None] + np.array([0, 0, 1])
    cosine = half[..., 2] / np.linalg.norm(half, axis=-1)
    np.testing.assert_allclose(glossy - matte, 0.5 * 1e5 * cosine**shininess / square, rtol=1e-9)


def test_a_far_low_light_casts_the_shadow_that_geometry_says():
    sensor = replace(
        PLAIN, leds=(Led((-1e4, 0, 5e3), (1e9, 1e9, 1e9), size_mm=0),), shape=(61, 161), mm_per_px=0.05
    )
    settings = {"center_mm": (-2.0, 0.0), "depth_mm": 0.8, "rng": None, "quantise": False, "oversample": 1}
    free = simulate_press(sensor, Ball(1.0), **settings)
    dark = simulate_press(replace(sensor, cast_shadows=True), Ball(1.0), **settings)
    row, x = free.depth_mm[30], sensor.grid_mm()[0][0]
    horizon = np.maximum.accumulate(row + 0.5 * x)  # light comes from the left, falling 0.5 mm per mm
    hidden = row + 0.5 * x < horizon - 0.02
    assert 10 < hidden.sum() < 60
    assert np.all(dark.image[30][hidden] < 1e-6)
    clear = row + 0.5 * x >= horizon
    np.testing.assert_allclose(dark.image[30][clear][:-1], free.image[30][clear][:-1], rtol=1e-6)
    assert np.all(dark.shadowed[30][hidden])


def test_larger_lights_cast_softer_shadows():
    grid = PLAIN.grid_mm()
    surface = surface_from_ball(Ball(1), *grid, center_mm=(0, 0), depth_mm=0.8, relaxation_mm=0.3)
    small, large = (
        visible_from_surface(surface, (Led((-15, 0, 7), (1, 1, 1), size_mm=s),))[0] for s in (0.5, 5.0)
    )
    partial = [np.count_nonzero((v > 0.02) & (v < 0.98)) for v in (small, large)]
    assert partial[1] > 2 * partial[0]
    assert min(small.min(), large.min()) == 0


def test_shadows_take_light_and_never_give():
    for name, sensor in LAYOUTS.items():
        free = levels(sensor, depth_mm=0.8)
        dark = levels(replace(sensor, cast_shadows=True), depth_mm=0.8)
        assert np.all(dark <= free + 1e-6), name
        background = simulate_background(replace(sensor, cast_shadows=True), None, quantise=False)
        np.testing.assert_array_equal(background, simulate_background(sensor, None, quantise=False))


def test_turning_light_and_surface_turns_the_shadow():
    sensor = replace(PLAIN, shape=(61, 61))
    settings = {"depth_mm": 0.8, "relaxation_mm": 0.3}
    first = surface_from_ball(Ball(1), *sensor.grid_mm(), center_mm=(0.7, 0.3), **settings)
    turned = surface_from_ball(Ball(1), *sensor.grid_mm(), center_mm=(-0.3, 0.7), **settings)
    for x, y in ((-15.0, 2.0), (15.0, 2.0), (3.0, -15.0), (3.0, 15.0)):
        seen = visible_from_surface(first, (Led((x, y, 6.0), (1, 1, 1)),))[0]
        again = visible_from_surface(turned, (Led((-y, x, 6.0), (1, 1, 1)),))[0]
        np.testing.assert_allclose(again, np.rot90(seen, k=-1), atol=2e-3)
        rows, columns = np.nonzero(seen < 0.5)
        away = np.array([columns.mean() - 37, rows.mean() - 33]) @ np.array([x, y])
        assert away < 0  # the shadow lies on the side that is turned from the light


@pytest.mark.parametrize("place", [(-9.0, 2.0, 4.0), (0.5, 8.0, 4.0), (7.0, -7.0, 5.0)])
def test_attached_shadows_are_where_the_light_lies_behind_the_surface(place):
    grid = PLAIN.grid_mm()
    surface = surface_from_ball(Ball(1), *grid, center_mm=(0.5, -1), depth_mm=0.8, relaxation_mm=0.3)
    lost = shadowed_from_surface(surface, (Led(place, (1, 1, 1)),), None)
    to_light = np.stack(
        np.broadcast_arrays(place[0] - grid[0], place[1] - grid[1], place[2] - surface.depth_mm)
    )
    facing = to_light[2] - np.sum(surface.gradients * np.moveaxis(to_light[:2], 0, -1), axis=-1)
    np.testing.assert_array_equal(lost, facing <= 0)
    assert lost.any()


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


def test_a_ring_goes_round_as_its_angles_say():
    right, down = led_ring(10.0, 5.0, (0, 90), ((1, 0, 0), (0, 1, 0)))
    np.testing.assert_allclose(right.position_mm, (10, 0, 5), atol=1e-9)
    np.testing.assert_allclose(down.position_mm, (0, 10, 5), atol=1e-9)


def test_levels_under_zero_are_saturated_too():
    cut = np.full((2, 3, 3), 100.0)
    cut[0, 1, 2], cut[1, 0, 0] = -2.0, 300.0
    assert np.argwhere(saturated_from_levels(cut)).tolist() == [[0, 1], [1, 0]]


def test_scattering_keeps_the_light_and_interreflection_adds_to_it():
    rng = np.random.default_rng(0)
    light = np.zeros((96, 128, 3))
    light[40:50, 60:70] = rng.uniform(50, 100, (10, 10, 3))
    scattered = spread_in_gel(light, Coating(scattering=0.5, scattering_mm=0.4), 0.1)
    assert scattered.sum() == pytest.approx(light.sum(), rel=0.01)
    assert scattered.max() < light.max()
    bounced = spread_in_gel(light, Coating(interreflection=0.2, interreflection_mm=1.0), 0.1)
    assert bounced.sum() == pytest.approx(1.2 * light.sum(), rel=0.01)


def test_roughness_shades_but_is_no_depth():
    rough = replace(PLAIN, coating=Coating(roughness=0.05, scratches=3, seed=1))
    press = simulate_press(rough, Ball(2), depth_mm=0.5, rng=None)
    smooth = simulate_press(PLAIN, Ball(2), depth_mm=0.5, rng=None)
    np.testing.assert_array_equal(press.depth_mm, smooth.depth_mm)
    change = press.image.astype(float) - smooth.image
    assert 0.5 < change.std() < 30
    other = simulate_press(
        replace(rough, coating=Coating(roughness=0.05, scratches=3, seed=2)), Ball(2), depth_mm=0.5, rng=None
    )
    assert np.any(other.image != press.image)


def test_albedo_and_dust_multiply_the_light():
    albedo = np.linspace(0.5, 1, 60 * 80).reshape(60, 80)
    painted = simulate_background(replace(PLAIN, coating=Coating(albedo=albedo)), None, quantise=False)
    np.testing.assert_allclose(
        painted, simulate_background(PLAIN, None, quantise=False) * albedo[..., None], rtol=1e-6
    )
    dusty = simulate_pose(replace(PLAIN, coating=Coating(dust=5)), Ball(2), Pose(0), rng=None)
    assert 0 < np.count_nonzero(dusty.albedo != 1) < 200


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
    corner = px_seen(sensor, [(2.0, -1.5)])[0]
    j, i = np.round(corner).astype(int)
    looked_at = np.array([maps[0][i, j], maps[1][i, j]])
    straight = px_seen(PLAIN, [(2.0, -1.5)])[0]
    assert np.linalg.norm(corner - straight) > 0.5
    np.testing.assert_allclose(looked_at - straight, [j, i] - corner, atol=0.2)


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


def test_noise_is_normal():
    drawn = normal_table()[draws(np.random.default_rng(5), 400_001)].astype(np.float64)
    assert drawn.shape == (400_001,)
    moments = [np.mean(drawn**k) for k in (1, 2, 3, 4)]
    np.testing.assert_allclose(moments, [0, 1, 0, 3], atol=0.03)
    assert np.mean(np.abs(drawn) > 2.5758) == pytest.approx(0.01, rel=0.1)
    neighbours = drawn[: 4 * 100_000].reshape(-1, 4)
    np.testing.assert_allclose(np.corrcoef(neighbours.T), np.eye(4), atol=0.015)


def test_exposure_times_light_and_noise_with_it():
    quiet = simulate_background(PLAIN, None, quantise=False)
    twice = simulate_background(replace(PLAIN, optics=Optics(exposure=2.0)), None, quantise=False)
    np.testing.assert_allclose(twice, 2 * quiet, rtol=1e-9)


@pytest.mark.parametrize("gamma", [1.0, 1.8])
def test_exposed_gives_the_levels_behind_the_response(gamma):
    sensor = exposed(replace(PLAIN, optics=Optics(response_gamma=gamma)), (60, 80, 100))
    np.testing.assert_allclose(
        simulate_background(sensor, None, quantise=False).mean((0, 1)), (60, 80, 100), rtol=1e-6
    )


def test_jpeg_leaves_its_blocks():
    sensor = exposed(replace(PLAIN, leds=PLAIN.leds, noise_sd=3.0), 100)
    rough = replace(sensor, optics=Optics(jpeg_quality=10))
    image = simulate_background(rough, np.random.default_rng(0)).astype(float)
    steps = np.abs(np.diff(image, axis=1)).mean(axis=(0, 2))
    borders = steps[7::8].mean()
    assert borders > 1.5 * np.delete(steps, np.arange(7, 79, 8)).mean()


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


def test_the_truth_says_which_pixels_are_saturated():
    bright = replace(PLAIN, optics=Optics(exposure=4.0))
    press = simulate_press(bright, Ball(2), depth_mm=0.5, rng=None)
    exact = simulate_press(bright, Ball(2), depth_mm=0.5, rng=None, quantise=False).image
    np.testing.assert_array_equal(press.saturated, (exact > 255.5).any(axis=-1))
    assert np.all((press.image == 255).any(axis=-1)[press.saturated])
    assert 0 < press.saturated.mean() < 1


def test_colours_of_leds_land_in_their_channels():
    assert np.argmax(led_color(625)) == 0
    assert np.argmax(led_color(530)) == 1
    assert np.argmax(led_color(465)) == 2
    assert led_color(465)[2] > led_color(480)[2]


def test_shading_is_a_gain_over_the_image():
    shading = ((2, 0.1, 0, 0, 0, 0), (1, 0, -0.2, 0, 0, 0), (1, 0, 0, 0.1, 0.05, 0.3))
    ratio = simulate_background(replace(PLAIN, shading=shading), None, quantise=False) / simulate_background(
        PLAIN, None, quantise=False
    )
    np.testing.assert_allclose(ratio[0, -1, :2], [2 * 1.1, 1.2], rtol=1e-9)
    np.testing.assert_allclose(ratio[-1, 0, 2], 1 + 0.1 - 0.05 + 0.3, rtol=1e-9)


REFUSED = [
    (lambda: Led((0, 0, 2), (1, 1, 1), beam_power=-1), "beam_power"),
    (lambda: Led((0, 0, 2), (1, 1, 1), aim_mm=(0, 0, 2)), "aim_mm"),
    (lambda: replace(PLAIN, leds=(Led((1, 0, 1), (1, 1, 1)),)), "outside the gel"),
    (lambda: replace(PLAIN, shading=((1, 2),)), "shading"),
    (lambda: Coating(specular=-1), "specular"),
    (lambda: Coating(shininess=10), "power of two"),
    (lambda: Coating(scattering=1.0), "scattering"),
    (lambda: Coating(marker_pitch_mm=0.3), "marker_pitch_mm"),
    (lambda: Coating(albedo=np.full((3, 3), 2.0)), "albedo"),
    (lambda: Optics(height_mm=0.1), "height_mm"),
    (lambda: Optics(distortion=(-0.6, 0)), "fold"),
    (lambda: Optics(jpeg_quality=0), "jpeg_quality"),
    (lambda: Optics(response_gamma=0), "response_gamma"),
    (lambda: Timing(readout_s=1.0), "readout_s"),
    (lambda: Timing(drop_probability=1.0), "drop_probability"),
    (lambda: Timing(frame_rate_hz=0), "frame_rate_hz"),
    (lambda: led_color(900), "peak_nm"),
    (
        lambda: simulate_press(replace(PLAIN, gel=Gel(1.0)), Ball(3), depth_mm=1.2, rng=None),
        "gel's thickness",
    ),
]


@pytest.mark.parametrize(("make", "message"), REFUSED)
def test_bad_settings_are_refused_with_the_reason(make, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        make()
