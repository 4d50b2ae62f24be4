"""Edges between neighbouring pixels: their slopes, and differences of depth along them.

Along x there are (H, W-1) edges, along y (H-1, W). Every least-squares solver here minimises
`sum wx ((z[i,j+1] - z[i,j])/hx - ex)^2 + sum wy ((z[i+1,j] - z[i,j])/hy - ey)^2` over the depth z, with edge
slopes ex, ey. No edge crosses the border of the frame, so the border is free.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel

_residual_squares = Kernel(
    "residual_squares",
    "f32[n,h,w] depth, f32[n,h,w,2] gradients, bool[n,h,w] known, f32 per_x, f32 per_y, out f64[2] result",
)

Pair = tuple[NDArray[Any], NDArray[Any]]


def edges_from_gradients(gradients: NDArray[Any], *, order: int = 2) -> Pair:
    """Edge slopes, mm/mm: the mean of the two pixels (order 2, trapezoid) or the four-pixel rule (order 4).

    Parameters
    ----------
    gradients : (..., H, W, 2)

    Returns
    -------
    ex : (..., H, W-1)
    ey : (..., H-1, W)
    """
    rule = _trapezoid if order == 2 else _four_pixels
    edge_y = rule(np.swapaxes(gradients[..., 1], -1, -2))
    return rule(gradients[..., 0]), np.swapaxes(edge_y, -1, -2)


def differences(depth: NDArray[Any], mm_per_px: tuple[float, float]) -> Pair:
    """Slopes of a depth map (..., H, W) along its edges, mm/mm: `D z`."""
    return np.diff(depth, axis=-1) / mm_per_px[0], np.diff(depth, axis=-2) / mm_per_px[1]


def divergence(edges: Pair, mm_per_px: tuple[float, float]) -> NDArray[Any]:
    """Adjoint of `differences`: `D^T e`, (..., H, W)."""
    edge_x, edge_y = edges[0] / mm_per_px[0], edges[1] / mm_per_px[1]
    total = np.zeros((*edge_x.shape[:-1], edge_y.shape[-1]), dtype=edge_x.dtype)
    total[..., :, :-1] -= edge_x
    total[..., :, 1:] += edge_x
    total[..., :-1, :] -= edge_y
    total[..., 1:, :] += edge_y
    return total


def residual_rms(
    depth: NDArray[np.float32], gradients: NDArray[np.float32], known: NDArray[np.bool_], hx: float, hy: float
) -> float:
    """RMS of recovered minus given slope over the edges between known pixels of a stack (N, H, W)."""
    result = np.empty(2)
    _residual_squares(depth, gradients, known, 1 / hx, 1 / hy, result)
    return float(np.sqrt(result[0] / max(result[1], 1)))


def _trapezoid(p: NDArray[Any]) -> NDArray[Any]:
    return (p[..., 1:] + p[..., :-1]) * p.dtype.type(0.5)


def _four_pixels(p: NDArray[Any]) -> NDArray[Any]:
    """Mean over an edge of the cubic through four pixels: (-1, 13, 13, -1)/24, border (9, 19, -5, 1)/24."""
    count = p.shape[-1]
    if count < 4:
        return _trapezoid(p)
    edge = np.empty((*p.shape[:-1], count - 1), dtype=p.dtype)
    edge[..., 1:-1] = 13 * (p[..., 1:-2] + p[..., 2:-1]) - p[..., :-3] - p[..., 3:]
    edge[..., 0] = 9 * p[..., 0] + 19 * p[..., 1] - 5 * p[..., 2] + p[..., 3]
    edge[..., -1] = 9 * p[..., -1] + 19 * p[..., -2] - 5 * p[..., -3] + p[..., -4]
    return edge / p.dtype.type(24)
