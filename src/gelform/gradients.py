"""gradients (H, W, 2): slopes dz/dx and dz/dy in mm/mm, x to the right, y down, z towards the camera."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.checks import check_gradients, check_map, check_mm_per_px, check_normals


def gradients_from_normals(normals: ArrayLike) -> NDArray[np.float32]:
    """Slopes of a surface from its normals: `p = -n_x/n_z`, `q = -n_y/n_z`.

    Parameters
    ----------
    normals : (..., 3), n_z > 0; need not have unit length

    Returns
    -------
    gradients : (..., 2) float32, mm/mm

    Raises
    ------
    ValueError
        A normal that faces away from the camera (n_z <= 0), NaN, or a wrong shape.
    """
    n = check_normals(normals)
    return -n[..., :2] / n[..., 2:]


def gradients_from_depth(depth_mm: ArrayLike, *, mm_per_px: float | Sequence[float]) -> NDArray[np.float32]:
    """Slopes of a depth map: second-order differences, central inside and one-sided on the border.

    Parameters
    ----------
    depth_mm : (..., H, W), at least 2x2
    mm_per_px : float or (x, y), mm

    Returns
    -------
    gradients : (..., H, W, 2) float32, mm/mm
    """
    hx, hy = check_mm_per_px(mm_per_px)
    z = check_map(depth_mm, "depth_mm", dtype=np.float64)
    gradients = np.stack([_slope(z, -1) / hx, _slope(z, -2) / hy], axis=-1)
    return gradients.astype(np.float32)


def curl(gradients: ArrayLike, *, mm_per_px: float | Sequence[float]) -> NDArray[np.float32]:
    """Integrability check `dp/dy - dq/dx` per pixel, in 1/mm: zero where the slopes are those of a surface.

    Parameters
    ----------
    gradients : (..., H, W, 2), mm/mm
    mm_per_px : float or (x, y), mm

    Returns
    -------
    curl : (..., H, W) float32, 1/mm
    """
    hx, hy = check_mm_per_px(mm_per_px)
    g = check_gradients(gradients, dtype=np.float64)
    return (_slope(g[..., 0], -2) / hy - _slope(g[..., 1], -1) / hx).astype(np.float32)


def _slope(values: NDArray[Any], axis: int) -> NDArray[Any]:
    """Second-order difference per pixel along an axis; of lower order where fewer than 3 pixels are left."""
    count = values.shape[axis]
    if count == 1:
        return np.zeros_like(values)
    slope: NDArray[Any] = np.gradient(values, axis=axis, edge_order=2 if count > 2 else 1)
    return slope
