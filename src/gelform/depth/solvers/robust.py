"""Robust depth without known confidence: iteratively reweighted least squares around `multigrid`.

Each round computes an edge's weight from its residual by the loss, relative to the usual residual of the frame
(P. W. Holland and R. E. Welsch, Robust regression using iteratively reweighted least-squares, Communications in
Statistics A6, 1977).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from gelform.depth.solvers.dct import DctSolver
from gelform.depth.solvers.multigrid import Grid
from gelform.depth.solvers.seam import Pair, Solution, Weights
from gelform.depth.solvers.system import (
    EVERY_EDGE,
    FLOOR,
    LinearSystem,
    differences,
    divergence,
    edges_from_gradients,
    problem_from_gradients,
)
from gelform.foundations.filters import SIGMA_OF_MEDIAN
from gelform.foundations.pool import Pool

Loss = Callable[[NDArray[Any]], NDArray[Any]]

# Weight of a residual in units of the usual residual; the constants give 95 % efficiency under Gaussian noise.
LOSSES: dict[str, Loss] = {
    "huber": lambda r: 1.345 / np.maximum(np.abs(r), 1.345),
    "cauchy": lambda r: 1 / (1 + (r / 2.385) ** 2),
    "l1": lambda r: 0.1 / np.maximum(np.abs(r), 0.1),
}
# Fraction of the range of depth, in each round and in the last; the weights change more from round to round.
TOLERANCE, LAST_TOLERANCE = 3e-3, 1e-3


class RobustSolver:
    """A solver that repeats four steps with Cauchy's loss: residuals, usual residual, weights, solve.

    Parameters
    ----------
    shape : (H, W)
    mm_per_px : (x, y), mm
    rounds : int
    """

    takes_weights: ClassVar[bool] = True
    loss: ClassVar[str] = "cauchy"

    def __init__(
        self,
        shape: tuple[int, int],
        mm_per_px: tuple[float, float],
        *,
        rounds: int = 3,
    ) -> None:
        self.shape = shape
        self.mm_per_px = mm_per_px
        self.rounds = rounds
        self._weight = LOSSES[self.loss]
        self._uniform = DctSolver(shape, mm_per_px)
        self._pool = Pool(lambda: Grid(shape))

    def __call__(
        self,
        gradients: NDArray[Any],
        weights: Weights = None,
        mask: NDArray[np.bool_] | None = None,
        anchor: NDArray[Any] | None = None,
    ) -> Solution:
        """Depth of one frame; given weights multiply those of the loss."""
        problem = _per_edge(problem_from_gradients(gradients, weights, mask, anchor))
        with self._pool.one() as grid:
            if weights is None and mask is None and anchor is None:
                depth, iterations, error = self._uniform(gradients).depth_mm, 0, 0.0
            else:
                grid.load(problem, self.mm_per_px)
                depth, iterations, error = grid.solve(TOLERANCE, 1000)
            for turn in range(self.rounds):
                self._load_round(grid, problem, depth)
                tolerance = LAST_TOLERANCE if turn == self.rounds - 1 else TOLERANCE
                depth, more, error = grid.solve(tolerance, 1000, depth, float(np.ptp(depth)))
                iterations += more
        return Solution(depth, problem.known, iterations, error)

    def _load_round(self, grid: Grid, problem: LinearSystem, depth: NDArray[np.float32]) -> None:
        """Load new weights from the residuals of a depth, and the remaining right side."""
        assert problem.edges is not None
        assert problem.edge_weights is not None
        pitch = self.mm_per_px
        residual = tuple(e - d for e, d in zip(problem.edges, differences(depth, pitch)))
        usual = _usual(residual, problem.edge_weights)  # type: ignore[arg-type]
        weights = tuple(
            w * np.maximum(self._weight(r / usual), FLOOR) for w, r in zip(problem.edge_weights, residual)
        )
        flux = tuple(w * r for w, r in zip(weights, residual))
        right = divergence(flux, pitch) * np.float32(pitch[0] * pitch[1])  # type: ignore[arg-type]
        stretched = weights[0] * (pitch[1] / pitch[0]), weights[1] * (pitch[0] / pitch[1])
        system = *stretched, right - problem.anchor * depth, problem.anchor
        grid.load_edges(*(np.ascontiguousarray(array, dtype=np.float32) for array in system))


class HuberSolver(RobustSolver):
    """As `RobustSolver`, with Huber's loss: quadratic for small residuals, absolute for large ones."""

    loss: ClassVar[str] = "huber"


class L1Solver(RobustSolver):
    """As `RobustSolver`, with absolute residuals."""

    loss: ClassVar[str] = "l1"


def _per_edge(problem: LinearSystem) -> LinearSystem:
    """The same problem, with edge slopes and weights."""
    if problem.edges is not None:
        return problem
    assert problem.gradients is not None
    c = problem.confidence
    assert c is not None
    weights = tuple(
        2 * a * b / np.maximum(a + b, np.float32(1e-30)) for a, b in ((c[:, 1:], c[:, :-1]), (c[1:], c[:-1]))
    )
    return problem._replace(edges=edges_from_gradients(problem.gradients), edge_weights=weights)


def _usual(residual: Pair, weights: Pair) -> np.float32:
    """Usual residual: the median size of the residuals with weight, as a standard deviation; tiny if all are 0."""
    sample = [(r.ravel()[::EVERY_EDGE], w.ravel()[::EVERY_EDGE]) for r, w in zip(residual, weights)]
    sizes = np.concatenate([np.abs(r[w > 0]) for r, w in sample])
    return np.float32(max(SIGMA_OF_MEDIAN * float(np.median(sizes)) if sizes.size else 0.0, 1e-6))
