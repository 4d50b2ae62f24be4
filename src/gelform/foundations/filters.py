"""Filters of maps for several rooms: medians, logarithms, weights of Gaussian blurs, and unknown pixels filled."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike

from gelform._native import Kernel
from gelform.arrays import Array, Floats, Map, Mask, Numbers
from gelform.foundations.checks import check_mask, check_values

# gray levels, added to the divisor of a color change and in logarithms, so that noise of dark pixels is no color
CHANGE_OFFSET = 10.0
SIGMA_OF_MEDIAN = 1.4826  # standard deviation of normal noise over its median magnitude
MEDIAN_SAMPLES = 5_000  # pixels on a lattice, fine enough for medians and fractions
MIN_UNTOUCHED = 0.02  # fraction of the frame; the median slope of fewer pixels is noise
LANES = 16  # floats, as in native/common.h; the length of a row of a work array is a multiple
_medians_where = Kernel(
    "medians_where",
    "f32[h,w,c] values, bool[h,w]? chosen, i64 step, out f32[n] work, out f32[c] medians",
)


def medians_where(values: Map, chosen: Mask | None = None, step: int = 1) -> tuple[Map, int]:
    """Median (C,) of each channel of a map (H, W, C) over selected pixels of every `step`-th row and column; their number.

    The map is float32, in C order and without NaN. All pixels are selected by default; without any, medians are 0.
    """
    height, width, channels = values.shape
    medians = np.empty(channels, dtype=np.float32)
    work = np.empty(2 * -(-height // step) * -(-width // step), dtype=np.float32)
    return medians, _medians_where(values, chosen, step, work, medians)


def robust_sigma(off: Array, axis: Any = None) -> Any:
    """Standard deviation of noise about 0, from the median magnitude: robust to outliers."""
    return SIGMA_OF_MEDIAN * np.median(np.abs(off), axis=axis)


def lattice_step(pixels: int) -> int:
    """The step between sampled rows and columns that leaves about `MEDIAN_SAMPLES` of a number of pixels."""
    return max(1, round((pixels / MEDIAN_SAMPLES) ** 0.5))


def log_levels(image: Array) -> Map:
    """Logarithm (H, W) of the mean of an image's channels (H, W, 3), `CHANGE_OFFSET` above 0."""
    third = np.full((1, 3), 1 / 3, dtype=np.float32)
    mean = cv2.transform(np.asarray(image, dtype=np.float32), third)
    return np.asarray(cv2.log(np.maximum(mean, 0) + np.float32(CHANGE_OFFSET)))


@lru_cache(maxsize=16)
def blur_taps(blur_px: float) -> Floats:
    """Weights of a Gaussian blur from the middle outward, to 4 standard deviations as in OpenCV; read-only."""
    if blur_px == 0:
        return np.ones(1, dtype=np.float32)
    size = int(np.rint(8 * blur_px + 1)) | 1
    taps: Floats = cv2.getGaussianKernel(size, blur_px, cv2.CV_32F)[size // 2 :, 0]
    return np.ascontiguousarray(taps)


_coarser_known = Kernel(
    "coarser_known",
    "f32[h,w,c] values, bool[h,w] known, out f32[n] work, out f32[rows,columns,c] coarse, "
    "out bool[rows,columns] coarse_known",
)
_fill_from_coarser = Kernel(
    "fill_from_coarser",
    "f32[rows,columns,c] coarse, out f32[h,w,c] values, out f32[h,w,c] work, out i32[h,w,of_run] runs, bool[h,w] known, "
    "i32 pairs",
)
# Pairs of sweeps of relaxation on the finest level; each coarser one has twice as many. Holes in maps of eight sizes are
# filled with half the error of two pairs.
SWEEP_PAIRS = 4


def fill_unknown(values: ArrayLike, known: ArrayLike) -> Map:
    """Replace unknown pixels of a map (H, W, C), such as gradients, by a smooth surface through their neighbors.

    Unknown pixels start from the next coarser level of a pyramid of averages of known pixels. They are then
    relaxed toward the mean of their four neighbors (a membrane, which continues planes). Their own values
    have no influence; known pixels (H, W) stay unchanged. The fill of a flipped map is the flipped fill, but for rounding.

    ValueError, TypeError: values of another shape or not finite, or a mask that is not boolean or has no known pixel.
    """
    array = check_values(values, "values")
    if array.ndim != 3:
        raise ValueError(f"Expected values of shape (H, W, C), got {array.shape}.")
    where = check_mask(known, shape=array.shape[:2], name="known")
    return _filled(array.copy(), where, SWEEP_PAIRS)


def _filled(values: Map, known: Mask, pairs: int) -> Map:
    """Fill in place, coarse to fine."""
    if known.all():
        return values
    height, width, channels = values.shape
    coarse = np.empty(((height + 1) // 2, (width + 1) // 2, channels), dtype=np.float32)
    coarse_known = np.empty(coarse.shape[:2], dtype=bool)
    _coarser_known(values, known, np.empty((channels + 1) * width, np.float32), coarse, coarse_known)
    _filled(coarse, coarse_known, 2 * pairs)
    runs = np.empty((height, width, 3), dtype=np.int32)
    _fill_from_coarser(coarse, values, np.empty_like(values), runs, known, pairs)
    return values


NODES = 64  # of the trapezoidal rule; half as many leave errors of 1e-7


def bessel_k(order: int, x: Numbers) -> Numbers:
    """The modified Bessel function K0 or K1, to 1e-9 for x from 1e-4 to 15.

    It is the integral of exp(-x cosh t) cosh(order t) from 0 on by the trapezoidal rule, which converges geometrically here
    (Trefethen and Weideman, SIAM Review 2014).
    """
    nodes, step = np.linspace(0, np.arccosh(1 + 40 / np.min(x)), NODES, endpoint=False, retstep=True)
    total = np.exp(-x) / 2
    for node in nodes[1:]:
        total += np.exp(-x * np.cosh(node)) * np.cosh(order * node)
    return np.asarray(step * total)
