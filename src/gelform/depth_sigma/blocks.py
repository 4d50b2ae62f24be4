"""The integration problem on blocks of several pixels, and the way back: sigma is smooth, probes need no more."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.gradients import fill_unknown
from gelform.solvers.system import FLOOR, problem_from_gradients

_sum_blocks = Kernel(
    "sum_blocks",
    "f32[h,w,slopes] sigma, f32[h,w] weights, bool[h,w] mask, f32[h,w] anchor, bool[h,w] region, f32 floor, i64 block, "
    "out f32[planes,w] work, out f32[planes,rows,columns] sums",
)
_sigma_of_pixels = Kernel(
    "sigma_of_pixels",
    "f32[rows,columns] variance, f32[h,w,slopes] sigma, f32[2] within, f32[4] fading, f32[h,w] weights, f32 floor, "
    "f32[h,w]? anchor, out f32[16,line] work, out f32[h,w] out",
)
# Variance of the probes is averaged over so many blocks (standard deviation).
SMOOTHING_BLOCKS = 0.6
LINES = 16  # scratch of `sigma_of_pixels`

# What is summed over the pixels of a block: those inside the mask, weight and its square, anchor, zero pixels;
# then for each slope weight x sigma and its square.
INSIDE, WEIGHT, SQUARE, HOLD, REGION, FIRST = range(6)
PER_SLOPE = 2


def block_rows_and_columns(shape: tuple[int, ...], block: int) -> tuple[int, int]:
    """How many blocks cover a frame (H, W): an odd number each way, the last of them without pixels if need be.

    Multigrid has coarse pixels on all borders of a frame of odd size, and two cycles are then enough everywhere.
    """
    return -(-shape[0] // block) | 1, -(-shape[1] // block) | 1


class Blocks:
    """The integration problem on blocks of `block` x `block` pixels; those at the far border may be partial.

    Attributes
    ----------
    mask : (h, w) bool; anchored : bool; problem : its couplings; size : pixels across a block
    region : (h, w), pixels that are zero pixels, inside the mask
    white, common : (h, w, 2)
        Standard deviation of the weighted mean slope of a block: of independent errors, and of common ones; `parts`
        are the factors by which that of a pixel is either.
    """

    def __init__(
        self,
        sigma: NDArray[np.float32],
        weights: NDArray[np.float32],
        mask: NDArray[np.bool_],
        anchor: NDArray[np.float32] | None,
        region: NDArray[np.bool_],
        floor: np.float32,
        block: int,
        parts: tuple[NDArray[np.float32], NDArray[np.float32]],
    ) -> None:
        shape = block_rows_and_columns(mask.shape, block)
        slopes = sigma.shape[2]
        sums = np.empty((FIRST + PER_SLOPE * slopes, *shape), dtype=np.float32)
        work = np.empty((len(sums), mask.shape[1]), dtype=np.float32)
        hold = zeros(mask.shape) if anchor is None else anchor
        _sum_blocks(sigma, weights, mask, hold, region, floor, block, work, sums)
        count = sums[INSIDE]
        total = np.maximum(sums[WEIGHT], 1e-30)
        self.size = block
        self.mask = count > 0
        self.anchored = anchor is not None
        weight = sums[WEIGHT] / np.maximum(count, 1)
        no_slope = np.zeros((*shape, 2), dtype=np.float32)
        self.problem = problem_from_gradients(
            no_slope, weight, self.mask, sums[HOLD] if self.anchored else None
        )
        self.region = sums[REGION]
        # Slopes of less weight than the floor are replaced by a fill from their neighbours: they bring no
        # error. Holes make independent errors go round: worse by the unevenness of the weights in the block.
        uneven = np.sqrt(count * sums[SQUARE]) / total
        uneven[uneven == 0] = 1
        by_slope = sums[FIRST:].reshape(slopes, PER_SLOPE, *shape).transpose(1, 2, 3, 0)
        moved, square = np.ascontiguousarray(by_slope)
        self._usual = moved / total[..., None]
        self.white = np.sqrt(square) * (uneven / total)[..., None]
        if slopes == 1:
            self.white, self._usual = (np.repeat(v, 2, axis=-1) for v in (self.white, self._usual))
        self.white *= parts[0]
        self.common = self._usual * parts[1]
        known = (weight >= FLOOR * weight.max()) | ~self.mask
        self._known = None if known.all() else known
        if self._known is not None:
            self.common = fill_unknown(self.common, known)  # as the slopes are

    def share_in_median(self) -> NDArray[np.float32]:
        """How much each slope (h, w, 2) counts in the zero pixels' median: as likely as it is near 0."""
        usual = self._usual if self._known is None else fill_unknown(self._usual, self._known)
        density = self.region[..., None] / np.maximum(usual, 1e-30) * (usual > 0)
        return np.asarray(density / density.sum(axis=(0, 1)), dtype=np.float32)


def less_mean(depths: NDArray[np.float32], pixels: NDArray[np.bool_], block: int) -> NDArray[np.float32]:
    """Depths (h, w, probes) of blocks less the mean of each probe over pixels (H, W)."""
    height, width, probes = depths.shape
    padded = np.zeros((height * block, width * block), dtype=np.float32)
    padded[: pixels.shape[0], : pixels.shape[1]] = pixels
    share = padded.reshape(height, block, width, block).sum(axis=(1, 3)).ravel()
    flat = depths.reshape(-1, probes)
    mean = (share / max(float(share.sum()), 1.0)).astype(np.float32) @ flat
    return np.asarray((flat - mean).reshape(height, width, probes))


def smoothed(variance: NDArray[np.float32], mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Averaged over neighbours inside the mask."""
    blur = (0, 0), SMOOTHING_BLOCKS
    if mask.all():
        return np.asarray(cv2.GaussianBlur(variance, *blur)).reshape(mask.shape)
    inside = cv2.GaussianBlur(mask.astype(np.float32), *blur).reshape(mask.shape)
    smooth = cv2.GaussianBlur(np.where(mask, variance, 0).astype(np.float32), *blur).reshape(mask.shape)
    return np.asarray(smooth / np.maximum(inside, 1e-6), dtype=np.float32)


def sigma_of_pixels(
    variance: NDArray[np.float32],
    sigma: NDArray[np.float32],
    within: NDArray[np.float32],
    fading: NDArray[np.float32],
    weights: NDArray[np.float32],
    floor: np.float32,
    anchor: NDArray[np.float32] | None,
) -> NDArray[np.float32]:
    """Standard deviation of pixels (H, W), with what blocks do not see; less where an anchor holds a pixel.

    Parameters
    ----------
    variance : (H, W) or more, mm^2, of the blocks, resampled to pixels
    sigma : (H, W, 1 or 2), of the slopes
    within : (2,) of p and q: variance within a block for each unit of theirs
        The usual sigma of 3x3 pixels counts, their harmonic mean: one bad pixel among good ones is held by them.
    fading : (4,), how that gets less where an anchor holds: see `fading_within_blocks`
    weights, floor : (H, W); slopes of less weight than the floor are not trusted
    anchor : (H, W)
        What blocks see reaches a pixel that it holds by ties over ties and anchor: of 3x3 pixels, and of its own.
    """
    out = np.empty(weights.shape, dtype=np.float32)
    work = np.empty((LINES, weights.shape[1] + 2), dtype=np.float32)
    _sigma_of_pixels(variance, sigma, within, fading, weights, floor, anchor, work, out)
    return out


@lru_cache(maxsize=16)
def zeros(shape: tuple[int, int]) -> NDArray[Any]:
    """A map of zeros, shared: nobody writes to it."""
    return np.zeros(shape, dtype=np.float32)
