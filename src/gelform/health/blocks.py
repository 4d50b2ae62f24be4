"""A frame in blocks of 16x16 pixels and digests of its rows: what every check of its health looks at."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel

BLOCK_PX = 16

_blocks = Kernel(
    "health_blocks",
    "u8[h,w,3] image, u8[h,w,3] rest, out u8[bh,bw,3] means, out u8[bh,bw] ranges, out i64[h] digests, out f32[h] jumps",
)


@dataclass(frozen=True)
class Blocks:
    """An image (H, W) in h x w whole blocks of 16x16 pixels.

    Attributes
    ----------
    means : (h, w, 3) uint8, grey levels
    ranges : (h, w) uint8
        Largest minus smallest value within a block, of the channel where that is most. Noise alone makes it 3 or more.
    row_digests : (H,) int64
        Rows of equal pixels have equal digests.
    row_jumps : (H,) float32
        How much the difference to the rest image changes from the row above, grey levels: the mean over the row, in which
        a pixel counts at most 16, so that it grows with how wide a seam is.
    """

    means: NDArray[np.uint8]
    ranges: NDArray[np.uint8]
    row_digests: NDArray[np.int64]
    row_jumps: NDArray[np.float32]

    def pixels(self, chosen: NDArray[np.bool_], width: int) -> NDArray[np.bool_]:
        """The pixels (H, W) of chosen blocks (h, w); what is left over at the border goes with the last block."""
        mask = np.zeros((len(self.row_digests), width), dtype=bool)
        if chosen.any():
            rows = np.minimum(np.arange(mask.shape[0]) // BLOCK_PX, chosen.shape[0] - 1)
            columns = np.minimum(np.arange(width) // BLOCK_PX, chosen.shape[1] - 1)
            mask |= chosen[rows[:, None], columns[None, :]]
        return mask

    def centered_in(self, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """The blocks (h, w) whose centres lie in a mask (H, W)."""
        height, width = self.ranges.shape
        return mask[BLOCK_PX // 2 :: BLOCK_PX, BLOCK_PX // 2 :: BLOCK_PX][:height, :width]


def pixels_from_image(image: NDArray[Any]) -> NDArray[np.uint8]:
    """An RGB image (H, W, 3), uint8 or float 0-255, as a camera would have given it."""
    return np.ascontiguousarray(image if image.dtype == np.uint8 else np.rint(image).astype(np.uint8))


def blocks_from_image(image: NDArray[np.uint8], rest: NDArray[np.uint8]) -> Blocks:
    """The blocks of an image (H, W, 3); `rest` is the untouched image."""
    height, width = image.shape[:2]
    shape = height // BLOCK_PX, width // BLOCK_PX
    blocks = Blocks(
        np.empty((*shape, 3), np.uint8),
        np.empty(shape, np.uint8),
        np.empty(height, np.int64),
        np.empty(height, np.float32),
    )
    _blocks(image, rest, blocks.means, blocks.ranges, blocks.row_digests, blocks.row_jumps)
    return blocks
