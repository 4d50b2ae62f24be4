"""Patches that lie coherently: found by their rims, while contacts keep theirs."""

from __future__ import annotations

import numpy as np
import pytest

from gelform.depth import depth_from_gradients
from gelform.solvers.curl_gated import solver as gated_module
from gelform.solvers.curl_gated.patches import patches_from_jumps
from gelform.solvers.curl_gated.solver import confidence_from_curl
from scenes import BALL, BALLS, PEAKS, SHAPE, SMALL_BALL, rmse_um, scene, with_noise, with_patches

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


@pytest.mark.parametrize("seed", [2, 3])
def test_contacts_that_patches_cross_are_kept(seed):
    truth, gradients, pitch = scene(BALLS)
    noisy = with_noise(gradients, 0.02, np.random.default_rng(seed))
    lying = with_patches(noisy, 0.15, np.random.default_rng(seed + 50))
    assert rmse_um(gated(lying.gradients, pitch), truth) < 25


def test_frames_turned_or_mirrored_are_judged_alike(monkeypatch):
    monkeypatch.setattr(gated_module, "EVERY", 1)
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


@pytest.mark.parametrize("shape", [(2, 2), (2, 9), (3, 4), (5, 31)])
def test_tiny_frames_of_noise_come_back_finite(shape):
    noise = np.random.default_rng(6).standard_normal((*shape, 2))
    assert np.isfinite(gated(noise, (0.1, 0.2))).all()
