"""Solvers that assume something: exact and agreed where it holds, wrong as documented where not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gelform.depth import depth_from_gradients
from gelform.solvers import SOLVERS, UNIFORM, DctSolver, DstSolver, FourierSolver, PathSolver
from scenes import BALLS, PLANE, gaussian, polynomial, rmse_um, scene, waves

QUADRATIC = polynomial({(1, 0): 0.05, (0, 1): -0.03, (2, 0): 0.02, (1, 1): -0.015, (0, 2): 0.01})
PITCHES = [(0.0634, 0.0634), (0.05, 0.08)]


@pytest.mark.parametrize("solver", SOLVERS)
def test_all_agree_on_a_bump_that_fades_before_the_border(solver):
    truth, gradients, pitch = scene(gaussian(1.0, 1.0), (160, 200), (0.06, 0.05))
    depth = depth_from_gradients(gradients, mm_per_px=pitch, solver=solver)
    depth = depth - depth.mean()
    assert np.max(np.abs(depth - (truth - truth.mean()))) < 1e-3 * np.ptp(truth)


@pytest.mark.parametrize("pitch", PITCHES)
@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (8, 1), (2, 3), (31, 24)])
def test_path_is_exact_on_quadratics(shape, pitch):
    truth, gradients, _ = scene(QUADRATIC, shape, pitch)
    assert PathSolver(shape, pitch)(gradients) == pytest.approx(truth - truth.mean(), abs=1e-6)


@pytest.mark.parametrize("pitch", PITCHES)
@pytest.mark.parametrize("shape", [(3, 3), (3, 9), (24, 31)])
def test_dst_is_exact_on_a_parabolic_cap_over_the_frame(shape, pitch):
    """z = (a^2 - x^2)(b^2 - y^2) is 0 on the border and quadratic along rows and columns."""
    a, b = (shape[1] - 1) / 2 * pitch[0], (shape[0] - 1) / 2 * pitch[1]
    cap = polynomial({(0, 0): a**2 * b**2, (2, 0): -(b**2), (0, 2): -(a**2), (2, 2): 1.0})
    truth, gradients, _ = scene(cap, shape, pitch)
    assert DstSolver(shape, pitch)(gradients) == pytest.approx(truth, abs=2e-6 * np.ptp(truth))


@pytest.mark.parametrize("shape", [(1, 5), (2, 7), (5, 1)])
def test_dst_of_a_frame_that_is_all_border_is_zero(shape):
    assert np.array_equal(DstSolver(shape, (0.1, 0.1))(np.ones((*shape, 2))), np.zeros(shape))


@pytest.mark.parametrize("shape", [(24, 48), (25, 45), (1, 24)])
def test_fourier_is_exact_on_periodic_waves(shape):
    pitch = 2.4 / shape[1], 1.2 / shape[0]
    truth, gradients, _ = scene(waves(0.02, 0.6), shape, pitch)
    depth = FourierSolver(shape, pitch)(gradients)
    assert depth == pytest.approx(truth - truth.mean(), abs=1e-6)


@pytest.mark.parametrize("solver", UNIFORM)
def test_a_stack_equals_its_frames(solver):
    stack = np.random.default_rng(1).standard_normal((3, 9, 12, 2)).astype(np.float32)
    solve = SOLVERS[solver]((9, 12), (0.05, 0.08))
    assert np.array_equal(solve(stack), np.stack([solve(frame) for frame in stack]))


def test_assumptions_fail_where_the_border_cuts_a_contact():
    truth, gradients, pitch = scene(BALLS)
    errors = {
        name: rmse_um(depth_from_gradients(gradients, mm_per_px=pitch, solver=name), truth)
        for name in ("dct", "fourier", "dst")
    }
    assert errors["dct"] < 1.25
    assert errors["fourier"] > 40
    assert errors["dst"] > 40


def test_periodic_and_zero_border_lose_a_tilt():
    truth, gradients, pitch = scene(PLANE)
    for solver in (FourierSolver, DstSolver):
        assert np.ptp(solver(truth.shape, pitch)(gradients)) < 0.3 * np.ptp(truth)
    assert np.ptp(DctSolver(truth.shape, pitch)(gradients)) == pytest.approx(np.ptp(truth), rel=1e-4)


@pytest.mark.parametrize("solver", SOLVERS)
def test_the_guide_says_when_to_take_it(solver):
    guide = Path(__file__).parents[2] / "docs" / "choosing-a-solver.md"
    assert f"`{solver}`" in guide.read_text()
