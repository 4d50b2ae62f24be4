"""Presses: determinism, grid, camera, refusals."""

import re
from dataclasses import replace

import numpy as np
import pytest

from gelform.simulate import (
    LAYOUTS,
    Ball,
    HeightMap,
    Led,
    SimulatedSensor,
    exposed,
    simulate_background,
    simulate_ball_presses,
    simulate_press,
)

SMALL = replace(LAYOUTS["three-edges"], shape=(48, 64), mm_per_px=0.3)


def test_same_seed_same_bytes():
    first, second, other = (
        simulate_press(SMALL, Ball(3), depth_mm=0.8, rng=np.random.default_rng(seed)) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first.image, second.image)
    np.testing.assert_array_equal(first.depth_mm, other.depth_mm)
    assert np.any(first.image != other.image)


def test_one_press_of_a_set_does_not_depend_on_how_many_follow():
    few = simulate_ball_presses(SMALL, ball_diameters_mm=[4, 6], count=2, rng=np.random.default_rng(5))
    again = simulate_ball_presses(SMALL, ball_diameters_mm=[4, 6], count=3, rng=np.random.default_rng(5))
    for a, b in zip(few.presses, again.presses):
        np.testing.assert_array_equal(a.image, b.image)
    np.testing.assert_array_equal(few.background, again.background)


def test_ball_presses_are_spread_and_some_are_cut_by_the_border():
    done = []
    simulated = simulate_ball_presses(
        SMALL, ball_diameters_mm=[6.31, 9.5], count=30, rng=np.random.default_rng(0), oversample=1,
        progress=lambda k, n, what: done.append((k, n)),
    )  # fmt: skip
    assert done[0] == (1, 30)
    assert done[-1] == (30, 30)
    centers = np.array([press.center_px for press in simulated.presses])
    counts, *_ = np.histogram2d(*centers.T, bins=3, range=[[0, 64], [0, 48]])
    assert counts.min() >= 2
    radius = np.array([press.contact_radius_px for press in simulated.presses])
    cut = (centers.min(axis=1) < radius) | ((63, 47) - centers < radius[:, None]).any(axis=1)
    assert 5 < cut.sum() < 28
    rims = [np.hypot(*np.moveaxis(p.gradients[p.contact], -1, 0)).max() for p in simulated.presses]
    assert 0.5 < np.median(rims) < 0.95
    assert {press.ball_diameter_mm for press in simulated.presses} == {6.31, 9.5}


def test_truth_lies_on_pixel_centres_whatever_the_oversample():
    one, three = (
        simulate_press(SMALL, Ball(3), depth_mm=0.8, center_mm=(1.1, -2.3), rng=None, oversample=n)
        for n in (1, 3)
    )
    np.testing.assert_allclose(one.depth_mm, three.depth_mm, atol=1e-13)
    np.testing.assert_allclose(one.gradients, three.gradients, atol=1e-13)
    row, column = np.unravel_index(np.argmax(one.depth_mm), one.depth_mm.shape)
    assert abs(column - one.center_px[0]) <= 0.5
    assert abs(row - one.center_px[1]) <= 0.5
    x = SMALL.grid_mm()[0][0, column]
    assert abs(x - 1.1) <= 0.15


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


def test_averaging_frames_lowers_the_noise():
    sensor = replace(SMALL, noise_sd=2.0, noise_gain=0.0)
    clean = simulate_background(sensor, None, quantise=False)
    mean = simulate_background(sensor, np.random.default_rng(0), frames=16)
    assert mean.dtype == np.float32
    assert (mean - clean).std() == pytest.approx(0.5, rel=0.1)


def test_too_bright_is_saturated_and_crosstalk_mixes_channels():
    sensor = SimulatedSensor(
        (Led((0, 0, 5), (1000, 0, 0)),), shape=(20, 20), crosstalk=((1, 0, 0), (0.25, 1, 0), (0, 0, 1))
    )
    levels = simulate_background(sensor, None, quantise=False)
    np.testing.assert_allclose(levels[..., 1], 0.25 * levels[..., 0])
    bright = simulate_background(replace(sensor, white_balance=(100, 1, 1)), None)
    assert np.all(bright[..., 0] == 255)


def test_vignetting_darkens_the_corners():
    plain = replace(SMALL, vignetting=0.0, blur_px=0.0)
    ratio = simulate_background(replace(plain, vignetting=0.4), None, quantise=False) / simulate_background(
        plain, None, quantise=False
    )
    np.testing.assert_allclose(ratio[[0, 0, -1, -1], [0, -1, 0, -1]], 0.6, rtol=1e-9)
    assert ratio[24, 32].min() > 0.99


@pytest.mark.parametrize("name", LAYOUTS)
def test_every_layout_makes_a_picture_that_can_be_used(name):
    sensor = LAYOUTS[name]
    background = simulate_background(sensor, None, quantise=False)
    press = simulate_press(sensor, Ball(3), depth_mm=0.8, rng=None, quantise=False)
    change = np.abs(press.image - background)
    assert background.min() > 5
    assert background.max() < 250
    assert np.all(change[press.contact].max(axis=0) > 15)
    assert change[:10].max() < 0.5


@pytest.mark.parametrize(
    ("name", "levels"),
    [("three-edges", (78, 95, 105)), ("ring-120", (110, 110, 110)), ("homemade", (85, 80, 75))],
)
def test_every_layout_is_exposed_as_it_says(name, levels):
    background = simulate_background(LAYOUTS[name], None, quantise=False)
    np.testing.assert_allclose(background.mean(axis=(0, 1)), levels, rtol=1e-4)


def test_exposed_gives_the_mean_levels():
    sensor = exposed(replace(SMALL, white_balance=(1, 1, 1)), (60, 80, 100))
    np.testing.assert_allclose(simulate_background(sensor, None, quantise=False).mean((0, 1)), (60, 80, 100))


REFUSED = [
    (lambda: Led((0, 0, -2), (1, 1, 1)), "z > 0 mm"),
    (lambda: Led((0, 0, 2), (0, 0, 0)), "color"),
    (lambda: SimulatedSensor(()), "at least one LED"),
    (lambda: replace(SMALL, noise_sd=-1), "noise_sd >= 0"),
    (lambda: replace(SMALL, noise_gain=-0.1), "noise_gain >= 0"),
    (lambda: replace(SMALL, vignetting=1.0), "vignetting"),
    (lambda: replace(SMALL, crosstalk=((1, 0), (0, 1))), "crosstalk"),
    (lambda: replace(SMALL, mm_per_px=0.0), "mm_per_px"),
    (lambda: replace(SMALL, shape=(0, 3)), "shape"),
    (lambda: Ball(6000), "another unit"),
    (lambda: Ball(0), "radius_mm > 0"),
    (lambda: HeightMap(np.full((4, 4), np.nan), 0.1), "finite height_mm"),
    (lambda: simulate_press(SMALL, Ball(3), depth_mm=-1, rng=None), "depth_mm > 0"),
    (lambda: simulate_press(SMALL, Ball(3), depth_mm=1, rng=None, oversample=2), "odd"),
    (
        lambda: simulate_press(SMALL, Ball(3), depth_mm=1, center_mm=(99, 0), rng=None),
        "touches the gel within",
    ),
    (lambda: simulate_background(SMALL, None, frames=0), "frames"),
    (
        lambda: simulate_ball_presses(SMALL, ball_diameters_mm=[], count=3, rng=np.random.default_rng()),
        "a ball",
    ),
]


@pytest.mark.parametrize(("make", "message"), REFUSED)
def test_bad_input_is_refused_with_the_reason(make, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        make()
