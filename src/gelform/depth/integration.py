"""How a depth map was found, and how it is found once the arguments are checked: solved, placed at its zero, levelled."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform._native import is_finite
from gelform.errors import ConvergenceError
from gelform.gradients import curl_rms, fill_unknown
from gelform.solvers import SOLVERS, Solution, Solver, Weights
from gelform.solvers.edges import residual_rms
from gelform.zero import Level, fitted_surface, zero_depth


@dataclass(frozen=True)
class Integration:
    """A depth map and how it was found.

    Attributes
    ----------
    depth_mm : (..., H, W) float32, mm, positive where pressed
    solver : str
        The method that ran.
    iterations : int
        0 for a direct method; of a stack, the most that a frame took.
    known : (..., H, W) bool
        False where depth was filled without information.
    tolerance : float
        Estimated largest error of the iteration, relative to the range of depth; 0 for a direct method.
    gradients : (..., H, W, 2), that it was found from
    mm_per_px : (x, y), mm

    Its other figures, over known pixels only, are worked out when they are asked for.
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
        """RMS over the edges of recovered minus given slope, mm/mm: what no surface can satisfy."""
        depth, gradients, known = self._stacked()
        return residual_rms(depth, gradients, known, *self.mm_per_px)

    @cached_property
    def curl_rms(self) -> float:
        """RMS of `dp/dy - dq/dx`, in slope per pixel."""
        _, gradients, known = self._stacked()
        return curl_rms(gradients, None if known.all() else known)

    @cached_property
    def islands(self) -> int:
        """Regions whose depths are not connected by any known slope; of a stack, the most in a frame."""
        return max(int(_islands(known).max()) for known in self._stacked()[2])

    def _stacked(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
        """Depth and known (N, H, W), gradients (N, H, W, 2)."""
        shape = (-1, *self.known.shape[-2:])
        return self.depth_mm.reshape(shape), self.gradients.reshape(*shape, 2), self.known.reshape(shape)


@dataclass(frozen=True)
class Request:
    """The arguments of `integrate`, checked."""

    gradients: NDArray[np.float32]
    pitch: tuple[float, float]
    weights: Weights
    mask: NDArray[np.bool_] | None
    anchor: NDArray[np.float32] | None
    zero: str | NDArray[np.bool_]
    region: NDArray[np.bool_]
    level: Level | None
    solver: str

    @property
    def shape(self) -> tuple[int, int]:
        return self.gradients.shape[-3], self.gradients.shape[-2]


def integrated(request: Request) -> Integration:
    """Solve it, and say how."""
    solution = solved(request)
    return Integration(
        depth_mm=solution.depth_mm,
        solver=request.solver,
        iterations=solution.iterations,
        known=solution.known,
        tolerance=solution.tolerance,
        gradients=request.gradients,
        mm_per_px=request.pitch,
    )


@lru_cache(maxsize=8)
def _prepared(name: str, shape: tuple[int, int], pitch: tuple[float, float]) -> Solver:
    return SOLVERS[name](shape, pitch)


def solved(request: Request) -> Solution:
    """Each frame of the stack solved, at its zero."""
    solver = _prepared(request.solver, request.shape, request.pitch)
    g, weights = request.gradients, request.weights
    if g.ndim == 3:
        return _solved_frame(solver, g, weights, request)
    stacked = isinstance(weights, np.ndarray) and weights.ndim > 2
    frames = [
        _solved_frame(solver, g[index], weights[index] if stacked else weights, request)  # type: ignore[index,call-overload]
        for index in np.ndindex(g.shape[:-3])
    ]
    return Solution(
        np.stack([f.depth_mm for f in frames]).reshape(g.shape[:-1]),
        np.stack([f.known for f in frames]).reshape(g.shape[:-1]),
        max(f.iterations for f in frames),
        max(f.tolerance for f in frames),
    )


def _solved_frame(
    solver: Solver, gradients: NDArray[np.float32], weights: Weights, request: Request
) -> Solution:
    frame = solver(gradients, weights, request.mask, request.anchor)
    if not is_finite(frame.depth_mm):
        raise ConvergenceError(
            f"Expected finite depth, got infinity or NaN from solver {request.solver!r}. Slopes, weights, anchor "
            "or mm_per_px differ by more than float32 holds: check their scales."
        )
    return frame._replace(depth_mm=_placed(frame.depth_mm, request))


def _placed(depth: NDArray[np.float32], request: Request) -> NDArray[np.float32]:
    """Each island at its own zero, then levelled, then filled beyond the mask."""
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


def _levelled(depth: NDArray[np.float32], request: Request, region: NDArray[np.bool_]) -> NDArray[np.float32]:
    if request.level not in ("plane", "quadratic"):
        return depth
    return depth - fitted_surface(depth, region, 1 if request.level == "plane" else 2)


def _islands(known: NDArray[np.bool_]) -> NDArray[Any]:
    """Labels of the 4-connected regions, from 1."""
    if known.all():
        return known.view(np.uint8)
    return cv2.connectedComponents(known.astype(np.uint8), connectivity=4)[1]
