"""Depth without known confidence: what robust losses and the curl gate must reach, and leave alone."""

from __future__ import annotations

import numpy as np
import pytest

from gelform.depth import depth_from_gradients
from gelform.solvers import HuberSolver, L1Solver, RobustSolver, SparseSolver
from gelform.solvers.edges import differences, edges_from_gradients
from gelform.solvers.robust import LOSSES
from scenes import BALL, PEAKS, polynomial, rmse_um, scene, with_noise, with_outliers

ROBUST = ["robust", "robust_huber", "robust_l1"]
QUADRATIC = polynomial({(1, 0): 0.05, (0, 1): -0.03, (2, 0): 0.02, (1, 1): -0.015, (0, 2): 0.01})


def with_noise_and_outliers(surface, share, seed=1, corrupt=with_outliers):
    truth, gradients, pitch = scene(surface)
    rng = np.random.default_rng(seed)
    return truth, corrupt(with_noise(gradients, 0.05, rng), share, rng), pitch


@pytest.fixture(scope="module")
def errors_um():
    """RMSE of every solver on 15 % specks."""
    truth, corrupted, pitch = with_noise_and_outliers(BALL, 0.15)
    return {
        name: rmse_um(depth_from_gradients(corrupted.gradients, mm_per_px=pitch, solver=name), truth)
        for name in ("dct", *ROBUST, "curl_gated")
    }


@pytest.mark.parametrize("solver", [*ROBUST, "curl_gated"])
def test_outliers_hurt_less_than_in_least_squares(solver, errors_um):
    assert errors_um["dct"] > 100
    assert errors_um[solver] < 0.6 * errors_um["dct"]


def test_gate_beats_every_robust_loss_on_specks(errors_um):
    assert errors_um["curl_gated"] < 8
    assert errors_um["curl_gated"] < min(errors_um[name] for name in ROBUST)


@pytest.mark.parametrize("solver", [*ROBUST, "curl_gated"])
def test_costs_little_without_outliers(solver):
    truth, gradients, pitch = scene(PEAKS)
    noisy = with_noise(gradients, 0.05, np.random.default_rng(2))
    plain = rmse_um(depth_from_gradients(noisy, mm_per_px=pitch), truth)
    assert rmse_um(depth_from_gradients(noisy, mm_per_px=pitch, solver=solver), truth) < 1.25 * plain


@pytest.mark.parametrize("solver", [RobustSolver, HuberSolver, L1Solver])
def test_more_rounds_approach_the_minimiser_of_the_loss(solver):
    """At the fixed point, the weights of the answer's own residuals give the answer again."""
    rng = np.random.default_rng(4)
    _, gradients, pitch = scene(QUADRATIC, (20, 24), (0.1, 0.12))
    gradients = with_outliers(with_noise(gradients, 0.05, rng), 0.08, rng).gradients.astype(np.float32)
    moves = []
    for rounds in (1, 30):
        depth = solver((20, 24), pitch, rounds=rounds)(gradients).depth_mm
        residual = [d - e for d, e in zip(differences(depth, pitch), edges_from_gradients(gradients))]
        usual = 1.4826 * np.median(np.concatenate([np.abs(r).ravel() for r in residual]))
        weights = tuple(np.maximum(LOSSES[solver.loss](r / usual), 1e-3) for r in residual)
        again = SparseSolver((20, 24), pitch)(gradients, weights).depth_mm
        moves.append(np.std(again - depth))
    assert moves[1] < 0.2 * moves[0]
