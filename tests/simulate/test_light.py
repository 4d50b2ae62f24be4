"""Light on a surface against analytic light; cast shadows; scattering; the untouched gel and its exposure."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.simulate import (
    Ball,
    Coating,
    Led,
    Optics,
    Pose,
    SimulatedSensor,
    exposed,
    light,
    simulate_background,
    simulate_pose,
    simulate_press,
)
from gelform.simulate.gel import Surface, surface_from_indenter
from gelform.simulate.light import (
    irradiance_from_surface,
    saturated_from_levels,
    shadowed_from_surface,
    spread_in_gel,
    visible_from_surface,
)
from gelform.slopes.normals import image_from_normals
from kernel_agreement import assert_kernel_agrees
from made.sources import PLAIN, SMALL

WHITE = (1.0, 1.0, 1.0)


def sensor_with(*leds, **settings):
    return SimulatedSensor(leds, **{"shape": (40, 50), "mm_per_px": 0.1} | settings)


def exact(sensor, ball_mm=3.0, **settings):
    """A press without noise and rounding."""
    return simulate_press(
        sensor, Ball(ball_mm), **{"depth_mm": 0.5, "rng": None, "quantise": False} | settings
    )


def plane(x, y, slope_x, slope_y):
    z = slope_x * x + slope_y * y
    gradients = np.empty((*z.shape, 2))
    gradients[...] = slope_x, slope_y
    return Surface(x, y, z, gradients, np.zeros(z.shape, dtype=bool))


@pytest.mark.parametrize(("slope_x", "slope_y"), [(0.0, 0.0), (0.3, -0.2), (-0.5, 0.4), (0.9, 2.0), (3, -3)])
def test_one_light_on_a_plane_is_lamberts_law(slope_x, slope_y):
    light, strength = np.array([4.0, -3.0, 6.0]), 100.0
    sensor = sensor_with(Led(tuple(light), (strength, 0, 0)))
    x, y = sensor.grid_mm()
    levels = irradiance_from_surface(plane(x, y, slope_x, slope_y), sensor.leds)
    z = slope_x * x + slope_y * y
    normal = np.array([-slope_x, -slope_y, 1]) / np.sqrt(1 + slope_x**2 + slope_y**2)
    to_light = light - np.stack(np.broadcast_arrays(x, y, z), axis=-1)
    distance = np.linalg.norm(to_light, axis=-1)
    expected = strength * np.maximum(to_light @ normal, 0) / distance**3
    np.testing.assert_allclose(levels[..., 0], expected, rtol=1e-12)
    assert np.all(levels[..., 1:] == 0)
    assert np.all(levels[..., 0] == 0) == (slope_x == 3), "no light from behind"


def test_far_lights_agree_with_the_packages_own_shading():
    directions = np.array([[0.6, 0.1, 0.8], [-0.3, 0.5, 0.8], [-0.2, -0.6, 0.77]])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    far = 1e6
    leds = (Led(tuple(far * d), tuple(far**2 * 100 * np.eye(3)[c])) for c, d in enumerate(directions))
    press = exact(sensor_with(*leds), depth_mm=0.8, oversample=1)
    np.testing.assert_allclose(press.image, image_from_normals(press.normals, 100 * directions), atol=2e-3)


def test_a_pixel_is_the_mean_of_its_subpixels():
    led = Led((3, 2, 4), (100, 50, 20))
    x, y = sensor_with(led).grid_mm(oversample=3)
    z = 0.1 * np.sin(2 * x) * np.cos(3 * y)
    gradients = np.stack([0.2 * np.cos(2 * x) * np.cos(3 * y), -0.3 * np.sin(2 * x) * np.sin(3 * y)], axis=-1)
    surface = Surface(x, y, z, gradients, np.zeros(z.shape, dtype=bool))
    fine = irradiance_from_surface(surface, (led,))
    mean = fine.reshape(40, 3, 50, 3, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(irradiance_from_surface(surface, (led,), oversample=3), mean, rtol=1e-12)


def test_a_beam_falls_off_with_its_power_of_the_cosine():
    led = Led((0, 0, 5), (1000, 0, 0))
    beams = (replace(PLAIN, leds=(replace(led, beam_power=power),)) for power in (0, 3))
    wide, narrow = (simulate_background(one, None, quantise=False) for one in beams)
    x, y = PLAIN.grid_mm()
    cosine = 5 / np.sqrt(x**2 + y**2 + 25)
    np.testing.assert_allclose(narrow[..., 0], wide[..., 0] * cosine**3, rtol=1e-9)


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


@pytest.mark.parametrize("oversample", [1, 3])
@pytest.mark.parametrize("shininess", [1, 16])
def test_the_kernel_is_the_formula_on_every_instruction_set(oversample, shininess):
    rng = np.random.default_rng(1)
    sensor = sensor_with(
        Led((4, 1, 5), (90, 10, 0), beam_power=2), Led((-3, 2, 4), (0, 50, 20)), shape=(20, 300)
    )
    x, y = (axis.ravel() for axis in sensor.grid_mm(oversample))
    z = 0.2 * np.sin(x) * np.cos(y)[:, None]
    gradients = rng.uniform(-1, 1, (*z.shape, 2))
    texture = rng.uniform(-0.1, 0.1, (*z.shape, 2)).astype(np.float32)
    visible = rng.uniform(0, 1, (2, 20, 300)).astype(np.float32)
    doublings = shininess.bit_length() - 1

    def reference(x, y, z, gradients, texture, table, visible, out, specular, doublings, oversample):
        surface = Surface(x[None], y[:, None], z, gradients + texture, z > 0)
        return light.exact_irradiance(
            surface, table.astype(float), visible.repeat(oversample, 1).repeat(oversample, 2)[:, ::oversample, ::oversample],
            oversample, specular, doublings,
        )  # fmt: skip

    assert_kernel_agrees(
        light._irradiance, reference, x, y, z, gradients, texture,
        light._table(sensor.leds).astype(np.float32), visible, np.zeros((20, 300, 3), np.float32),
        0.3, doublings, oversample,
    )  # fmt: skip


def test_scattering_keeps_the_light_and_interreflection_adds_to_it():
    rng = np.random.default_rng(0)
    light = np.zeros((96, 128, 3))
    light[40:50, 60:70] = rng.uniform(50, 100, (10, 10, 3))
    scattered = spread_in_gel(light, Coating(scattering=0.5, scattering_mm=0.4), 0.1)
    assert scattered.sum() == pytest.approx(light.sum(), rel=0.01)
    assert scattered.max() < light.max()
    bounced = spread_in_gel(light, Coating(interreflection=0.2, interreflection_mm=1.0), 0.1)
    assert bounced.sum() == pytest.approx(1.2 * light.sum(), rel=0.01)


def test_a_far_low_light_casts_the_shadow_that_geometry_says():
    led = Led((-1e4, 0, 5e3), (1e9, 1e9, 1e9), size_mm=0)
    sensor = replace(PLAIN, leds=(led,), shape=(61, 161), mm_per_px=0.05)
    free, dark = (
        exact(one, 1.0, center_mm=(-2.0, 0.0), depth_mm=0.8, oversample=1)
        for one in (sensor, replace(sensor, cast_shadows=True))
    )
    row, x = free.depth_mm[30], sensor.grid_mm()[0][0]
    horizon = np.maximum.accumulate(row + 0.5 * x)  # light comes from the left, falling 0.5 mm per mm
    hidden = row + 0.5 * x < horizon - 0.02
    assert 10 < hidden.sum() < 60
    assert np.all(dark.image[30][hidden] < 1e-6)
    clear = row + 0.5 * x >= horizon
    np.testing.assert_allclose(dark.image[30][clear][:-1], free.image[30][clear][:-1], rtol=1e-6)
    assert np.all(dark.shadowed[30][hidden])


@pytest.mark.parametrize("along", ["x", "y"])
def test_a_near_lamp_casts_the_shadow_that_geometry_says(along):
    place = (-4.0, 0.0, 1.5) if along == "x" else (0.0, -4.0, 1.5)
    at = 0.05 * np.arange(-40, 61)
    grid = (at[None], at[:, None])
    surface = surface_from_indenter(Ball(1), *grid, center_mm=(0, 0), depth_mm=0.8, relaxation_mm=0.2)
    visible = visible_from_surface(surface, (Led(place, (1, 1, 1), size_mm=0),))[0]
    middle = np.s_[40, :] if along == "x" else np.s_[:, 40]
    depth, seen = surface.depth_mm[middle], visible[middle]
    over = [  # the slope to the highest sample on the way, over that to the lamp
        np.max((depth[:k] - depth[k]) / (at[k] - at[:k]), initial=-9) - (1.5 - depth[k]) / (at[k] + 4)
        for k in range(len(at))
    ]
    hidden = np.array(over) > 0.02
    assert hidden.sum() > 10
    assert np.all(seen[hidden] < 1e-6)
    assert np.all(seen[np.array(over) < -0.02] == 1)


@pytest.mark.parametrize("place", [(-9.0, 2.0, 4.0), (0.5, 8.0, 4.0), (7.0, -7.0, 5.0)])
def test_attached_shadows_are_where_the_light_lies_behind_the_surface(place):
    grid = PLAIN.grid_mm()
    surface = surface_from_indenter(Ball(1), *grid, center_mm=(0.5, -1), depth_mm=0.8, relaxation_mm=0.3)
    lost = shadowed_from_surface(surface, (Led(place, (1, 1, 1)),), None)
    to_light = np.stack(
        np.broadcast_arrays(place[0] - grid[0], place[1] - grid[1], place[2] - surface.depth_mm)
    )
    facing = to_light[2] - np.sum(surface.gradients * np.moveaxis(to_light[:2], 0, -1), axis=-1)
    np.testing.assert_array_equal(lost, facing <= 0)
    assert lost.any()


def marched(depth, leds, reach, seen, top, sharpest):
    """Every ray followed to its end, without the search for what can hide a light."""
    seen = seen.copy()
    for k, (x, y, z, size) in enumerate(leds):
        for i, j in np.ndindex(*depth.shape):
            dx, dy = x - j, y - i
            steps = max(abs(dx), abs(dy))
            rise, soft = (z - depth[i, j]) / steps, 0.5 * size / steps + sharpest
            for s in range(1, int(min((top - depth[i, j]) / rise + 1, steps)) + 1):
                row, column = i + s * (dy / steps), j + s * (dx / steps)
                if not (0 <= row < depth.shape[0] - 1 and 0 <= column < depth.shape[1] - 1):
                    break
                n, m = int(row), int(column)
                v, u = row - n, column - m
                there = (1 - v) * ((1 - u) * depth[n, m] + u * depth[n, m + 1])
                there += v * ((1 - u) * depth[n + 1, m] + u * depth[n + 1, m + 1])
                clear = (rise * s + depth[i, j] - there) / (s * soft)
                seen[k, i, j] = min(seen[k, i, j], np.clip(0.5 + 0.5 * clear, 0, 1))
    return seen


@pytest.mark.slow
@pytest.mark.parametrize("size", [0.5, 4.0])
def test_the_kernel_finds_what_every_ray_meets(size):
    x, y = np.meshgrid(np.arange(48), np.arange(40))
    depth = np.maximum(1 - np.hypot(x - 22.3, y - 18.7) / 8, 0) + 0.02 * np.sin(x) * np.cos(0.7 * y)
    depth = depth.astype(np.float32)
    leds = np.array([(-40.3, 11.2, 3.0, size), (60.1, 70.4, 4.0, size), (30.2, -50.6, 2.0, size)])
    top = float(depth.max())
    reach = light._reach(leds, depth.shape, top)
    seen = np.ones((3, 40, 48), np.float32)
    assert_kernel_agrees(light._visible_lights, marched, depth, leds, reach, seen, top, 1e-4, tolerance=1e-4)
    assert marched(depth, leds, reach, seen, top, 1e-4).min() < 0.1


def test_a_gentle_bump_hides_nothing():
    surface = surface_from_indenter(
        Ball(8), *PLAIN.grid_mm(), center_mm=(0, 0), depth_mm=0.2, relaxation_mm=0.5
    )
    assert visible_from_surface(surface, (Led((-8.0, 2.0, 9.0), (1, 1, 1)),)) is None


def test_lights_at_the_border_and_under_the_surface_are_seen():
    """Rays that have no room, or do not rise, meet nothing."""
    depth = np.zeros((6, 8), dtype=np.float32)
    depth[2:4, 3:5] = 1
    leds = np.array(
        [(-20.0, 0.0, 3.0, 1.0), (-20.0, 5.0, 3.0, 1.0), (3.0, -20.0, 0.5, 1.0), (3.0, 2.0, 1.0, 1.0)]
    )
    seen = np.ones((4, 6, 8), np.float32)
    light._visible_lights(depth, leds, np.full(4, 8), seen, 1.0, 1e-5)
    assert np.all((seen >= 0) & (seen <= 1))
    assert np.all(seen[0, 0] == 1)
    assert np.all(seen[1, 5] == 1)
    assert np.all(seen[2, 2:4, 3:5] == 1)
    assert seen[0].min() == 0


def test_the_truth_says_which_pixels_are_saturated():
    bright = replace(PLAIN, optics=Optics(exposure=4.0))
    press = simulate_press(bright, Ball(2), depth_mm=0.5, rng=None)
    exact = simulate_press(bright, Ball(2), depth_mm=0.5, rng=None, quantise=False).image
    np.testing.assert_array_equal(press.saturated, (exact > 255.5).any(axis=-1))
    assert np.all((press.image == 255).any(axis=-1)[press.saturated])
    assert 0 < press.saturated.mean() < 1
    cut = np.full((2, 3, 3), 100.0)
    cut[0, 1, 2], cut[1, 0, 0] = -2.0, 300.0
    assert np.argwhere(saturated_from_levels(cut)).tolist() == [[0, 1], [1, 0]], "below 0 too"


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
