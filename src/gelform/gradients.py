"""gradients (H, W, 2): slopes dz/dx and dz/dy in mm/mm, x to the right, y down, z towards the camera."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from gelform.checks import (
    check_finite,
    check_gradients,
    check_map,
    check_mask,
    check_mm_per_px,
    check_normals,
)


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


def curl_from_gradients(gradients: ArrayLike, *, mm_per_px: float | Sequence[float]) -> NDArray[np.float32]:
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


def curl_rms(gradients: NDArray[np.float32], known: NDArray[np.bool_]) -> float:
    """RMS of the curl of gradients (N, H, W, 2) over known pixels (N, H, W) off the border, slope per pixel."""
    square, count = _curl_squares(gradients, known)
    return float(np.sqrt(square / count)) if count else 0.0


@njit(cache=True, nogil=True, fastmath=True)
def _curl_squares(g, known):  # type: ignore[no-untyped-def]
    """Sum of squares of `dp/dy - dq/dx` by central differences, and of how many pixels; without a branch."""
    total, count = 0.0, 0
    quarter = np.float32(0.25)
    for n in range(g.shape[0]):
        for i in range(1, g.shape[1] - 1):
            row, seen = np.float32(0), np.int32(0)
            for j in range(1, g.shape[2] - 1):
                counts = np.int32(known[n, i, j])
                turn = g[n, i + 1, j, 0] - g[n, i - 1, j, 0] - g[n, i, j + 1, 1] + g[n, i, j - 1, 1]
                row += np.float32(counts) * turn * turn
                seen += counts
            total += quarter * row
            count += seen
    return total, count


def fill_unknown(values: ArrayLike, known: ArrayLike) -> NDArray[np.float32]:
    """Replace unknown pixels of a map by a smooth surface through their neighbours.

    Unknown pixels come from the next coarser level of a pyramid of averages of known pixels, and are then
    relaxed towards the mean of their four neighbours (a membrane, which carries planes on). Their own values
    have no influence; known pixels come back as they were.

    Parameters
    ----------
    values : (H, W, C), such as gradients
    known : (H, W) bool, at least one True

    Returns
    -------
    filled : (H, W, C) float32
    """
    array = np.asarray(values, dtype=np.float32)
    if array.ndim != 3:
        raise ValueError(f"Expected values of shape (H, W, C), got {array.shape}.")
    where = check_mask(known, shape=array.shape[:2], name="known")
    return _filled(check_finite(array, "values").copy(), where)


# Sweeps of relaxation per level; more change the depth of trial scenes by less than 0.02 um.
SWEEPS = 2


def _filled(values: NDArray[np.float32], known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Fill in place, coarse to fine."""
    if known.all():
        return values
    height, width, channels = values.shape
    coarse = np.zeros(((height + 1) // 2, (width + 1) // 2, channels), dtype=np.float32)
    coarse_known = np.zeros(coarse.shape[:2], dtype=bool)
    _pull(values, known, coarse, coarse_known)
    _push(_filled(coarse, coarse_known), values, known, SWEEPS)
    return values


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[misc]
def _pull(
    values: NDArray[Any], known: NDArray[Any], coarse: NDArray[Any], coarse_known: NDArray[Any]
) -> None:
    """Means of the known among each 2x2 pixels; beyond an odd border the last pixel stands in, unknown."""
    height, width, channels = values.shape
    for i in range(coarse.shape[0]):
        top, low = 2 * i, min(2 * i + 1, height - 1)
        for j in range(coarse.shape[1]):
            left, right = 2 * j, min(2 * j + 1, width - 1)
            a = np.float32(known[top, left])
            b = np.float32(known[top, right] and right > left)
            c = np.float32(known[low, left] and low > top)
            d = np.float32(known[low, right] and low > top and right > left)
            count = a + b + c + d
            if count > 0:
                coarse_known[i, j] = True
                a, b, c, d = a / count, b / count, c / count, d / count
                for k in range(channels):
                    coarse[i, j, k] = (
                        a * values[top, left, k]
                        + b * values[top, right, k]
                        + c * values[low, left, k]
                        + d * values[low, right, k]
                    )


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[misc]
def _push(coarse: NDArray[Any], values: NDArray[Any], known: NDArray[Any], sweeps: int) -> None:
    """Unknown pixels from the coarser level, bilinearly; then relaxed, forwards and backwards in turn."""
    height, width, channels = values.shape
    rows, cols = coarse.shape[0], coarse.shape[1]
    holes = np.empty((height * width, 2), dtype=np.int32)
    count = 0
    for i in range(height):
        near_i = i // 2
        far_i = min(max(near_i + 2 * (i % 2) - 1, 0), rows - 1)
        for j in range(width):
            if known[i, j]:
                continue
            holes[count, 0], holes[count, 1] = i, j
            count += 1
            near_j = j // 2
            far_j = min(max(near_j + 2 * (j % 2) - 1, 0), cols - 1)
            for c in range(channels):
                near = (
                    np.float32(0.75) * coarse[near_i, near_j, c] + np.float32(0.25) * coarse[near_i, far_j, c]
                )
                far = np.float32(0.75) * coarse[far_i, near_j, c] + np.float32(0.25) * coarse[far_i, far_j, c]
                values[i, j, c] = np.float32(0.75) * near + np.float32(0.25) * far
    for sweep in range(sweeps):
        for place in range(count):
            hole = place if sweep % 2 == 0 else count - 1 - place
            i, j = holes[hole, 0], holes[hole, 1]
            for c in range(channels):
                total = np.float32(0)
                neighbours = 0
                if i > 0:
                    total += values[i - 1, j, c]
                    neighbours += 1
                if i < height - 1:
                    total += values[i + 1, j, c]
                    neighbours += 1
                if j > 0:
                    total += values[i, j - 1, c]
                    neighbours += 1
                if j < width - 1:
                    total += values[i, j + 1, c]
                    neighbours += 1
                values[i, j, c] = total / np.float32(neighbours)


def _slope(values: NDArray[Any], axis: int) -> NDArray[Any]:
    """Second-order difference per pixel along an axis; of lower order where fewer than 3 pixels are left."""
    count = values.shape[axis]
    if count == 1:
        return np.zeros_like(values)
    slope: NDArray[Any] = np.gradient(values, axis=axis, edge_order=2 if count > 2 else 1)
    return slope
