"""Cast and attached shadows against geometry."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.simulate import LAYOUTS, Ball, Led, simulate_background, simulate_press
from gelform.simulate.gel.gel import surface_from_ball
from gelform.simulate.light import shadows
from gelform.simulate.light.shadows import shadowed_from_surface, visible_from_surface
from kernel_agreement import assert_kernel_agrees
from made.sensors import PLAIN


def levels(sensor, **settings):
    return simulate_press(
        sensor, Ball(2), **{"depth_mm": 0.5, "rng": None, "quantise": False, "oversample": 1} | settings
    ).image


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
    reach = shadows._reach(leds, depth.shape, top)
    seen = np.ones((3, 40, 48), np.float32)
    assert_kernel_agrees(
        shadows._visible_lights, marched, depth, leds, reach, seen, top, 1e-4, tolerance=1e-4
    )
    assert marched(depth, leds, reach, seen, top, 1e-4).min() < 0.1


def test_a_gentle_bump_hides_nothing():
    surface = surface_from_ball(Ball(8), *PLAIN.grid_mm(), center_mm=(0, 0), depth_mm=0.2, relaxation_mm=0.5)
    assert visible_from_surface(surface, (Led((-8.0, 2.0, 9.0), (1, 1, 1)),)) is None


def test_lights_at_the_border_and_under_the_surface_are_seen():
    """Rays that have no room, or do not rise, meet nothing."""
    depth = np.zeros((6, 8), dtype=np.float32)
    depth[2:4, 3:5] = 1
    leds = np.array(
        [(-20.0, 0.0, 3.0, 1.0), (-20.0, 5.0, 3.0, 1.0), (3.0, -20.0, 0.5, 1.0), (3.0, 2.0, 1.0, 1.0)]
    )
    seen = np.ones((4, 6, 8), np.float32)
    shadows._visible_lights(depth, leds, np.full(4, 8), seen, 1.0, 1e-5)
    assert np.all((seen >= 0) & (seen <= 1))
    assert np.all(seen[0, 0] == 1)
    assert np.all(seen[1, 5] == 1)
    assert np.all(seen[2, 2:4, 3:5] == 1)
    assert seen[0].min() == 0
