"""Outliers found by the curl: named, left out, and nobody else with them."""

from __future__ import annotations

import numpy as np
import pytest

from gelform.depth import depth_from_gradients, integrate
from gelform.solvers.curl_gated.solver import confidence_from_curl
from scenes import BALL, PEAKS, SHAPE, rmse_um, scene, with_noise, with_outliers


def with_noise_and_outliers(surface, share, seed=1, corrupt=with_outliers):
    truth, gradients, pitch = scene(surface)
    rng = np.random.default_rng(seed)
    return truth, corrupt(with_noise(gradients, 0.05, rng), share, rng), pitch


def test_known_confidence_beats_the_gate():
    truth, corrupted, pitch = with_noise_and_outliers(BALL, 0.15)
    depth = depth_from_gradients(corrupted.gradients, mm_per_px=pitch, weights=corrupted.valid * 1.0)
    assert rmse_um(depth, truth, corrupted.valid) < 4.5
    assert rmse_um(depth, truth) < 8


def test_names_the_outlier_pixels_and_few_others():
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
    truth, corrupted, pitch = with_noise_and_outliers(BALL, 0.05)
    hidden = np.ones(SHAPE)
    hidden[60:90, 100:140] = 0
    corrupted.gradients[60:90, 100:140] = 3
    solution = integrate(corrupted.gradients, mm_per_px=pitch, weights=hidden, solver="curl_gated")
    assert not solution.known[60:90, 100:140].any()
    assert rmse_um(solution.depth_mm, truth, hidden > 0) < 10


def test_hidden_outliers_cast_no_doubt_on_their_neighbours():
    _, gradients, pitch = scene(PEAKS)
    trusted = np.ones(SHAPE, dtype=bool)
    trusted[60:90, 100:140] = False
    gradients[~trusted] = 3
    assert not confidence_from_curl(gradients, pitch)[59:91, 99:141].all()
    assert confidence_from_curl(gradients, pitch, trusted).all()


def test_gate_refuses_weights_per_edge():
    with pytest.raises(ValueError, match="Expected weights per pixel"):
        depth_from_gradients(
            np.zeros((4, 5, 2)),
            mm_per_px=0.1,
            weights=(np.ones((4, 4)), np.ones((3, 5))),
            solver="curl_gated",
        )
