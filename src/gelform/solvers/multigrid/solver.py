"""Weighted least squares at video rate: conjugate gradients, preconditioned by black-box multigrid.

J. E. Dendy, Black box multigrid, J. Comput. Phys. 48, 1982; R. Kettler, in Multigrid Methods, LNM 960, 1982
(as a preconditioner). The operator-dependent interpolation is what makes 4 to 6 iterations suffice at jumps
of the weights by 1000, where plain multigrid needs 24 to 80 or stalls.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from gelform.errors import ConvergenceError
from gelform.pool import Pool
from gelform.solvers.edges import Pair
from gelform.solvers.multigrid.conjugate import solve
from gelform.solvers.multigrid.cycle import DEPTH, PLANES, SEARCH
from gelform.solvers.multigrid.hierarchy import LINES, N, build
from gelform.solvers.seam import Solution, Weights
from gelform.solvers.system import Problem, load, problem_from_gradients

COARSEST = 40


class Hierarchy:
    """Work arrays for one frame at a time, and the couplings that they were last built for."""

    def __init__(self, shape: tuple[int, int]) -> None:
        levels = [(0, *shape)]
        while levels[-1][1] * levels[-1][2] > COARSEST:
            top, height, width = levels[-1]
            levels.append((top + height + 3, (height + 1) // 2, (width + 1) // 2))
        self.levels = np.array(levels, dtype=np.int64)
        self.data = np.zeros((PLANES, levels[-1][0] + levels[-1][1] + 3, shape[1] + 3), dtype=np.float32)
        self.dense = np.zeros((COARSEST, COARSEST), dtype=np.float32)
        self._frame = slice(1, shape[0] + 1), slice(1, shape[1] + 1)
        # Of a solve: lines of the frame's width, and the errors of the last four iterations.
        self.scratch = np.zeros((3, shape[1] + 3), dtype=np.float32), np.zeros(4)
        self._lines = np.zeros(LINES * N, dtype=np.float32)
        self._elimination = np.zeros((COARSEST, 2 * COARSEST))
        self._built = False

    def load(self, problem: Problem, mm_per_px: tuple[float, float]) -> None:
        """Take a frame; the coarse levels are computed anew only if its couplings differ from the last's."""
        if load(self.data, problem, mm_per_px) or not self._built:
            self.rebuild()

    def rebuild(self) -> None:
        """Compute the coarse levels from the finest."""
        self._lines[:] = 0
        build(self.data, self.levels, self.dense, self._lines, self._elimination)
        self._built = True

    def solve(
        self, tolerance: float, max_iterations: int, start: NDArray[Any] | None = None, scale: float = 0.0
    ) -> tuple[NDArray[np.float32], int, float]:
        """Depth for the loaded right side (of the residual, if it starts from a depth), iterations, error."""
        self.data[DEPTH : SEARCH + 1, : self.levels[0, 1] + 3] = 0
        if start is not None:
            self.data[DEPTH][self._frame] = start
        done, estimate = solve(
            self.data, self.levels, self.dense, *self.scratch, scale, tolerance, max_iterations
        )
        if not estimate <= tolerance:
            self._built = False
            raise ConvergenceError(
                f"Expected depth to within {tolerance:.1e} of its range, got an estimated error of "
                f"{estimate:.1e} after {done} iterations. Very long channels one pixel wide in the mask can "
                "do this: open them, use solver='sparse', or allow more iterations."
            )
        return self.data[DEPTH][self._frame].copy(), done, estimate


class MultigridSolver:
    """Prepared once for a shape and a pitch; takes weights, mask and anchor with each frame.

    Parameters
    ----------
    shape : (H, W)
    mm_per_px : (x, y), mm
    tolerance : float
        Largest error, relative to the range of depth, as estimated when the iteration stops.
    max_iterations : int

    Raises
    ------
    ConvergenceError
        The tolerance was not reached; the message names a cause and remedies.
    """

    takes_weights: ClassVar[bool] = True

    def __init__(
        self,
        shape: tuple[int, int],
        mm_per_px: tuple[float, float],
        *,
        tolerance: float = 4e-4,
        max_iterations: int = 1000,
    ) -> None:
        self.shape = shape
        self.mm_per_px = mm_per_px
        self.tolerance = tolerance
        self.max_iterations = max_iterations
        self.pool = Pool(lambda: Hierarchy(shape))

    def __call__(
        self,
        gradients: NDArray[Any],
        weights: Weights | Pair = None,
        mask: NDArray[np.bool_] | None = None,
        anchor: NDArray[Any] | None = None,
    ) -> Solution:
        """Depth of one frame of slopes (H, W, 2); weights (H, W) or per edge ((H, W-1), (H-1, W))."""
        problem = problem_from_gradients(gradients, weights, mask, anchor)
        with self.pool.one() as hierarchy:
            hierarchy.load(problem, self.mm_per_px)
            depth, iterations, error = hierarchy.solve(self.tolerance, self.max_iterations)
        return Solution(depth, problem.known, iterations, error)
