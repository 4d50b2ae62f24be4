"""A frame and its coarser levels, in C: couplings, right side, and the iteration that solves for depth."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelform._native import Handle, Kernel
from gelform.errors import ConvergenceError
from gelform.solvers.system import Problem, edge_system

_load = Kernel(
    "multigrid_load",
    "multigrid* grid, f32[h,w,2] gradients, f32[h,w] confidence, f32[h,w] anchor, f32 hx, f32 hy",
)
_load_edges = Kernel(
    "multigrid_load_edges",
    "multigrid* grid, f32[h,edges] east, f32[rows,w] south, f32[h,w] anchor, f32[h,w] right",
)
_build = Kernel("multigrid_build", "multigrid* grid")
_solve = Kernel(
    "multigrid_solve",
    "multigrid* grid, f32[h,w]? start, out f32[h,w] depth, f64 whole, f64 tolerance, i32 limit, out f64[2] report",
)
# Floats for each pixel, coarse levels included: 9 planes of the finest, 16 of each coarser one.
PLANES = 9 + 16 / 3
_NOT_CONVERGED, _NOT_FINITE = 1, 2  # as in conjugate.c


class Grid:
    """Memory for one frame at a time, and the couplings that it was last built for.

    Where `solve` raises, the grid must not be used again: its arrays may hold NaN. `Pool` sees to that.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self.shape = shape
        try:
            self.handle = Handle("multigrid", *shape)
        except MemoryError:
            need = 4e-9 * PLANES * shape[0] * shape[1]
            raise MemoryError(
                f"Expected {need:.1f} GB of free memory for a weighted solution of {shape[0]}x{shape[1]} px, got less. "
                "Halve the image, or leave out weights, mask and anchor: solver 'dct' needs a tenth."
            ) from None

    def load(self, problem: Problem, mm_per_px: tuple[float, float]) -> None:
        """Take a frame; the coarse levels are computed anew only if its couplings differ from the last's."""
        if problem.gradients is None or problem.confidence is None:
            system = *edge_system(problem, mm_per_px), problem.anchor
            self.load_edges(*(np.ascontiguousarray(array, dtype=np.float32) for array in system))
        elif _load(self.handle, problem.gradients, problem.confidence, problem.anchor, *mm_per_px):
            self.build()

    def load_edges(
        self,
        east: NDArray[np.float32],
        south: NDArray[np.float32],
        right: NDArray[np.float32],
        anchor: NDArray[np.float32],
    ) -> None:
        """Take couplings (H, W-1) and (H-1, W), right side and anchor (H, W)."""
        _load_edges(self.handle, east, south, anchor, right)
        self.build()

    def build(self) -> None:
        """Compute the coarse levels from the finest."""
        _build(self.handle)

    def solve(
        self,
        tolerance: float,
        max_iterations: int,
        start: NDArray[np.float32] | None = None,
        whole: float = 0.0,
    ) -> tuple[NDArray[np.float32], int, float]:
        """Depth for the loaded right side, added to a start that left it.

        Parameters
        ----------
        tolerance, max_iterations : when to stop
        start : (H, W), optional
        whole : float
            What errors are a share of; 0: the range of the first answer.

        Returns
        -------
        depth : (H, W) float32
        iterations : int
        error : float
            Estimated largest error, as a share.

        Raises
        ------
        ConvergenceError
            The tolerance was not reached, or float32 does not hold the answer.
        """
        depth, report = np.empty(self.shape, dtype=np.float32), np.empty(2)
        status = _solve(self.handle, start, depth, whole, tolerance, max_iterations, report)
        done, error = int(report[0]), float(report[1])
        if status == _NOT_FINITE:
            raise ConvergenceError(
                "Expected depth that float32 can hold, got infinity or NaN. Slopes, or an anchor relative to the "
                "weights, beyond 1e30 do this: scale them down."
            )
        if status == _NOT_CONVERGED:
            raise ConvergenceError(
                f"Expected depth to within {tolerance:.1e} of its range, got an estimated error of "
                f"{error:.1e} after {done} iterations. Very long channels one pixel wide in the mask can "
                "do this, and so does a tolerance below 1e-6, where float32 ends: open them, use "
                "solver='sparse', or allow more iterations."
            )
        return depth, done, error
