"""Deviation of the solved depth's slopes: what neighbors and held-out presses say, and what balls do not show."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from gelform.slopes.confidence import solved
from gelform.slopes.confidence.slope_sigma import LEAST_FACTOR, SlopeSigma
from gelform.slopes.confidence.solved import (
    BLURRED,
    OPTICS_PX,
    SolvedErrors,
    SolvedSigma,
    error_per_difference,
    reach_px,
    with_solved_factors,
)
from gelform.slopes.gradients import STEEPEST_GEL
from kernel_agreement import assert_kernel_agrees

SOLVED = {"solved_slopes": (0.2, 0.6), "solved_places": (((0.8,),),) * 2}
LAW = SlopeSigma(0.01, (0.0, 0.5, 1.0), (0.02, 0.05, 0.12), 0.03, 8.0, **SOLVED)
SHAPE = (9, 12)
OF_NOISE = (
    20  # of native/slopes/confidence/solved_sigma.c: variance of a second difference over that of a slope
)


def flat(shape=SHAPE, slope=0.0):
    return np.full((*shape, 2), slope / np.sqrt(2), np.float32)


def both(sigma):
    return np.broadcast_to(sigma[..., None], (*sigma.shape, 2))


def numpy_own(sigma, limit):
    """Own variance v and the neighbors' mean m: one over 1/v + (2/3)/m, scaled so that alike ones stay."""
    v = np.pad(np.minimum(sigma.astype(float), limit) ** 2, 1, mode="edge")
    rows, columns = sigma.shape
    around = sum(v[i : i + rows, j : j + columns] for i in range(3) for j in range(3)) - v[1:-1, 1:-1]
    own, others = v[1:-1, 1:-1], around / 8
    return np.sqrt((5 / 3) / (1 / own + (2 / 3) / others))


def numpy_solved_sigma(
    sigma,
    gradients,
    gentle,
    steep,
    work,
    result,
    wall,
    curvature,
    unlimited,
    from_slope,
    per_slope,
    limit,
    reach,
):
    """What the kernel should give, in float64: the whole deviation and its part at walls."""
    g, second = gradients.astype(float), np.zeros(gradients.shape)
    for axis in (0, 1):
        for y, x in np.ndindex(sigma.shape):
            for side in (-reach, reach):
                other = [y, x]
                other[axis] += side
                if 0 <= other[axis] < sigma.shape[axis]:
                    second[y, x] += g[tuple(other)] - g[y, x]
    along = np.clip((np.linalg.norm(g, axis=-1) - from_slope) * per_slope, 0, 1)
    own = np.minimum(numpy_own(sigma, unlimited) * (gentle + along * (steep - gentle)), limit)
    bend = (second**2).sum(-1) - OF_NOISE * own**2
    blurred = curvature**2 * np.maximum(bend, 0)
    return np.sqrt(own**2 + blurred), np.sqrt(blurred)


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (11, 2), (7, 40), (3, 17)])
@pytest.mark.parametrize("curvature", [0.0, 0.6])
@pytest.mark.parametrize("reach", [1, 3, 20])
def test_the_kernel_agrees_with_numpy(shape, curvature, reach):
    rng = np.random.default_rng(0)
    gentle, steep = (rng.uniform(0.01, 1, shape).astype(np.float32) for _ in range(2))
    sigma = rng.uniform(0.01, 1.5, shape).astype(np.float32)
    assert_kernel_agrees(
        solved._solved_sigma, numpy_solved_sigma, sigma, rng.normal(0, 0.4, (*shape, 2)).astype(np.float32),
        gentle, steep, np.empty(3 * shape[1] + 2, np.float32), *np.empty((2, *shape), np.float32), curvature, 1.1, 0.2,
        3.0, 0.5, reach,
    )  # fmt: skip


def test_a_slope_that_was_read_badly_follows_from_its_neighbors():
    sigma = np.full(SHAPE, 0.05, np.float32)
    sigma[4, 4], sigma[1, 1] = 1.0, 40.0
    stated = SolvedSigma(LAW, SHAPE, 1.0)
    found = stated(both(sigma), flat())
    assert found.shape == (*SHAPE, 2)
    assert found[7, 7, 0] == pytest.approx(0.04)
    assert 0.04 < found[4, 4, 0] < 0.1
    assert 0.04 < found[1, 1, 1] < 0.1
    np.testing.assert_array_equal(stated(both(sigma).copy(), flat()), found)
    assert stated(None, flat()) is None


def test_no_slope_is_less_known_than_the_steepest():
    unseen = both(np.full(SHAPE, 40.0, np.float32))
    least = replace(LAW, solved_slopes=(0.2, 0.6), solved_places=(((LEAST_FACTOR,),),) * 2)
    for law in (LAW, least):  # however good solved slopes are, where nothing is known nothing is
        np.testing.assert_allclose(SolvedSigma(law, SHAPE, None)(unseen, flat()), STEEPEST_GEL, rtol=1e-5)


def test_a_model_that_states_its_own_is_left_as_it_is():
    own = np.random.default_rng(0).uniform(0.02, 0.03) * np.ones((*SHAPE, 2), np.float32)
    found = SolvedSigma(None, SHAPE, None)(own, flat(slope=0.5))
    np.testing.assert_allclose(found, own, rtol=1e-5)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(
    ("slope", "sigma", "own"), [(0.6, 0.05, 0.04), (9.0, 40.0, STEEPEST_GEL)], ids=["usual", "steepest"]
)
def test_a_wall_is_doubted_beside_its_edges_alone(axis, slope, sigma, own):
    """Beyond the steepest slope of a gel too."""
    gradients = np.zeros((40, 40, 2), np.float32)
    np.moveaxis(gradients, axis, 0)[20:, :, 0] = slope
    sigmas = both(np.full((40, 40), sigma, np.float32))
    found = np.moveaxis(SolvedSigma(LAW, (40, 40), 1.25)(sigmas, gradients), axis, 0)
    assert reach_px(1.25) == 2
    bend = np.sqrt(slope**2 - OF_NOISE * own**2)
    np.testing.assert_allclose(found[18:22], np.hypot(own, bend * error_per_difference(1.25)), rtol=1e-4)
    np.testing.assert_allclose(found[:18], own, rtol=1e-4)
    np.testing.assert_allclose(found[22:], own, rtol=1e-4)
    whole, wall = SolvedSigma(LAW, (40, 40), 1.25).with_walls(sigmas, gradients)
    np.testing.assert_allclose(np.hypot(own, wall), whole[..., 0], rtol=1e-4)
    apart = SolvedSigma(LAW, (40, 40), 1.25).with_walls(sigmas.copy(), gradients)  # a model with two maps
    np.testing.assert_array_equal(apart[1], wall)
    unknown, wall = SolvedSigma(LAW, (40, 40), None).with_walls(
        sigmas, gradients
    )  # imported: no slope is a wall's
    np.testing.assert_allclose(unknown, own, rtol=1e-4)
    assert not wall.any()


@pytest.mark.parametrize("blur_px", [0.7, 1.25, 2.5])
def test_what_blur_takes_from_a_slope_is_stated(blur_px):
    wave = 2 * np.pi / 24  # per px
    x = np.arange(240)
    gradients = np.zeros((60, 240, 2), np.float32)
    gradients[..., 0] = 0.1 * np.sin(wave * x)
    blurred = 0.1 * np.exp(-(wave**2) * (blur_px**2 + OPTICS_PX**2) / 2)
    known = both(np.full((60, 240), 1e-6, np.float32))
    exact = SolvedSigma(LAW, (60, 240), blur_px)(known, gradients)[..., 0]
    crest = (x % 24 == 6) & (x > 24) & (x < 216)
    np.testing.assert_allclose(exact[:, crest] / BLURRED, 0.1 - blurred, rtol=0.2)
    assert exact[:, x % 24 == 12].max() < 0.1 * exact[:, crest].min()


def held_out_errors(size, presses=40, count=60_000):
    """Errors whose deviation is 0.05 times size(slope, x), where 0.05 is predicted and 0.02 of it is no reading's."""
    rng = np.random.default_rng(0)
    slopes, x, y = rng.uniform(0, 0.8, count), rng.uniform(0, 1, count), rng.uniform(0, 1, count)
    predicted, extra = np.full(count, 0.05), np.full(count, 0.02)
    deviation = np.sqrt((predicted**2 - extra**2) * size(slopes, x) ** 2 + extra**2)
    errors = deviation[:, None] * rng.standard_normal((count, 2))
    return SolvedErrors(slopes, errors, predicted, extra, x, y, rng.integers(0, presses, count))


def test_factors_are_recovered_by_slope_and_place():
    held_out = held_out_errors(lambda s, x: np.where(s > 0.4, 2.0, 0.7) * np.where(x > 0.75, 1.5, 1.0))
    sigma = with_solved_factors(LAW, held_out)
    np.testing.assert_allclose(sigma.solved_slopes, (0.2, 0.6), atol=0.01)
    for grid, factor in zip(sigma.solved_places, (0.7, 2.0), strict=True):
        np.testing.assert_allclose(grid, factor * np.broadcast_to([1, 1, 1, 1.5], np.shape(grid)), rtol=0.06)
    assert SlopeSigma.from_dict(asdict(sigma)) == sigma


def test_a_place_that_one_press_touched_counts_little():
    held_out = held_out_errors(lambda s, x: np.where(x > 0.75, 4.0, 1.0))
    lone = replace(held_out, press=np.where(held_out.x > 0.75, 0, held_out.press))
    few, many = (with_solved_factors(LAW, one).solved_places[0][1][3] for one in (lone, held_out))
    assert many == pytest.approx(4, rel=0.1)
    assert few < 2


def test_good_readings_take_down_their_own_alone_and_slopes_all_alike_say_nothing():
    gentle, _ = with_solved_factors(LAW, held_out_errors(lambda s, x: 0 * s)).solved_places
    np.testing.assert_allclose(gentle, LEAST_FACTOR)
    held_out = held_out_errors(lambda s, x: 1 + 0 * s)
    assert with_solved_factors(LAW, replace(held_out, slopes=0 * held_out.slopes)) == LAW
