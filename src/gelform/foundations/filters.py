"""Filters of maps for several rooms: medians over selected pixels, logarithms, weights of Gaussian blurs."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel

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


def medians_where(
    values: NDArray[np.float32], chosen: NDArray[np.bool_] | None = None, step: int = 1
) -> tuple[NDArray[np.float32], int]:
    """Median (C,) of each channel of a map (H, W, C) over selected pixels of every `step`-th row and column; their number.

    The map is float32, in C order and without NaN. All pixels are selected by default; without any, medians are 0.
    """
    height, width, channels = values.shape
    medians = np.empty(channels, dtype=np.float32)
    work = np.empty(2 * -(-height // step) * -(-width // step), dtype=np.float32)
    return medians, _medians_where(values, chosen, step, work, medians)


def robust_sigma(off: NDArray[Any], axis: Any = None) -> Any:
    """Standard deviation of noise about 0, from the median magnitude: robust to outliers."""
    return SIGMA_OF_MEDIAN * np.median(np.abs(off), axis=axis)


def lattice_step(pixels: int) -> int:
    """The step between sampled rows and columns that leaves about `MEDIAN_SAMPLES` of a number of pixels."""
    return max(1, round((pixels / MEDIAN_SAMPLES) ** 0.5))


def log_levels(image: NDArray[Any]) -> NDArray[np.float32]:
    """Logarithm (H, W) of the mean of an image's channels (H, W, 3), `CHANGE_OFFSET` above 0."""
    third = np.full((1, 3), 1 / 3, dtype=np.float32)
    mean = cv2.transform(np.asarray(image, dtype=np.float32), third)
    return np.asarray(cv2.log(np.maximum(mean, 0) + np.float32(CHANGE_OFFSET)))


@lru_cache(maxsize=16)
def blur_taps(blur_px: float) -> NDArray[np.float32]:
    """Weights of a Gaussian blur from the middle outward, to 4 standard deviations as in OpenCV; read-only."""
    if blur_px == 0:
        return np.ones(1, dtype=np.float32)
    size = int(np.rint(8 * blur_px + 1)) | 1
    taps: NDArray[np.float32] = cv2.getGaussianKernel(size, blur_px, cv2.CV_32F)[size // 2 :, 0]
    return np.ascontiguousarray(taps)
