"""Depth without known confidence: what robust losses and the curl gate must reach, and leave alone."""

from __future__ import annotations

import numpy as np
import pytest

from gelform.depth.integrate import depth_from_gradients, integrate
from gelform.depth.solvers import RobustSolver, SparseSolver
from gelform.depth.solvers import robust as curl_gated
from gelform.depth.solvers.robust import cauchy_weight, confidence_from_curl, patches_from_jumps
from gelform.depth.solvers.seam import differences, edges_from_gradients
from scenes import (
    BALL,
    BALLS,
    PEAKS,
    QUADRATIC,
    SHAPE,
    SMALL_BALL,
    rmse_um,
    scene,
    with_noise,
    with_outliers,
    with_patches,
)


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
        for name in ("dct", "robust", "curl_gated")
    }


@pytest.mark.parametrize("solver", ["robust", "curl_gated"])
def test_outliers_hurt_less_than_in_least_squares(solver, errors_um):
    assert errors_um["dct"] > 100
    assert errors_um[solver] < 0.6 * errors_um["dct"]


def test_slopes_that_an_anchor_contradicts_count_less_in_each_round():
    truth, gradients, pitch = scene(PEAKS)
    anchor = np.full(truth.shape, 0.01, np.float32)
    kept, pulled = (
        integrate(gradients, mm_per_px=pitch, solver=name, anchor=anchor).depth_mm.max()
        for name in ("multigrid", "robust")
    )
    assert pulled < 0.5 * kept


def test_gate_beats_the_robust_loss_on_specks(errors_um):
    assert errors_um["curl_gated"] < 8
    assert errors_um["curl_gated"] < errors_um["robust"]


@pytest.mark.parametrize("solver", ["robust", "curl_gated"])
def test_costs_little_without_outliers(solver):
    truth, gradients, pitch = scene(PEAKS)
    noisy = with_noise(gradients, 0.05, np.random.default_rng(2))
    plain = rmse_um(depth_from_gradients(noisy, mm_per_px=pitch), truth)
    assert rmse_um(depth_from_gradients(noisy, mm_per_px=pitch, solver=solver), truth) < 1.25 * plain


def test_a_cliff_stays_at_its_place_where_least_squares_spread_it():
    """A tongue over a plane; its slopes say nothing of the cliff at its end."""
    y, x = np.mgrid[:120, :160]
    turn, top = np.pi / 2 * np.clip((x - 80) / 20, -1, 1), y < 60
    truth = np.where(top, np.cos(turn) ** 2, 0)
    gradients = np.random.default_rng(0).normal(0, 0.02, (*truth.shape, 2))
    gradients[..., 0] -= np.where(top, np.pi / 2 / (20 * 0.1) * np.sin(2 * turn), 0)
    off_um = {}
    for name in ("multigrid", "robust", "curl_gated"):
        off = depth_from_gradients(gradients, mm_per_px=0.1, solver=name) - truth
        off_um[name] = 1e3 * np.mean(np.abs(off - np.median(off)))
    assert off_um["robust"] < 12
    assert off_um["robust"] < 0.2 * off_um["multigrid"]
    assert off_um["robust"] < 0.4 * off_um["curl_gated"]


def test_more_rounds_approach_the_minimiser_of_the_loss():
    """At the fixed point, the weights of the answer's own residuals give the answer again."""
    rng = np.random.default_rng(4)
    _, gradients, pitch = scene(QUADRATIC, (20, 24), (0.1, 0.12))
    gradients = with_outliers(with_noise(gradients, 0.05, rng), 0.08, rng).gradients.astype(np.float32)
    moves = []
    for rounds in (1, 30):
        depth = RobustSolver((20, 24), pitch, rounds=rounds)(gradients).depth_mm
        residual = [d - e for d, e in zip(differences(depth, pitch), edges_from_gradients(gradients))]
        usual = 1.4826 * np.median(np.concatenate([np.abs(r).ravel() for r in residual]))
        weights = tuple(np.maximum(cauchy_weight(r / usual), 1e-3) for r in residual)
        again = SparseSolver((20, 24), pitch)(gradients, weights).depth_mm
        moves.append(np.std(again - depth))
    assert moves[1] < 0.2 * moves[0]


def test_names_the_outlier_pixels_and_few_others():
    _, gradients, pitch = scene(PEAKS)
    noisy = with_noise(gradients, 0.02, np.random.default_rng(3))
    noisy[100, 50] += (0.8, 0.0)
    noisy[30, 200] += (0.0, -0.8)
    confidence = confidence_from_curl(noisy, pitch)
    assert confidence[100, 50] == confidence[30, 200] == 0
    assert np.mean(confidence) > 0.95


@pytest.mark.parametrize("shape", [(1, 9), (9, 1), (1, 1), (2, 2)])
def test_gate_of_frames_without_loops_trusts_all(shape):
    assert np.array_equal(confidence_from_curl(np.zeros((*shape, 2)), (0.1, 0.1)), np.ones(shape))


def test_gate_multiplies_given_weights():
    truth, corrupted, pitch = with_noise_and_outliers(BALL, 0.05)
    hidden = np.ones(SHAPE)
    hidden[60:90, 100:140] = 0
    corrupted.gradients[60:90, 100:140] = 3
    solution = integrate(corrupted.gradients, mm_per_px=pitch, weights=hidden, solver="curl_gated")
    assert not solution.known[60:90, 100:140].any()
    assert rmse_um(solution.depth_mm, truth, hidden > 0) < 10


def test_exact_slopes_are_trusted_beside_hidden_outliers_too():
    _, gradients, pitch = scene(PEAKS)
    assert confidence_from_curl(gradients, pitch).all()
    trusted = np.ones(SHAPE, dtype=bool)
    trusted[60:90, 100:140] = False
    gradients[~trusted] = 3
    assert not confidence_from_curl(gradients, pitch)[59:91, 99:141].all()
    assert confidence_from_curl(gradients, pitch, trusted).all()


ROWS, COLS = np.mgrid[: SHAPE[0], : SHAPE[1]]


def disc(row, col, radius):
    return np.hypot(ROWS - row, COLS - col) <= radius


def gated(gradients, pitch):
    return depth_from_gradients(gradients, mm_per_px=pitch, solver="curl_gated")


@pytest.mark.parametrize("surface", [BALL, BALLS, PEAKS])
@pytest.mark.parametrize("seed", [0, 1])
def test_coherent_patches_are_found(surface, seed):
    truth, gradients, pitch = scene(surface)
    rng = np.random.default_rng(seed)
    lying = with_patches(with_noise(gradients, 0.05, rng), 0.15, rng)
    assert rmse_um(depth_from_gradients(lying.gradients, mm_per_px=pitch), truth) > 90
    assert rmse_um(gated(lying.gradients, pitch), truth) < 20


@pytest.mark.parametrize("radius", [4, 8, 16])
@pytest.mark.parametrize("lie", [(0.8, 0.0), (0.0, -0.8), (0.5, 0.5)])
def test_the_inside_of_a_patch_is_distrusted(lie, radius):
    """Its rim alone does not show all around: not where the lie points across it."""
    _, gradients, pitch = scene(PEAKS)
    noisy = with_noise(gradients, 0.02, np.random.default_rng(3))
    patch = disc(100, 60, radius)
    noisy[patch] += lie
    confidence = confidence_from_curl(noisy, pitch)
    assert not confidence[patch].any()
    assert np.mean(confidence[~disc(100, 60, radius + 2)]) > 0.98


@pytest.mark.parametrize("slope_noise", [0, 0.05])
@pytest.mark.parametrize("surface", [BALL, SMALL_BALL, BALLS])
def test_contacts_keep_their_rims(surface, slope_noise):
    truth, gradients, pitch = scene(surface)
    noisy = with_noise(gradients, slope_noise, np.random.default_rng(2))
    plain = rmse_um(depth_from_gradients(noisy, mm_per_px=pitch), truth)
    assert rmse_um(gated(noisy, pitch), truth) < 1.06 * plain


def test_frames_turned_or_mirrored_are_judged_alike(monkeypatch):
    monkeypatch.setattr(curl_gated, "EVERY_EDGE", 1)
    _, gradients, pitch = scene(BALL)
    rng = np.random.default_rng(5)
    lying = with_patches(with_noise(gradients, 0.05, rng), 0.1, rng).gradients
    confidence = confidence_from_curl(lying, pitch)
    turned = np.swapaxes(lying, 0, 1)[..., ::-1]
    mirrored = lying[:, ::-1] * (-1, 1)
    for other in (confidence_from_curl(turned, pitch).T, confidence_from_curl(mirrored, pitch)[:, ::-1]):
        # Of regions of one size another comes first, where they share a rim.
        assert np.mean(confidence != other) < 1e-3


def test_nothing_that_jumps_is_nothing_to_judge():
    circulation = np.zeros((5, 6), dtype=np.float32)
    jumps = np.zeros((6, 6), dtype=np.float32), np.zeros((5, 7), dtype=np.float32)
    assert patches_from_jumps(circulation, jumps, 0.1) is None
    edges = np.ones((4, 4)), np.ones((3, 5))
    with pytest.raises(ValueError, match="Expected weights per pixel"):
        depth_from_gradients(np.zeros((4, 5, 2)), mm_per_px=0.1, weights=edges, solver="curl_gated")


@pytest.mark.parametrize("shape", [(2, 2), (2, 9), (3, 4), (5, 31)])
def test_tiny_frames_of_noise_come_back_finite(shape):
    noise = np.random.default_rng(6).standard_normal((*shape, 2))
    assert np.isfinite(gated(noise, (0.1, 0.2))).all()
