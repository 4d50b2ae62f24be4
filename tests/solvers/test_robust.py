"""Depth without known confidence: what robust losses and the curl gate must reach, and leave alone."""

from __future__ import annotations

import numpy as np
import pytest

from gelform.depth import depth_from_gradients, integrate
from gelform.solvers import RobustSolver, SparseSolver
from gelform.solvers.curl_gated.solver import confidence_from_curl
from gelform.solvers.edges import differences, edges_from_gradients
from gelform.solvers.robust import LOSSES
from scenes import BALL, PEAKS, SHAPE, polynomial, rmse_um, scene, with_liars, with_noise

ROBUST = ["robust", "robust_huber", "robust_l1"]
QUADRATIC = polynomial({(1, 0): 0.05, (0, 1): -0.03, (2, 0): 0.02, (1, 1): -0.015, (0, 2): 0.01})


def lying(surface, share, seed=1, corrupt=with_liars):
    truth, gradients, pitch = scene(surface)
    rng = np.random.default_rng(seed)
    return truth, corrupt(with_noise(gradients, 0.05, rng), share, rng), pitch


@pytest.fixture(scope="module")
def errors_um():
    """RMSE of every solver on 15 % specks."""
    truth, corrupted, pitch = lying(BALL, 0.15)
    return {
        name: rmse_um(depth_from_gradients(corrupted.gradients, mm_per_px=pitch, solver=name), truth)
        for name in ("dct", *ROBUST, "gated")
    }


@pytest.mark.parametrize("solver", [*ROBUST, "gated"])
def test_lies_hurt_less_than_in_least_squares(solver, errors_um):
    assert errors_um["dct"] > 100
    assert errors_um[solver] < 0.6 * errors_um["dct"]


def test_gate_beats_every_robust_loss_on_specks(errors_um):
    assert errors_um["gated"] < 8
    assert errors_um["gated"] < min(errors_um[name] for name in ROBUST)


def test_known_confidence_beats_the_gate():
    truth, corrupted, pitch = lying(BALL, 0.15)
    depth = depth_from_gradients(corrupted.gradients, mm_per_px=pitch, weights=corrupted.valid * 1.0)
    assert rmse_um(depth, truth, corrupted.valid) < 4.5
    assert rmse_um(depth, truth) < 8


@pytest.mark.parametrize("solver", [*ROBUST, "gated"])
def test_costs_little_where_nothing_lies(solver):
    truth, gradients, pitch = scene(PEAKS)
    noisy = with_noise(gradients, 0.05, np.random.default_rng(2))
    plain = rmse_um(depth_from_gradients(noisy, mm_per_px=pitch), truth)
    assert rmse_um(depth_from_gradients(noisy, mm_per_px=pitch, solver=solver), truth) < 1.25 * plain


def test_gate_names_the_lying_pixels_and_few_others():
    _, gradients, pitch = scene(PEAKS)
    noisy = with_noise(gradients, 0.02, np.random.default_rng(3))
    noisy[100, 50] += (0.8, 0.0)
    noisy[30, 200] += (0.0, -0.8)
    confidence = confidence_from_curl(noisy, pitch)
    assert confidence[100, 50] == confidence[30, 200] == 0
    assert np.mean(confidence) > 0.95


def test_gate_trusts_exact_slopes():
    _, gradients, pitch = scene(PEAKS)
    assert confidence_from_curl(gradients, pitch).all()


@pytest.mark.parametrize("shape", [(1, 9), (9, 1), (1, 1), (2, 2)])
def test_gate_of_frames_without_loops_trusts_all(shape):
    assert np.array_equal(confidence_from_curl(np.zeros((*shape, 2)), (0.1, 0.1)), np.ones(shape))


def test_gate_multiplies_given_weights():
    truth, corrupted, pitch = lying(BALL, 0.05)
    hidden = np.ones(SHAPE)
    hidden[60:90, 100:140] = 0
    corrupted.gradients[60:90, 100:140] = 3
    solution = integrate(corrupted.gradients, mm_per_px=pitch, weights=hidden, solver="gated")
    assert not solution.known[60:90, 100:140].any()
    assert rmse_um(solution.depth_mm, truth, hidden > 0) < 10


def test_hidden_lies_cast_no_doubt_on_their_neighbours():
    _, gradients, pitch = scene(PEAKS)
    told = np.ones(SHAPE, dtype=bool)
    told[60:90, 100:140] = False
    gradients[~told] = 3
    assert not confidence_from_curl(gradients, pitch)[59:91, 99:141].all()
    assert confidence_from_curl(gradients, pitch, told).all()


@pytest.mark.parametrize("loss", LOSSES)
def test_more_rounds_approach_the_minimiser_of_the_loss(loss):
    """At the fixed point, the weights of the answer's own residuals give the answer again."""
    rng = np.random.default_rng(4)
    _, gradients, pitch = scene(QUADRATIC, (20, 24), (0.1, 0.12))
    gradients = with_liars(with_noise(gradients, 0.05, rng), 0.08, rng).gradients.astype(np.float32)
    moves = []
    for rounds in (1, 30):
        depth = RobustSolver((20, 24), pitch, loss=loss, rounds=rounds)(gradients).depth_mm
        residual = [d - e for d, e in zip(differences(depth, pitch), edges_from_gradients(gradients))]
        usual = 1.4826 * np.median(np.concatenate([np.abs(r).ravel() for r in residual]))
        weights = tuple(np.maximum(LOSSES[loss](r / usual), 1e-3) for r in residual)
        again = SparseSolver((20, 24), pitch)(gradients, weights).depth_mm
        moves.append(np.std(again - depth))
    assert moves[1] < 0.2 * moves[0]


def test_unknown_loss_is_refused():
    with pytest.raises(ValueError, match="Expected a loss among huber, cauchy, l1, got 'l2'"):
        RobustSolver((4, 4), (1.0, 1.0), loss="l2")


def test_gate_refuses_weights_per_edge():
    with pytest.raises(ValueError, match="Expected weights per pixel"):
        depth_from_gradients(
            np.zeros((4, 5, 2)), mm_per_px=0.1, weights=(np.ones((4, 4)), np.ones((3, 5))), solver="gated"
        )
