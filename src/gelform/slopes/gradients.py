"""gradients (H, W, 2): slopes dz/dx and dz/dy in mm/mm, x to the right, y down, z toward the camera."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import ArrayLike

from gelform._native import Kernel
from gelform.arrays import Array, Floats, Map, Mask, Slopes
from gelform.foundations.checks import (
    check_choice,
    check_gradients,
    check_map,
    check_mm_per_px,
    check_normals,
    check_values,
    check_within,
)
from gelform.image.view import scale_of

# Signs of normals to gelform's.
CONVENTIONS = {"directx": (1, 1, 1), "opengl": (1, -1, 1), "opencv": (1, 1, -1)}
STEEPEST_GEL = 1.0  # mm/mm, the steepest slope of a gel: where nothing is known, a slope is off by that

_slopes_of_depth = Kernel("slopes_of_depth", "f32[h,w] depth, out f32[h,w,2] gradients, f32 per_x, f32 per_y")
_curl_squares = Kernel("curl_squares", "f32[n,h,w,2] gradients, bool[n,h,w]? known, out f64[2] result")


def gradients_from_normals(normals: ArrayLike, *, convention: str = "directx") -> Slopes:
    """Slopes of a surface from its normals: `p = -n_x/n_z`, `q = -n_y/n_z`.

    Parameters
    ----------
    normals : (..., 3), n_z > 0; need not have unit length
    convention : axes of the normals: "directx" as everywhere in gelform (y down, z toward the camera), "opengl" (y up, z
        toward the camera), or "opencv" (y down, z away from the camera, so n_z < 0)

    Returns
    -------
    gradients : (..., 2) float32, mm/mm

    Raises
    ------
    ValueError
        A normal that faces away from the camera, NaN, a wrong shape, an unknown convention, or a map (H, W, 3) of at least
        16x16 that is a surface only with the other sign of y.
    """
    if check_choice(convention, CONVENTIONS, "a convention") != "directx":
        normals = check_values(normals, "normals", (3,)) * np.array(CONVENTIONS[convention], np.float32)
    n = check_normals(normals)
    gradients: Slopes = -n[..., :2] / n[..., 2:]
    if gradients.ndim < 3 or min(gradients.shape[-3:-1]) < 16:
        return gradients
    # The curl vanishes only with the right sign of y; noise leaves as much with either, steps and noise half at most.
    p, q = np.moveaxis(gradients.astype(np.float64), -1, 0)
    q_x, p_y = np.gradient(q, axis=-1), np.gradient(p, axis=-2)
    here, other = (float(np.sqrt(np.mean(np.square(q_x + sign * p_y)))) for sign in (-1, 1))
    if here > 2 * other and here > 1e-4:
        points, right = ("down", "directx") if convention == "opengl" else ("up", "opengl")
        raise ValueError(
            f"Expected normals of a surface, got ones that turn (RMS curl {here:.2g} per pixel, {other:.2g} with the other "
            f"sign of y). Does y point {points}? Then give convention={right!r}, or change the sign of n_y."
        )
    return gradients


def smoothed_gradients(gradients: ArrayLike, *, texture: float = 0.02) -> Slopes:
    """Slopes with faint detail smoothed away and strong detail kept, for smooth objects and for display.

    Detail `d = g - G3 g` (G3: a Gaussian of 3 px at 240 rows) is multiplied by `k = |b|^2/(|b|^2 + texture^2)`. Here
    `b = G2.5 d` is the part of the detail that neighbors share: noise of single pixels vanishes, an edge stays. Engraved
    detail as faint as the texture is lost with the noise. The result is not exactly the slopes of a surface.

    Parameters
    ----------
    gradients : (H, W, 2), mm/mm
    texture : 1e-6 to 1e6, mm/mm; detail of this size is halved

    Returns
    -------
    gradients : (H, W, 2) float32

    Raises
    ------
    ValueError
        Slopes of several frames or not finite, or a texture out of range.
    """
    slopes = check_gradients(gradients)
    if slopes.ndim != 3:
        raise ValueError(f"Expected gradients of one frame, (H, W, 2), got {slopes.shape}.")
    halved = np.float32(check_within(texture, "texture", 1e-6, 1e6)) ** 2
    scale = scale_of(slopes.shape)
    coarse = _blurred(slopes, 3.0 * scale)
    detail = slopes - coarse
    agreed = np.square(_blurred(detail, 2.5 * scale)).sum(axis=-1, keepdims=True)
    kept: Floats = coarse + agreed / (agreed + halved) * detail
    return kept


def _blurred(slopes: Slopes, sigma_px: float) -> Map:
    blurred = cv2.GaussianBlur(slopes, (0, 0), sigma_px, borderType=cv2.BORDER_REFLECT_101)
    return np.asarray(blurred).reshape(slopes.shape)


def gradients_from_depth(depth_mm: ArrayLike, *, mm_per_px: float | Sequence[float]) -> Slopes:
    """Slopes of a depth map: second-order differences, central inside and one-sided on the border.

    Parameters
    ----------
    depth_mm : (..., H, W), at least 2x2
    mm_per_px : float or (x, y), mm

    Returns
    -------
    gradients : (..., H, W, 2) float32, mm/mm

    Raises
    ------
    ValueError, TypeError
        A depth of another shape or not finite, or a pitch that is not positive.
    """
    hx, hy = check_mm_per_px(mm_per_px)
    z = check_map(depth_mm, "depth_mm", dtype=np.float64)
    gradients = np.stack([_slope(z, -1) / hx, _slope(z, -2) / hy], axis=-1)
    return gradients.astype(np.float32)


def slopes_of_solution(depth: Map, mm_per_px: tuple[float, float]) -> Slopes:
    """`gradients_from_depth` for one solved depth map (H, W) float32, in single precision."""
    gradients = np.empty((*depth.shape, 2), dtype=np.float32)
    _slopes_of_depth(depth, gradients, 1 / mm_per_px[0], 1 / mm_per_px[1])
    return gradients


def curl_from_gradients(gradients: ArrayLike, *, mm_per_px: float | Sequence[float]) -> Slopes:
    """Integrability check `dp/dy - dq/dx` per pixel, in 1/mm: zero where the slopes belong to a surface.

    Parameters
    ----------
    gradients : (..., H, W, 2), mm/mm
    mm_per_px : float or (x, y), mm

    Returns
    -------
    curl : (..., H, W) float32, 1/mm

    Raises
    ------
    ValueError, TypeError
        Slopes of another shape or not finite, or a pitch that is not positive.
    """
    hx, hy = check_mm_per_px(mm_per_px)
    g = check_gradients(gradients, dtype=np.float64)
    return (_slope(g[..., 0], -2) / hy - _slope(g[..., 1], -1) / hx).astype(np.float32)


def curl_rms(gradients: Slopes, known: Mask | None) -> float:
    """RMS of the curl of gradients (N, H, W, 2) over known pixels (N, H, W) inside the border, slope per pixel.

    `known` None means all pixels.
    """
    found = np.empty(2)
    _curl_squares(gradients, known, found)
    return float(np.sqrt(found[0] / found[1])) if found[1] else 0.0


def _slope(values: Array, axis: int) -> Array:
    """Second-order difference per pixel along an axis; of lower order if the axis has fewer than 3 pixels."""
    count = values.shape[axis]
    if count == 1:
        return np.zeros_like(values)
    slope: Array = np.gradient(values, axis=axis, edge_order=2 if count > 2 else 1)
    return slope
