"""Draws of slope errors: of the variance and correlation that they say, orthogonal where they are near."""

from __future__ import annotations

import numpy as np
import pytest

from gelform._native import Handle
from gelform.depth.sigma import probes
from gelform.depth.sigma.probes import ProbeSolver, correlated_draws, white_draws
from gelform.depth.solvers import SparseSolver
from gelform.depth.solvers.multigrid import Grid
from gelform.depth.solvers.system import problem_from_gradients
from kernel_agreement import usable_isas


@pytest.mark.parametrize("count", [2, 7, 32])
def test_white_draws_have_variance_one_and_near_ones_are_orthogonal(count):
    """Within 4 places of each other, and the two slopes of a place; random ones would have 1/sqrt(32)."""
    draws = white_draws(count, (13, 17), np.random.default_rng(1))
    assert draws.shape == (count, 13, 17, 2)
    assert np.mean(draws**2, axis=0) == pytest.approx(1, abs=1e-5)
    if count < 32:
        return
    gram = draws.reshape(32, -1).T @ draws.reshape(32, -1) / 32
    rows, cols, slope = np.indices((13, 17, 2)).reshape(3, -1)
    away = np.hypot(rows[:, None] - rows, cols[:, None] - cols)
    near = (away < 4) & ((away > 0) | (slope[:, None] != slope))
    assert np.abs(gram[near]).max() < 1e-5
    assert np.abs(gram[(away > 4) & (away < 5)]).max() > 0.9


def test_correlated_draws_have_the_correlation_that_they_say():
    many = np.concatenate(
        [correlated_draws(64, (12, 15), 2.5, np.random.default_rng(k)) for k in range(40)]
    ).astype(np.float64)
    assert np.mean(many**2, axis=0) == pytest.approx(1, abs=0.12)
    for down, right in ((0, 2), (3, 0), (2, 2)):
        product = many[:, : 12 - down, : 15 - right] * many[:, down:, right:]
        expected = np.exp(-(down**2 + right**2) / (2 * 2.5**2))
        assert product.mean() == pytest.approx(expected, abs=0.02)
    assert np.mean(many[..., 0] * many[..., 1]) == pytest.approx(0, abs=0.02)


def test_correlated_draws_are_alike_up_to_both_ends_of_a_long_frame():
    many = np.concatenate([correlated_draws(64, (1, 90), 1.5, np.random.default_rng(k)) for k in range(30)])
    products = np.mean(many[:, 0, :-2] * many[:, 0, 2:], axis=(0, 2), dtype=np.float64)
    assert products == pytest.approx(np.exp(-4 / (2 * 1.5**2)), abs=0.08)


def test_errors_of_the_two_slopes_are_on_their_edges():
    """With a lattice point as origin, the first slope's field is the second's, moved by half a place each."""
    draws = correlated_draws(8, (9, 9), 4.0, np.random.default_rng(2))
    steps = [np.abs(np.diff(draws[..., 0], axis=axis)).max() for axis in (1, 2)]
    assert min(steps) > 0
    assert max(steps) < 1.0


@pytest.mark.parametrize("median", [False, True])
def test_depths_are_those_of_the_slope_errors(median):
    rng = np.random.default_rng(3)
    shape, pitch = (11, 13), (0.2, 0.3)
    draws = white_draws(4, shape, rng)
    white = rng.uniform(0.5, 1, (*shape, 2)).astype(np.float32)
    weights = rng.uniform(0.3, 1, shape).astype(np.float32)
    anchor = np.full(shape, 0.05, dtype=np.float32)
    count = np.full((*shape, 2), 1 / 143, dtype=np.float32) if median else None
    problem = problem_from_gradients(np.zeros_like(white), weights, None, anchor)
    depths = ProbeSolver(draws, np.zeros_like(draws), pitch)(white, np.zeros_like(white), problem, count)
    for k in range(4):
        errors = draws[k] * white
        errors = errors - errors.mean(axis=(0, 1)) if median else errors
        exact = SparseSolver(shape, pitch)(errors, weights, None, anchor).depth_mm
        assert np.sqrt(np.mean((depths[..., k] - exact) ** 2)) < 0.08 * np.std(exact)


def test_common_errors_of_a_tilt_give_a_tilt():
    shape, pitch = (11, 15), (0.2, 0.3)
    tilt = np.ones((2, *shape, 2), dtype=np.float32) * np.array([0.3, -0.2], dtype=np.float32)
    one, none = np.ones((*shape, 2), dtype=np.float32), np.zeros((*shape, 2), dtype=np.float32)
    problem = problem_from_gradients(none, None, None, None)
    depths = ProbeSolver(np.zeros_like(tilt), tilt, pitch)(none, one, problem)
    rows, cols = np.indices(shape)
    expected = 0.3 * 0.2 * cols - 0.2 * 0.3 * rows
    off = depths[..., 0] - expected
    assert np.std(off) < 0.03 * np.std(expected)


@pytest.mark.parametrize("shape", [(1, 9), (3, 4), (23, 31), (40, 54)])
def test_every_instruction_set_gives_the_same_bytes(shape):
    """20 draws: one full batch and a part of the next; even and odd sizes."""
    rng = np.random.default_rng(6)
    draws, weights = white_draws(20, shape, rng), rng.uniform(0.01, 1, shape).astype(np.float32)
    white = rng.uniform(0.5, 1, (*shape, 2)).astype(np.float32)
    problem = problem_from_gradients(np.zeros_like(white), weights, None, None)
    depths = {}
    for isa in usable_isas():
        grid, batch = Grid(shape), Handle("batch", *shape)
        grid.load(problem, (0.2, 0.3))
        depths[isa] = np.empty((*shape, 20), dtype=np.float32)
        fields = [np.ascontiguousarray(np.moveaxis(field, 0, -1)) for field in (draws, 0 * draws)]
        bias = np.zeros((2, 20), dtype=np.float32)
        probes._probe_depths.on(isa)(
            grid.handle, batch, *fields, white, 0 * white, bias, 0.1, 0.15, depths[isa]
        )
    assert len({values.tobytes() for values in depths.values()}) == 1


def test_a_draw_does_not_see_the_others():
    rng = np.random.default_rng(7)
    shape, pitch = (23, 30), (0.2, 0.3)
    draws, white = white_draws(20, shape, rng), rng.uniform(0.5, 1, (*shape, 2)).astype(np.float32)
    problem = problem_from_gradients(np.zeros_like(white), rng.uniform(0.1, 1, shape), None, None)
    together = ProbeSolver(draws, 0 * draws, pitch)(white, 0 * white, problem)
    alone = ProbeSolver(draws[17:18], 0 * draws[17:18], pitch)(white, 0 * white, problem)
    assert np.array_equal(together[..., 17], alone[..., 0])
