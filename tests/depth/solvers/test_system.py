"""The problem that all weighted solvers share: scaled weights, what is trusted, couplings."""

from __future__ import annotations

import numpy as np
import pytest

from gelform.depth.solvers import system
from gelform.depth.solvers.system import (
    FLOOR,
    differences,
    edge_system,
    edges_from_gradients,
    problem_from_gradients,
    residual_rms,
)
from kernel_agreement import assert_kernel_agrees


def scaled(weights, mask, anchor, floor, confidence, trusted, known, found):
    """In numpy: what `scale_weights` writes."""
    inside = np.ones(weights.shape, bool) if mask is None else mask
    largest = weights[inside].max(initial=0)
    if largest == 0:
        return confidence * 0, trusted & False, known & False, np.array([0.0, 0.0])
    share = np.where(inside, weights, 0) / largest
    enough = share >= np.float32(floor)
    count = np.count_nonzero(inside & (share < np.float32(floor)))
    return (
        np.maximum(share, np.float32(floor)) * inside,
        enough,
        enough if anchor is None else enough | (anchor > 0),
        np.array([largest, count]),
    )


@pytest.mark.parametrize("size", [1.0, 1e-42, 3e38])
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("shape", [(1, 1), (7, 33), (20, 48)])
def test_weights_are_scaled_as_in_numpy(shape, masked, size):
    rng = np.random.default_rng(1)
    weights = (10 ** rng.uniform(-5, 0, shape) * size).astype(np.float32)
    mask = rng.uniform(size=shape) > 0.4 if masked else None
    outputs = np.zeros(shape, np.float32), *np.zeros((2, *shape), bool), np.zeros(2)
    anchor = np.maximum(rng.uniform(-1, 1, shape), 0).astype(np.float32)
    for held in (None, anchor):
        assert_kernel_agrees(system._scale_weights, scaled, weights, mask, held, FLOOR, *outputs)


def test_weights_of_zero_leave_nothing_trusted():
    weights, outputs = (
        np.zeros((3, 4), np.float32),
        (np.zeros((3, 4), np.float32), *np.zeros((2, 3, 4), bool), np.ones(2)),
    )
    assert_kernel_agrees(system._scale_weights, scaled, weights, None, None, FLOOR, *outputs)


def test_edges_of_pixels_are_those_of_their_harmonic_means():
    rng = np.random.default_rng(2)
    gradients, confidence = rng.standard_normal((5, 6, 2)), rng.uniform(0.1, 1, (5, 6))
    confidence[2, 3] = 1
    pairs = (confidence[:, 1:], confidence[:, :-1]), (confidence[1:], confidence[:-1])
    edges = tuple(2 * a * b / (a + b) for a, b in pairs)
    by_pixel = edge_system(problem_from_gradients(gradients, confidence, None, None), (0.1, 0.13))
    by_edge = edge_system(problem_from_gradients(gradients, edges, None, None), (0.1, 0.13))
    largest = max(e.max() for e in edges)  # weights per edge are scaled by the largest of them
    for one, other in zip(by_pixel, by_edge):
        assert one == pytest.approx(other * largest, abs=1e-6)


PITCH = (0.05, 0.08)


def squares(depth, gradients, known, per_x, per_y, _):
    """In numpy, float64: over edges whose pixels are both known."""
    recovered = differences(depth.astype(float), (1 / per_x, 1 / per_y))
    given = edges_from_gradients(gradients.astype(float))
    both = known[..., 1:] & known[..., :-1], known[..., 1:, :] & known[..., :-1, :]
    parts = [(r - g)[b] for r, g, b in zip(recovered, given, both)]
    return np.array([sum(np.sum(part**2) for part in parts), sum(part.size for part in parts)])


@pytest.mark.parametrize("shape", [(1, 1, 1), (2, 1, 20), (1, 20, 1), (3, 9, 16), (2, 12, 37)])
def test_residuals_are_those_of_numpy(shape):
    rng = np.random.default_rng(1)
    depth, gradients = (rng.standard_normal(s).astype(np.float32) for s in (shape, (*shape, 2)))
    for known in (np.ones(shape, bool), rng.uniform(size=shape) > 0.4, np.zeros(shape, bool)):
        assert_kernel_agrees(
            system._residual_squares, squares, depth, gradients, known, 20.0, 12.5, np.zeros(2)
        )


def test_a_surface_leaves_nothing_and_a_wrong_edge_what_it_is_wrong_by():
    depth = np.zeros((1, 4, 5), dtype=np.float32)
    gradients, known = np.zeros((1, 4, 5, 2), dtype=np.float32), np.ones((1, 4, 5), dtype=bool)
    assert residual_rms(depth, gradients, known, *PITCH) == 0
    depth[0, 0, 0] = 0.1
    expected = np.sqrt(((0.1 / PITCH[0]) ** 2 + (0.1 / PITCH[1]) ** 2) / (4 * 4 + 3 * 5))
    assert residual_rms(depth, gradients, known, *PITCH) == pytest.approx(expected, rel=1e-5)
