"""Weighted least squares by sparse elimination in float64: the reference, for tests and small jobs."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import scipy  # its parts load at first use; a weighted solve needs none of them
from numpy.typing import NDArray

from gelform.depth.solvers.seam import Solution, Weights
from gelform.depth.solvers.system import LinearSystem, edge_system, problem_from_gradients


class SparseSolver:
    """Exact up to rounding for any weights; 100 times slower than `multigrid`."""

    takes_weights: ClassVar[bool] = True

    def __init__(self, shape: tuple[int, int], mm_per_px: tuple[float, float]) -> None:
        self.shape = shape
        self.mm_per_px = mm_per_px

    def __call__(
        self,
        gradients: NDArray[Any],
        weights: Weights = None,
        mask: NDArray[np.bool_] | None = None,
        anchor: NDArray[Any] | None = None,
    ) -> Solution:
        """Depth of one frame of slopes (H, W, 2); weights (H, W) or per edge ((H, W-1), (H-1, W))."""
        problem = problem_from_gradients(gradients, weights, mask, anchor)
        matrix, right = normal_equations(problem, self.mm_per_px)
        # An island without an anchor has no absolute height; one of its pixels is held at 0.
        _, island = scipy.sparse.csgraph.connected_components(matrix, directed=False)
        anchored = np.bincount(island, weights=problem.anchor.ravel()) > 0
        first = np.unique(island, return_index=True)[1]
        free = np.ones(right.size, dtype=bool)
        free[first[~anchored]] = False
        depth = np.zeros(right.size)
        if free.any():
            # Definite: each island has an anchor or a pixel that is held.
            depth[free] = scipy.sparse.linalg.spsolve(matrix[free][:, free].tocsc(), right[free])
        return Solution(depth.reshape(self.shape).astype(np.float32), problem.known, 0, 0.0)


def normal_equations(
    problem: LinearSystem, mm_per_px: tuple[float, float]
) -> tuple[scipy.sparse.csr_matrix, NDArray[np.float64]]:
    """Matrix (H*W, H*W) and right side of the least-squares problem, in float64."""
    height, width = problem.mask.shape
    east, south, right = edge_system(problem, mm_per_px)
    pixel = np.arange(height * width).reshape(height, width)
    one = np.concatenate([pixel[:, :-1].ravel(), pixel[:-1].ravel()])
    other = np.concatenate([pixel[:, 1:].ravel(), pixel[1:].ravel()])
    tie = np.concatenate([east.ravel(), south.ravel()]).astype(np.float64)
    coupling = scipy.sparse.csr_matrix((tie, (one, other)), shape=(pixel.size, pixel.size))
    coupling = coupling + coupling.T
    coupling.eliminate_zeros()
    diagonal: Any = np.asarray(coupling.sum(axis=1)).ravel() + problem.anchor.ravel()
    return scipy.sparse.csr_matrix(scipy.sparse.diags(diagonal) - coupling), right.ravel().astype(np.float64)
