"""Lattice regression: a linear law is met everywhere, nothing at no change, residuals are of samples not fitted."""

import numpy as np
import pytest

from gelform.color_models._shared.lattice import Lattice, corner_weights, held_out_residuals

SIZES = (2, 1, 5, 5, 5)
ZERO = (1, 2, 3)
LAW = np.array([[0.3, -0.1], [0.2, 0.4], [-0.2, 0.1]])


def samples(count=3000, seed=0):
    """Positions on the five axes, in nodes, and slopes that are linear in the last three."""
    rng = np.random.default_rng(seed)
    at = [rng.uniform(0, size - 1, count) for size in SIZES]
    return at, (np.stack(at[2:], axis=1) - ZERO) @ LAW


def test_corner_weights_are_multilinear():
    at, _ = samples()
    corners = corner_weights(at, SIZES)
    np.testing.assert_allclose(corners.sum(axis=1), 1)
    nodes = np.stack(np.unravel_index(np.arange(np.prod(SIZES)), SIZES), axis=1)
    np.testing.assert_allclose(corners @ nodes, np.stack(at, axis=1), atol=1e-12)


def test_beyond_the_grid_the_nearest_face_counts():
    beyond, face = (
        corner_weights([np.array([v]) for v in at], SIZES) for at in ([3, 0, -2, 9, 1], [1, 0, 0, 4, 1])
    )
    np.testing.assert_array_equal(beyond.toarray(), face.toarray())


def test_a_linear_law_is_met_and_no_change_has_no_slope():
    at, target = samples()
    lattice = Lattice(SIZES, ZERO, smoothness=1e-6)
    corners = corner_weights(at, SIZES)
    slopes = lattice.fitted(corners, target, np.ones(len(target)))
    assert np.abs(slopes.reshape(*SIZES, 2)[:, :, 1, 2, 3]).max() == 0
    error = corners @ slopes - target
    assert np.sqrt(np.mean(error**2)) < 0.01 * np.sqrt(np.mean(target**2))


def test_residuals_are_those_of_samples_that_were_not_fitted():
    """Noise that is the same within a stretch: a fit that had seen it would follow it a little."""
    at, target = samples()
    noise = np.random.default_rng(1).normal(0, 0.05, target.shape)
    lattice, corners = Lattice(SIZES, ZERO, smoothness=0.02), corner_weights(at, SIZES)
    weight = np.ones(len(target))
    held_out = held_out_residuals(lattice, corners, target + noise, weight)
    seen = corners @ lattice.fitted(corners, target + noise, weight) - target - noise
    assert np.std(held_out) == pytest.approx(0.05, rel=0.15)
    assert np.std(held_out) > np.std(seen)


def test_nodes_without_samples_follow_the_others_and_outliers_count_little():
    """All samples lie on the upper row of nodes; the lower one has only its neighbours to go by."""
    at, target = samples()
    corners, lattice = corner_weights([0 * at[0], *at[1:]], SIZES), Lattice(SIZES, ZERO, smoothness=1e-2)
    plain = lattice.fitted(corners, target, np.ones(len(target))).reshape(*SIZES, 2)
    np.testing.assert_allclose(plain[1], plain[0], atol=0.03)
    wild = np.array(target)
    wild[::20] += 5.0
    robust = lattice.fitted(corners, wild, np.ones(len(target))).reshape(*SIZES, 2)
    assert np.sqrt(np.mean((robust - plain) ** 2)) < 0.1  # a mean would be moved by 0.25
