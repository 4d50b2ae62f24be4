"""Compression: noise beyond that of the calibrated images, of a camera's gain or of JPEG frames at low quality."""

from __future__ import annotations

from math import sqrt

import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel

BLOCK_PX = 8  # of JPEG
LEAST_BLOCKS = 4  # across a frame
EVERY = 4  # rows are looked at
USUALLY = 1.5  # times the calibrated images' noise is usual: presses are no flat fields
LEAST_LEVELS = 1.0  # less is as good as none
FROM_JUMP = 0.8862  # sigma of a normal distribution over the mean of |a - b| of two of its values
EXCESS = 1.15  # times the usual jump, that jumps between blocks have to be
_column_jumps = Kernel(
    "column_jumps", "u8[h,w,3] image, u8[h,w,3] rest, out i32[n] work, out f32[8] medians, i32 step"
)


def added_levels(pixels: NDArray[np.uint8], rest: NDArray[np.uint8], usual_levels: float) -> float:
    """Noise of an image (H, W, 3) beyond the usual, grey levels: of single pixels, and of JPEG's blocks.

    Blocks of 8x8 pixels that were rounded apart from each other jump where they meet: such columns come every 8 pixels,
    at a place that depends on the crop. Their jumps' excess over the other columns' is twice the blocks' variance.

    Parameters
    ----------
    pixels, rest : (H, W, 3), the image and the untouched one
    usual_levels : standard deviation of a pixel of the calibrated images against the untouched one; more than that
        is counted, and nothing where it is infinite
    """
    width = pixels.shape[1]
    if (width - 1) // BLOCK_PX < LEAST_BLOCKS:
        return 0.0
    medians = np.empty(BLOCK_PX, dtype=np.float32)
    _column_jumps(pixels, rest, np.empty(4 * width, dtype=np.int32), medians, EVERY)
    by_place = sorted(medians.tolist())
    usual, most = (by_place[BLOCK_PX // 2 - 1] + by_place[BLOCK_PX // 2]) / 2, by_place[-1]
    single = FROM_JUMP * usual
    blocks = FROM_JUMP * sqrt(max(most**2 - usual**2, 0.0)) if most > EXCESS * usual else 0.0
    added = sqrt(max(single**2 - (USUALLY * usual_levels) ** 2, 0.0) + blocks**2)
    return added if added > LEAST_LEVELS else 0.0
