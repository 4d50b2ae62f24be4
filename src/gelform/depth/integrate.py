"""gradients -> depth in millimeters: the only entry to solvers/, the zero reference and leveling."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform._native import is_finite
from gelform.depth.solvers import SOLVERS, Solution, Solver, Weights
from gelform.depth.solvers.inputs import check_anchor, check_weights, checked_solver
from gelform.depth.solvers.seam import Pair
from gelform.depth.solvers.system import differences, edges_from_gradients, residual_rms
from gelform.depth.zero import (
    Level,
    Zero,
    checked_level,
    fitted_surface,
    median_over,
    zero_depth,
    zero_region,
)
from gelform.errors import ConvergenceError
from gelform.foundations.checks import check_gradients, check_map, check_mask, check_mm_per_px, check_slopes
from gelform.foundations.fill import fill_unknown
from gelform.slopes.gradients import curl_rms

# Pixels of the largest frame that is factorized where the iteration stalls: 13 s and 2.2 GB, measured.
MOST_DIRECT_PX = 1_000_000


@dataclass(frozen=True)
class Integration:
    """A depth map and the way to it.

    Attributes
    ----------
    depth_mm : (..., H, W) float32, mm, positive where pressed
    solver : str
        The method that ran.
    iterations : int
        0 for a direct method; for a stack, the most that a frame took.
    known : (..., H, W) bool
        False where depth was filled without information.
    tolerance : float
        Estimated largest error of the iteration, relative to the range of depth; 0 for a direct method.
    gradients : (..., H, W, 2), the given slopes
    mm_per_px : (x, y), mm

    The other figures cover known pixels only and are computed on demand.
    """

    depth_mm: NDArray[np.float32]
    solver: str
    iterations: int
    known: NDArray[np.bool_]
    tolerance: float
    gradients: NDArray[np.float32] = field(repr=False)
    mm_per_px: tuple[float, float]

    @cached_property
    def residual(self) -> float:
        """RMS over the edges of recovered minus given slope, mm/mm: the part that no surface can satisfy."""
        depth, gradients, known = self._stacked()
        return residual_rms(depth, gradients, known, *self.mm_per_px)

    @cached_property
    def curl_rms(self) -> float:
        """RMS of `dp/dy - dq/dx`, in slope per pixel."""
        _, gradients, known = self._stacked()
        return curl_rms(gradients, None if known.all() else known)

    @cached_property
    def islands(self) -> int:
        """Number of regions that no known slope connects; for a stack, the most in a frame."""
        return max(int(_islands(known).max()) for known in self._stacked()[2])

    def _stacked(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
        """Depth and known (N, H, W), gradients (N, H, W, 2)."""
        shape = (-1, *self.known.shape[-2:])
        return self.depth_mm.reshape(shape), self.gradients.reshape(*shape, 2), self.known.reshape(shape)


def depth_from_gradients(
    gradients: ArrayLike,
    *,
    mm_per_px: float | Sequence[float],
    weights: ArrayLike | tuple[ArrayLike, ArrayLike] | None = None,
    mask: ArrayLike | None = None,
    anchor: ArrayLike | None = None,
    zero: Zero | NDArray[np.bool_] = "mean",
    level: Level | None = None,
    solver: str = "auto",
) -> NDArray[np.float32]:
    """Depth from slopes by least squares with a free border; see `integrate` for the arguments."""
    solution = integrate(
        gradients,
        mm_per_px=mm_per_px,
        weights=weights,
        mask=mask,
        anchor=anchor,
        zero=zero,
        level=level,
        solver=solver,
    )
    return solution.depth_mm


def integrate(
    gradients: ArrayLike,
    *,
    mm_per_px: float | Sequence[float],
    weights: ArrayLike | tuple[ArrayLike, ArrayLike] | None = None,
    mask: ArrayLike | None = None,
    anchor: ArrayLike | None = None,
    zero: Zero | NDArray[np.bool_] = "mean",
    level: Level | None = None,
    solver: str = "auto",
) -> Integration:
    """Depth from slopes by least squares with a free border, and how it was found.

    Minimizes `sum wx (z_x - p)^2 + wy (z_y - q)^2 + anchor z^2/(hx hy)` over the edges between pixels.

    Parameters
    ----------
    gradients : (H, W, 2) or a stack (N, H, W, 2), mm/mm
    mm_per_px : float or (x, y), mm
    weights : (H, W), a stack of them, or a pair (wx, wy) of shapes (H, W-1) and (H-1, W); >= 0
        Confidence of each pixel's slopes, or of each edge. Slopes of weight under 1e-3 of the largest are
        replaced by a fill from their neighbors: their own values have no influence.
    mask : (H, W) bool
        Pixels that belong to the surface. Each island of them has its own zero; depth beyond is filled.
    anchor : float or (H, W), >= 0
        How firmly depth is held at 0, relative to weight 1: (sigma0 mm_per_px / sigma_zero_mm)^2. An island
        with an anchor takes its offset from it; `zero` moves only the other islands.
    zero : "mean", "border" or a boolean (H, W) of pixels at rest
        Where depth is 0: its mean over the frame, its median over the frame's outermost pixels, or its
        median over the given pixels.
    level : None, "slope", "plane" or "quadratic"
        Correction beside the offset: "slope" removes the median slope of the zero pixels before integrating;
        the others remove a surface fitted to the depth of the zero pixels after it. Use "slope" with an anchor: it
        removes a bias first, and leaves 2 um of it where the anchor alone leaves 19.
    solver : "auto" or a name in `SOLVERS`
        "auto" takes `dct` if weights, mask and anchor are all missing, else `multigrid`. If that does not
        converge, such as in a mesh of channels a few pixels wide, it takes `sparse`; the result names its solver.

    Raises
    ------
    ValueError, TypeError
        An argument of the wrong shape or range; weights for a solver that takes none.
    ConvergenceError
        The solver did not reach its tolerance.
    """
    pitch = check_mm_per_px(mm_per_px)
    g = check_gradients(gradients)
    check_slopes(g)
    shape = (g.shape[-3], g.shape[-2])
    level = checked_level(level)
    region = zero_region(zero, shape)
    if level == "slope":
        g = g - np.stack([median_over(g[..., c], region) for c in (0, 1)], axis=-1)[..., None, None, :]
    request = _Request(
        gradients=g,
        pitch=pitch,
        weights=None if weights is None else check_weights(weights, g.shape[:-1]),
        mask=None if mask is None else check_mask(mask, shape=shape),
        anchor=None if anchor is None else check_anchor(anchor, shape),
        zero=zero,
        region=region,
        level=level,
        solver=_solver_for(solver, uniform=weights is None and mask is None and anchor is None),
        automatic=solver == "auto",
    )
    return request.solved()


def integrate_unchecked(
    gradients: NDArray[np.float32],
    *,
    mm_per_px: float,
    weights: NDArray[np.float32] | None = None,
    anchor: NDArray[np.float32] | None = None,
    zero: Zero | NDArray[np.bool_] = "mean",
    solver: str = "auto",
) -> Integration:
    """`integrate` for one frame of a Reconstructor, without checks: its values were checked on entry.

    The gradients are in C order and pass `check_slopes`; weights and anchor (H, W) are in C order, finite and >= 0.
    """
    request = _Request(
        gradients=gradients,
        pitch=(mm_per_px, mm_per_px),
        weights=weights,
        mask=None,
        anchor=anchor,
        zero=zero,
        region=zero_region(zero, gradients.shape[:2]),
        level=None,
        solver=_solver_for(solver, uniform=weights is None and anchor is None),
        automatic=solver == "auto",
    )
    return request.solved()


def edge_residuals(depth_mm: ArrayLike, gradients: ArrayLike, *, mm_per_px: float | Sequence[float]) -> Pair:
    """Recovered minus given slope along each edge, mm/mm: it shows the slopes that no surface satisfies.

    Parameters
    ----------
    depth_mm : (..., H, W), mm
    gradients : (..., H, W, 2), mm/mm
    mm_per_px : float or (x, y), mm

    Returns
    -------
    rx : (..., H, W-1) float32
    ry : (..., H-1, W) float32

    Raises
    ------
    ValueError, TypeError
        Depth or slopes of another shape or not finite, or a pitch that is not positive.
    """
    g = check_gradients(gradients)
    depth = check_map(depth_mm, "depth_mm", shape=(g.shape[-3], g.shape[-2]))
    recovered, given = differences(depth, check_mm_per_px(mm_per_px)), edges_from_gradients(g)
    return recovered[0] - given[0], recovered[1] - given[1]


@dataclass(frozen=True)
class _Request:
    """The checked arguments of `integrate`."""

    gradients: NDArray[np.float32]
    pitch: tuple[float, float]
    weights: Weights
    mask: NDArray[np.bool_] | None
    anchor: NDArray[np.float32] | None
    zero: str | NDArray[np.bool_]
    region: NDArray[np.bool_]
    level: Level | None
    solver: str
    automatic: bool = False

    def solved(self) -> Integration:
        """Solve each frame of the stack and set its zero."""
        try:
            return self._solved()
        except ConvergenceError:
            height, width = self.gradients.shape[-3:-1]
            if not self.automatic or self.solver == "dct" or height * width > MOST_DIRECT_PX:
                raise
            return replace(self, solver="sparse", automatic=False)._solved()

    def _solved(self) -> Integration:
        g, weights = self.gradients, self.weights
        solver = _prepared(self.solver, (g.shape[-3], g.shape[-2]), self.pitch)
        if g.ndim == 3:
            depth, known, iterations, tolerance = _solved_frame(solver, g, weights, self)
        else:
            stacked = isinstance(weights, np.ndarray) and weights.ndim > 2
            frames = [
                _solved_frame(solver, g[index], weights[index] if stacked else weights, self)  # type: ignore[index,call-overload]
                for index in np.ndindex(g.shape[:-3])
            ]
            depth, known = (np.stack(maps).reshape(g.shape[:-1]) for maps in list(zip(*frames))[:2])
            iterations, tolerance = max(f.iterations for f in frames), max(f.tolerance for f in frames)
        return Integration(depth, self.solver, iterations, known, tolerance, g, self.pitch)


@lru_cache(maxsize=8)
def _prepared(name: str, shape: tuple[int, int], pitch: tuple[float, float]) -> Solver:
    return SOLVERS[name](shape, pitch)


def _solved_frame(
    solver: Solver, gradients: NDArray[np.float32], weights: Weights, request: _Request
) -> Solution:
    frame = solver(gradients, weights, request.mask, request.anchor)
    if not is_finite(frame.depth_mm):
        raise ConvergenceError(
            f"Expected finite depth, got infinity or NaN from solver {request.solver!r}. Slopes, weights, anchor "
            "or mm_per_px differ by more than float32 holds: check their scales."
        )
    return frame._replace(depth_mm=_placed(frame.depth_mm, request))


def _placed(depth: NDArray[np.float32], request: _Request) -> NDArray[np.float32]:
    """Set the zero of each island, level, then fill beyond the mask."""
    mask = request.mask
    if mask is None:
        if request.anchor is None or not request.anchor.max() > 0:
            depth -= zero_depth(depth, request.zero, request.region)
        return _levelled(depth, request, request.region)
    labels = _islands(mask)
    for island in range(1, int(labels.max()) + 1):
        inside = labels == island
        if request.anchor is None or not request.anchor[inside].any():
            depth[inside] -= zero_depth(depth, request.zero, request.region, inside)
    depth = _levelled(depth, request, request.region & mask)
    return depth if mask.all() else fill_unknown(depth[..., None], mask)[..., 0]


def _levelled(
    depth: NDArray[np.float32], request: _Request, region: NDArray[np.bool_]
) -> NDArray[np.float32]:
    if request.level not in ("plane", "quadratic"):
        return depth
    return depth - fitted_surface(depth, region, 1 if request.level == "plane" else 2)


def _islands(known: NDArray[np.bool_]) -> NDArray[Any]:
    """Labels of the 4-connected regions, from 1."""
    if known.all():
        return known.view(np.uint8)
    return cv2.connectedComponents(known.astype(np.uint8), connectivity=4)[1]


def _solver_for(solver: str, *, uniform: bool) -> str:
    if checked_solver(solver) == "auto":
        return "dct" if uniform else "multigrid"
    return solver
