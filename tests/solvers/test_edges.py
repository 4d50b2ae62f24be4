"""Edges between pixels: what a depth leaves unsatisfied along them."""

from __future__ import annotations

import numpy as np
import pytest

from gelform.solvers import edges
from gelform.solvers.edges import differences, edges_from_gradients, residual_rms
from kernel_agreement import assert_kernel_agrees

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
            edges._residual_squares, squares, depth, gradients, known, 20.0, 12.5, np.zeros(2)
        )


def test_a_surface_leaves_nothing_and_a_wrong_edge_what_it_is_wrong_by():
    depth = np.zeros((1, 4, 5), dtype=np.float32)
    gradients, known = np.zeros((1, 4, 5, 2), dtype=np.float32), np.ones((1, 4, 5), dtype=bool)
    assert residual_rms(depth, gradients, known, *PITCH) == 0
    depth[0, 0, 0] = 0.1
    expected = np.sqrt(((0.1 / PITCH[0]) ** 2 + (0.1 / PITCH[1]) ** 2) / (4 * 4 + 3 * 5))
    assert residual_rms(depth, gradients, known, *PITCH) == pytest.approx(expected, rel=1e-5)
