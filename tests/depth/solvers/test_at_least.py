"""Walls that are read too flat: at least as steep as they are read, and nothing else changes."""

import numpy as np
import pytest

from gelform.depth.integrate import integrate
from gelform.depth.solvers import AtLeastSolver, MultigridSolver
from gelform.slopes.gradients import gradients_from_depth

SHAPE, PITCH = (48, 64), 0.1


def frustum(top_px=8.0, width_px=6.0, height_mm=0.5):
    """A flat top with walls all around, and rest beside it."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return height_mm * np.clip(1 - (np.hypot(x - 32, y - 24) - top_px) / width_px, 0, 1)


def heights(solver, gradients, rest, **how):
    depth = integrate(gradients, mm_per_px=PITCH, solver=solver, anchor=0.1 * rest, **how).depth_mm
    return depth[22:27, 30:35].mean()


@pytest.mark.parametrize("edges", [False, True])
def test_walls_that_are_read_too_flat_here_and_there_come_out_steeper(edges):
    depth = frustum()
    gradients, rest = (
        gradients_from_depth(depth, mm_per_px=PITCH).astype(np.float32),
        (depth == 0).astype(np.float32),
    )
    weak = np.random.default_rng(0).uniform(size=SHAPE) < 0.5
    gradients[weak] *= 0.5  # of a half of all pixels
    weights = np.full(SHAPE, 0.7, np.float32)
    how = {"weights": (weights[:, 1:], weights[1:]) if edges else weights}
    plain, least = (heights(name, gradients, rest, **how) for name in ("multigrid", "at_least"))
    assert plain < 0.85 * 0.5
    assert plain + 0.03 < least < 0.5


def test_exact_slopes_stay():
    depth = frustum()
    gradients = gradients_from_depth(depth, mm_per_px=PITCH).astype(np.float32)
    rest = (depth == 0).astype(np.float32)
    plain, least = (heights(name, gradients, rest) for name in ("multigrid", "at_least"))
    assert least == pytest.approx(plain, abs=0.01)


def test_without_walls_it_is_multigrid():
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] / 40
    gradients = np.stack([0.2 * np.sin(x), 0.2 * np.cos(y)], axis=-1).astype(np.float32)
    weights = np.random.default_rng(0).uniform(0.5, 1, SHAPE).astype(np.float32)
    plain, least = (
        solver(SHAPE, (PITCH, PITCH))(gradients, weights).depth_mm
        for solver in (MultigridSolver, AtLeastSolver)
    )
    np.testing.assert_array_equal(least, plain)


@pytest.mark.parametrize("shape", [(1, 1), (2, 2), (1, 9), (3, 2)])
def test_small_frames(shape):
    gradients = np.random.default_rng(0).normal(0, 1, (*shape, 2)).astype(np.float32)
    assert np.isfinite(AtLeastSolver(shape, (PITCH, PITCH))(gradients).depth_mm).all()
