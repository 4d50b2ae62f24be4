"""Solver: the protocol of all solvers, and the weighted least-squares problem of one frame that they solve.

    E(z) = sum wx (z_x - p)^2 + wy (z_y - q)^2 + sum anchor z^2 / (hx hy)

The sum is over edges; the normal equations are `A z = f` with `A = D^T W D + diag(anchor)`, `f = D^T W e`. All
solvers that take weights share this module, so that they solve the same problem.

An edge lies between two neighboring pixels: along x there are (H, W-1) of them, along y (H-1, W). Edge slopes ex, ey
are compared with differences of depth along them. No edge crosses the border of the frame, so the border is free.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np

from gelform._native import Kernel, is_finite
from gelform.arrays import Array, Map, Mask, Slopes
from gelform.errors import ConvergenceError
from gelform.foundations.filters import fill_unknown

Pair = tuple[Array, Array]  # maps of the edges along x, (H, W-1), and along y, (H-1, W)
Weights = Array | Pair | None


class Solution(NamedTuple):
    """The answer of a solver for one frame; a direct method has no iterations and no tolerance."""

    depth_mm: Map  # (H, W) float32; each island up to a constant; 0 outside the mask
    known: Mask  # (H, W) bool; False outside the mask and where neither a slope nor an anchor counts
    iterations: int = 0
    tolerance: float = 0.0  # estimated largest error relative to the range of depth


class Solver(Protocol):
    """A method, prepared for frames of one shape; threads can share it. Its depth is finite, or it raises ConvergenceError.

    One that does not take weights, mask and anchor treats all slopes alike, and refuses them with a ValueError.
    """

    takes_weights: ClassVar[bool]

    def __init__(self, shape: tuple[int, int], mm_per_px: tuple[float, float]) -> None:
        """Prepare everything that depends only on the shape (H, W) and the pitch (x, y), mm."""
        ...

    def __call__(
        self, gradients: Array, weights: Weights = None, mask: Mask | None = None, anchor: Array | None = None
    ) -> Solution:
        """Depth of one frame of slopes (H, W, 2); weights (H, W) or per edge ((H, W-1), (H-1, W))."""
        ...


def check_depth(depth: Map) -> Map:
    """The depth; ConvergenceError: it is not finite."""
    if not is_finite(depth):
        raise ConvergenceError(
            "Expected finite depth, got infinity or NaN. Slopes, weights, anchor or mm_per_px differ by more than float32 "
            "holds: check their scales."
        )
    return depth


_residual_squares = Kernel(
    "residual_squares",
    "f32[n,h,w] depth, f32[n,h,w,2] gradients, bool[n,h,w] known, f32 per_x, f32 per_y, out f64[2] result",
)


def edges_from_gradients(gradients: Array, *, order: int = 2) -> Pair:
    """Edge slopes (..., H, W-1) and (..., H-1, W) of gradients, mm/mm.

    The mean of the two pixels (order 2, trapezoid) or the four-pixel rule (order 4).
    """
    rule = _trapezoid if order == 2 else _four_pixels
    edge_y = rule(np.swapaxes(gradients[..., 1], -1, -2))
    return rule(gradients[..., 0]), np.swapaxes(edge_y, -1, -2)


def differences(depth: Array, mm_per_px: tuple[float, float]) -> Pair:
    """Slopes of a depth map (..., H, W) along its edges, mm/mm: `D z`."""
    return np.diff(depth, axis=-1) / mm_per_px[0], np.diff(depth, axis=-2) / mm_per_px[1]


def divergence(edges: Pair, mm_per_px: tuple[float, float]) -> Array:
    """Adjoint of `differences`: `D^T e`, (..., H, W)."""
    edge_x, edge_y = edges[0] / mm_per_px[0], edges[1] / mm_per_px[1]
    total = np.zeros((*edge_x.shape[:-1], edge_y.shape[-1]), dtype=edge_x.dtype)
    total[..., :, :-1] -= edge_x
    total[..., :, 1:] += edge_x
    total[..., :-1, :] -= edge_y
    total[..., 1:, :] += edge_y
    return total


def residual_rms(depth: Map, gradients: Slopes, known: Mask, hx: float, hy: float) -> float:
    """RMS of recovered minus given slope over the edges between known pixels of a stack (N, H, W)."""
    result = np.empty(2)
    _residual_squares(depth, gradients, known, 1 / hx, 1 / hy, result)
    return float(np.sqrt(result[0] / max(result[1], 1)))


def _trapezoid(p: Array) -> Array:
    return (p[..., 1:] + p[..., :-1]) * p.dtype.type(0.5)


def _four_pixels(p: Array) -> Array:
    """Mean over an edge of the cubic through four pixels: (-1, 13, 13, -1)/24, border (9, 19, -5, 1)/24."""
    count = p.shape[-1]
    if count < 4:
        return _trapezoid(p)
    edge = np.empty((*p.shape[:-1], count - 1), dtype=p.dtype)
    edge[..., 1:-1] = 13 * (p[..., 1:-2] + p[..., 2:-1]) - p[..., :-3] - p[..., 3:]
    for at, q in ((0, p), (-1, p[..., ::-1])):
        edge[..., at] = 9 * q[..., 0] + 19 * q[..., 1] - 5 * q[..., 2] + q[..., 3]
    return edge / p.dtype.type(24)


# Fraction of the largest weight: slopes of less weight are replaced by a fill from their neighbors, and get this weight.
# Smaller weights would isolate regions beyond the resolution of float32.
FLOOR = 1e-3
# One of so many edges or loops counts for the usual residual or curl: enough of them, and a median is slow.
EVERY_EDGE = 7
_HIGHEST_ANCHOR = 1e30  # over the largest weight; float32 holds it beside weights of 1, with room for sums


class LinearSystem(NamedTuple):
    """One frame, ready to load: slopes without weight are filled, weights scaled to 1 at most.

    It has either `gradients` and `confidence` per pixel, or `edges` and `edge_weights` per edge.
    """

    gradients: Array | None
    confidence: Array | None
    edges: Pair | None
    edge_weights: Pair | None
    mask: Mask
    anchor: Array
    known: Mask


_scale_weights = Kernel(
    "scale_weights",
    "f32[h,w] weights, bool[h,w]? mask, f32[h,w]? anchor, f32 floor, out f32[h,w] confidence, out bool[h,w] trusted, "
    "out bool[h,w] known, out f64[2] found",
)


def problem_from_gradients(
    gradients: Array, weights: Weights, mask: Mask | None, anchor: Array | None
) -> LinearSystem:
    """Scale the weights, and replace slopes of weight under `FLOOR` by a fill from their neighbors.

    Only the ratios of weights and anchor matter, so both are divided by the largest weight.
    """
    shape = gradients.shape[:2]
    gradients = np.ascontiguousarray(gradients, dtype=np.float32)
    whole = mask is None
    mask = constant_map(shape, True) if mask is None else mask
    if anchor is None:
        anchor = constant_map(shape, 0.0)
    else:
        anchor = np.ascontiguousarray(anchor if whole else anchor * mask, dtype=np.float32)
    if isinstance(weights, tuple):
        return _problem_per_edge(gradients, weights, mask, anchor)
    if weights is None:
        return LinearSystem(gradients, mask.astype(np.float32), None, None, mask, anchor, mask.copy())
    confidence, found = np.empty(shape, np.float32), np.empty(2)
    trusted, known = np.empty(shape, bool), np.empty(shape, bool)
    pixels = np.ascontiguousarray(weights, dtype=np.float32)
    held = None if anchor is constant_map(shape, 0.0) else anchor
    _scale_weights(pixels, None if whole else mask, held, FLOOR, confidence, trusted, known, found)
    largest, untrusted = _checked_largest(float(found[0])), int(found[1])
    if untrusted:
        gradients = fill_unknown(gradients, trusted)
    return LinearSystem(gradients, confidence, None, None, mask, _relative(anchor, largest), known)


def _relative(anchor: Map, largest: float) -> Map:
    """The anchor in units of the largest weight."""
    if largest == 1 or anchor is constant_map(anchor.shape, 0.0):
        return anchor
    highest = float(anchor.max()) / largest
    if highest > _HIGHEST_ANCHOR:
        raise ValueError(
            f"Expected an anchor up to {_HIGHEST_ANCHOR:.0e} of the largest weight, {largest:.1e}, got {highest:.1e}. "
            "Only the ratio of anchor and weights counts: check the scale of both."
        )
    return (anchor / largest).astype(np.float32)


@lru_cache(maxsize=16, typed=True)
def constant_map(shape: tuple[int, int], value: float | bool) -> Array:
    """A shared map of one value that nobody can write to; unwritten zeros take no memory."""
    dtype = bool if isinstance(value, bool) else np.float32
    shared = np.full(shape, value, dtype=dtype) if value else np.zeros(shape, dtype=dtype)
    shared.flags.writeable = False
    return shared


def _problem_per_edge(gradients: Array, weights: Pair, mask: Mask, anchor: Array) -> LinearSystem:
    inside = mask[:, 1:] & mask[:, :-1], mask[1:] & mask[:-1]
    inner = np.concatenate([w[i] for w, i in zip(weights, inside)])
    largest = _checked_largest(float(inner.max()) if inner.size else 0.0)
    trusted = tuple((w >= FLOOR * largest) & i for w, i in zip(weights, inside))
    edges = edges_from_gradients(gradients)
    filled = tuple(e if t.all() else fill_unknown(e[..., None], t)[..., 0] for e, t in zip(edges, trusted))
    scaled = tuple((np.maximum(w / largest, FLOOR) * i).astype(np.float32) for w, i in zip(weights, inside))
    known = anchor > 0
    known[:, 1:] |= trusted[0]
    known[:, :-1] |= trusted[0]
    known[1:] |= trusted[1]
    known[:-1] |= trusted[1]
    return LinearSystem(None, None, filled, scaled, mask, _relative(anchor, largest), known)  # type: ignore[arg-type]


def _checked_largest(largest: float) -> float:
    if largest == 0:
        raise ValueError(
            "Expected weights with at least one value > 0 inside the mask, got 0 everywhere: no slope says "
            "anything. Lower what is asked of a pixel to be trusted, or leave weights out."
        )
    return largest


def per_edge(problem: LinearSystem, dtype: Any = np.float64) -> tuple[Pair, Pair]:
    """Slopes and weights of the edges; one between two pixels has the harmonic mean of their confidence.

    That is the variance of an averaged slope.
    """
    if problem.edges is not None and problem.edge_weights is not None:
        return problem.edges, problem.edge_weights
    assert problem.gradients is not None
    assert problem.confidence is not None
    c = problem.confidence.astype(dtype)
    pairs = (c[:, 1:], c[:, :-1]), (c[1:], c[:-1])
    across, down = (2 * a * b / np.maximum(a + b, dtype(1e-30)) for a, b in pairs)
    return edges_from_gradients(problem.gradients.astype(dtype)), (across, down)


def edge_system(problem: LinearSystem, mm_per_px: tuple[float, float]) -> tuple[Array, Array, Array]:
    """Couplings (H, W-1) and (H-1, W), and right side (H, W)."""
    (edges, weights), (hx, hy) = per_edge(problem), mm_per_px
    flux = edges[0] * weights[0], edges[1] * weights[1]
    return weights[0] * (hy / hx), weights[1] * (hx / hy), divergence(flux, mm_per_px) * (hx * hy)
