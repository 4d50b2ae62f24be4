"""Cast and attached shadows against geometry."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.simulate import LAYOUTS, Ball, Led, simulate_background, simulate_press
from gelform.simulate.gel.gel import surface_from_ball
from gelform.simulate.light.shadows import shadowed_from_surface, visible_from_surface
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
