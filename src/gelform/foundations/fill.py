"""Unknown pixels of a map, replaced by a smooth surface through the known ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform._native import Kernel
from gelform.foundations.checks import check_mask, check_values

_coarser_known = Kernel(
    "coarser_known",
    "f32[h,w,c] values, bool[h,w] known, out f32[rows,columns,c] coarse, out bool[rows,columns] coarse_known",
)
_fill_from_coarser = Kernel(
    "fill_from_coarser",
    "f32[rows,columns,c] coarse, out f32[h,w,c] values, out f32[h,w,c] work, out i32[h,w,of_run] runs, bool[h,w] known, "
    "i32 pairs",
)
# Pairs of sweeps of relaxation on the finest level; each coarser one has twice as many. Holes in maps of eight sizes are
# filled with half the error of two pairs.
SWEEP_PAIRS = 4


def fill_unknown(values: ArrayLike, known: ArrayLike) -> NDArray[np.float32]:
    """Replace unknown pixels of a map by a smooth surface through their neighbors.

    Unknown pixels start from the next coarser level of a pyramid of averages of known pixels. They are then
    relaxed toward the mean of their four neighbors (a membrane, which continues planes). Their own values
    have no influence; known pixels stay unchanged. The fill of a flipped map is the flipped fill, but for rounding.

    Parameters
    ----------
    values : (H, W, C), such as gradients
    known : (H, W) bool, at least one True

    Returns
    -------
    filled : (H, W, C) float32

    Raises
    ------
    ValueError, TypeError
        Values of another shape or not finite, or a mask that is not boolean or has no known pixel.
    """
    array = check_values(values, "values")
    if array.ndim != 3:
        raise ValueError(f"Expected values of shape (H, W, C), got {array.shape}.")
    where = check_mask(known, shape=array.shape[:2], name="known")
    return _filled(array.copy(), where, SWEEP_PAIRS)


def _filled(values: NDArray[np.float32], known: NDArray[np.bool_], pairs: int) -> NDArray[np.float32]:
    """Fill in place, coarse to fine."""
    if known.all():
        return values
    height, width, channels = values.shape
    coarse = np.empty(((height + 1) // 2, (width + 1) // 2, channels), dtype=np.float32)
    coarse_known = np.empty(coarse.shape[:2], dtype=bool)
    _coarser_known(values, known, coarse, coarse_known)
    _filled(coarse, coarse_known, 2 * pairs)
    runs = np.empty((height, width, 3), dtype=np.int32)
    _fill_from_coarser(coarse, values, np.empty_like(values), runs, known, pairs)
    return values
