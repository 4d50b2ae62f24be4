"""Weighted least squares at video rate: conjugate gradients, preconditioned by black-box multigrid.

J. E. Dendy, Black box multigrid, J. Comput. Phys. 48, 1982; R. Kettler, in Multigrid Methods, LNM 960, 1982
(as a preconditioner). The operator-dependent interpolation is what makes 3 to 5 iterations suffice at jumps
of the weights by 1000, where plain multigrid needs 24 to 80 or stalls.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from gelform.pool import Pool
from gelform.solvers.edges import Pair
from gelform.solvers.multigrid.grid import Grid
from gelform.solvers.seam import Solution, Weights
from gelform.solvers.system import problem_from_gradients


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
        self._pool = Pool(lambda: Grid(shape))

    def __call__(
        self,
        gradients: NDArray[Any],
        weights: Weights | Pair = None,
        mask: NDArray[np.bool_] | None = None,
        anchor: NDArray[Any] | None = None,
    ) -> Solution:
        """Depth of one frame of slopes (H, W, 2); weights (H, W) or per edge ((H, W-1), (H-1, W))."""
        problem = problem_from_gradients(gradients, weights, mask, anchor)
        with self._pool.one() as grid:
            grid.load(problem, self.mm_per_px)
            depth, iterations, error = grid.solve(self.tolerance, self.max_iterations)
        return Solution(depth, problem.known, iterations, error)
