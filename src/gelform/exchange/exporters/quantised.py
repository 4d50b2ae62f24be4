"""Depth in 16 bits: depth_mm = (v - 32768) x 1e-4, or 0 where unknown."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.errors import DataError
from gelform.foundations.checks import check_values

ZERO_LEVEL, MM_PER_LEVEL, UNKNOWN = 32768, 1e-4, 0  # 16-bit levels: 0.1 um per step, +-3.3 mm


def levels_from_depth(depth_mm: ArrayLike, known: ArrayLike | None = None) -> NDArray[np.uint16]:
    """16-bit levels (H, W) of a depth map in mm, rounded to 0.1 um.

    Parameters
    ----------
    depth_mm : (H, W), -3.2767 to 3.2767 mm where known
    known : (H, W) bool; False becomes level 0

    Raises
    ------
    DataError
        Depth is out of range; nothing is clipped.
    ValueError, TypeError
        Depth is no finite (H, W) array of numbers, or `known` has another shape.
    """
    exact = np.float32 if getattr(depth_mm, "dtype", None) == np.float32 else np.float64
    depth = check_values(depth_mm, "depth_mm", (), exact)
    mask = np.ones(depth.shape, dtype=bool) if known is None else np.asarray(known)
    if mask.dtype != np.bool_ or mask.shape != depth.shape:
        raise ValueError(f"Expected known as bool of shape {depth.shape}, got {mask.dtype} of {mask.shape}.")
    hidden = None if mask.all() else ~mask
    levels = np.divide(depth, MM_PER_LEVEL, dtype=np.float64)
    np.rint(levels, out=levels)
    levels += ZERO_LEVEL
    if hidden is not None:
        levels[hidden] = ZERO_LEVEL
    if levels.min() < UNKNOWN + 1 or levels.max() > np.iinfo(np.uint16).max:
        raise DataError(
            f"Expected depth from -3.2767 to 3.2767 mm, which 16 bits hold at 0.1 um, got {depth.min():.3f} to "
            f"{depth.max():.3f} mm. Write npz or tiff."
        )
    if hidden is not None:
        levels[hidden] = UNKNOWN
    return levels.astype(np.uint16)


def depth_from_levels(levels: NDArray[Any]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Depth (H, W) float32, mm, 0 where unknown, and the map of known pixels, from 16-bit levels.

    TypeError: the levels are not uint16.
    """
    if getattr(levels, "dtype", None) != np.uint16:
        raise TypeError(f"Expected levels as uint16, got {getattr(levels, 'dtype', type(levels).__name__)}.")
    known = levels != UNKNOWN
    depth = (levels.astype(np.float64) - ZERO_LEVEL) * MM_PER_LEVEL
    return np.where(known, depth, 0).astype(np.float32), known
