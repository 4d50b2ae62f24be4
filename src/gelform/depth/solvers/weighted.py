"""Weighted least squares: by elimination as the reference, at video rate by multigrid, and with walls that are steep.

The video rate is that of conjugate gradients, preconditioned by black-box multigrid: J. E. Dendy, Black box multigrid,
J. Comput. Phys. 48, 1982; R. Kettler, in Multigrid Methods, LNM 960, 1982 (as a preconditioner). With the
operator-dependent interpolation, 3 to 5 iterations suffice at jumps of the weights by 1000; plain multigrid needs 24 to 80
or stalls.

Shading saturates with the slope, and the optics mix a wall with its surroundings. So a wall reads too flat, never too
steep, and `at_least` adds rounds of `multigrid` with inequality terms. Where the slopes of the depth exceed the slopes read
on a wall, in their direction, those lose their weight in the next round; elsewhere they keep it (an active set: J. Nocedal
and S. Wright, Numerical Optimization, 2006, ch. 16).
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import scipy  # its parts load at first use; a weighted solve needs none of them

from gelform._native import Handle, Kernel
from gelform.arrays import Array, Map, Mask, Numbers
from gelform.depth.solvers.seam import (
    LinearSystem,
    Solution,
    Weights,
    check_depth,
    edge_system,
    problem_from_gradients,
)
from gelform.errors import ConvergenceError
from gelform.foundations.pool import Pool
from gelform.slopes.gradients import slopes_of_solution


class SparseSolver:
    """Exact up to rounding for any weights; 100 times slower than `multigrid`."""

    takes_weights: ClassVar[bool] = True

    def __init__(self, shape: tuple[int, int], mm_per_px: tuple[float, float]) -> None:
        self.shape = shape
        self.mm_per_px = mm_per_px

    def __call__(
        self, gradients: Array, weights: Weights = None, mask: Mask | None = None, anchor: Array | None = None
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
        return Solution(check_depth(depth.reshape(self.shape).astype(np.float32)), problem.known)


def normal_equations(
    problem: LinearSystem, mm_per_px: tuple[float, float]
) -> tuple[scipy.sparse.csr_matrix, Numbers]:
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


_load = Kernel(
    "multigrid_load",
    "multigrid* grid, f32[h,w,2] gradients, f32[h,w] confidence, f32[h,w] anchor, f32 hx, f32 hy",
)
_load_edges = Kernel(
    "multigrid_load_edges",
    "multigrid* grid, f32[h,edges] east, f32[rows,w] south, f32[h,w] anchor, f32[h,w] right",
)
_solve = Kernel(
    "multigrid_solve",
    "multigrid* grid, f32[h,w]? start, out f32[h,w] depth, f64 whole, f64 tolerance, i32 limit, out f64[2] report",
)
# Floats for each pixel, coarse levels included: 9 planes of the finest level, 16 of each coarser one.
PLANES = 9 + 16 / 3
_NOT_CONVERGED, _NOT_FINITE = 1, 2  # the same in native/depth/solvers/multigrid/conjugate.c


class Grid:
    """Memory for one frame at a time, and the couplings of its coarse levels.

    After `solve` raises, the grid must not be used again, because its arrays may hold NaN; `Pool` makes sure of it.
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

    def load(self, problem: LinearSystem, mm_per_px: tuple[float, float]) -> None:
        """Load a frame; the coarse levels are computed again only if its couplings differ from the last ones."""
        if problem.gradients is None or problem.confidence is None:
            self.load_edges(*edge_system(problem, mm_per_px), problem.anchor)
            return
        x_mm, y_mm = mm_per_px
        _load(self.handle, problem.gradients, problem.confidence, problem.anchor, hx=x_mm, hy=y_mm)

    def load_edges(self, east: Array, south: Array, right: Array, anchor: Array) -> None:
        """Load couplings (H, W-1) and (H-1, W), right side and anchor (H, W), and compute the coarse levels."""
        system = east, south, anchor, right
        _load_edges(self.handle, *(np.ascontiguousarray(array, dtype=np.float32) for array in system))

    def solve(
        self, tolerance: float, max_iterations: int, start: Map | None = None, whole: float = 0.0
    ) -> tuple[Map, int, float]:
        """Depth (H, W) for the loaded right side, added to `start`; iterations; estimated largest error.

        The right side is the one that remains after `start`. The error is a fraction of `whole`; if that is 0, of the range
        of the first answer.

        ConvergenceError: the tolerance was not reached, or float32 cannot hold the answer.
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
                "do this, and so does a tolerance below 1e-6, where float32 ends: open them, or give "
                "integrate solver='sparse' or more iterations."
            )
        return depth, done, error


class MultigridSolver:
    """A solver for frames of one shape and pitch; it takes weights, mask and anchor with each frame.

    ConvergenceError: the tolerance was not reached; the message names a cause and remedies.
    """

    takes_weights: ClassVar[bool] = True

    def __init__(
        self,
        shape: tuple[int, int],
        mm_per_px: tuple[float, float],
        *,
        tolerance: float = 4e-4,  # largest error, relative to the range of depth, as estimated at the end
        max_iterations: int = 1000,
    ) -> None:
        self.shape, self.mm_per_px = shape, mm_per_px
        self.tolerance, self.max_iterations = tolerance, max_iterations
        self._pool = Pool(lambda: Grid(shape))

    def __call__(
        self, gradients: Array, weights: Weights = None, mask: Mask | None = None, anchor: Array | None = None
    ) -> Solution:
        """Depth of one frame of slopes (H, W, 2); weights (H, W) or per edge ((H, W-1), (H-1, W))."""
        problem = problem_from_gradients(gradients, weights, mask, anchor)
        with self._pool.one() as grid:
            grid.load(problem, self.mm_per_px)
            depth, iterations, error = grid.solve(self.tolerance, self.max_iterations)
        return Solution(depth, problem.known, iterations, error)


class AtLeastSolver(MultigridSolver):
    """As `MultigridSolver`, with at most `rounds` more rounds if there are walls."""

    def __init__(self, shape: tuple[int, int], mm_per_px: tuple[float, float], *, rounds: int = 4) -> None:
        super().__init__(shape, mm_per_px)
        self.rounds = rounds

    def __call__(
        self, gradients: Array, weights: Weights = None, mask: Mask | None = None, anchor: Array | None = None
    ) -> Solution:
        """Depth of one frame; without walls it is that of `multigrid`."""
        solution, walls = super().__call__(gradients, weights, mask, anchor), _walls(gradients)
        square = np.square(gradients).sum(axis=-1)
        for _ in range(self.rounds if walls.any() else 0):
            slopes = slopes_of_solution(solution.depth_mm, self.mm_per_px)
            exceeded = walls & ((slopes * gradients).sum(axis=-1) > square)
            factors = np.where(exceeded, np.float32(0.01), np.float32(1))  # close to none
            given: Weights = factors
            if isinstance(weights, tuple):  # an edge takes the smaller factor of its two pixels
                across, down = (np.minimum(m[1:], m[:-1]) for m in (factors.T, factors))
                given = weights[0] * across.T, weights[1] * down
            elif weights is not None:
                given = np.asarray(weights * factors, dtype=np.float32)
            solution = super().__call__(gradients, given, mask, anchor)
        return solution


def _walls(gradients: Array) -> Mask:
    """Pixels (H, W) whose slopes differ by 0.1 from those 2 px away: root of half the sum of squares; walls and edges."""
    squares = np.zeros(gradients.shape[:2], dtype=np.float32)
    for axis in (0, 1):
        along, lines = np.moveaxis(gradients, axis, 0), np.moveaxis(squares, axis, 0)
        apart = np.square(along[2:] - along[:-2]).sum(axis=-1)
        lines[2:] += apart
        lines[: len(apart)] += apart
    return np.asarray(squares > 2 * 0.1**2)
