"""The integration problem on blocks of several pixels, and the way back to pixels: sigma is smooth enough for it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.depth.sigma.closed_form import white_as_blurred
from gelform.depth.solvers.system import FLOOR, constant_map, problem_from_gradients
from gelform.foundations.fill import fill_unknown
from gelform.foundations.filters import blur_taps

LEAST_DEVIATION = 1e-6  # smallest deviation fraction within a block; the kernel divides by it


@dataclass(frozen=True)
class ErrorParts:
    """Parts of the variance of slope errors.

    In a contact a fraction of it is correlated over a long distance (a color model's bias) and the rest is white. At rest
    the color model has no error, only the images' noise, blurred as the color change is. Over a block of pixels such
    short correlations equal independent errors of more variance.

    Attributes
    ----------
    block : pixels across a block
    fraction : correlated fraction in a contact, 0-1
    rest_fraction : fraction at rest that is correlated as in a contact, 0-1
    rest_px : distance over which the other part falls to exp(-1/2) at rest; 0: it is white
    aspect : pitch along x over that along y
    """

    block: int
    fraction: float
    rest_fraction: float
    rest_px: float
    aspect: float = 1.0

    @property
    def of_blocks(self) -> tuple[float, float, float]:
        """Shares of the variance that are correlated, in contact and at rest; power of the others at rest."""
        power = white_as_blurred(self.aspect, self.block, self.rest_px)[0]
        return self.fraction, self.rest_fraction, power

    @cached_property
    def within_blocks(self) -> NDArray[np.float32]:
        """Fraction (2,), in contact and at rest, of the deviation that moves depth as far within a block if white."""
        within = white_as_blurred(self.aspect, self.block, self.rest_px)[1]
        contact, rest = np.sqrt(1 - self.fraction), np.sqrt((1 - self.rest_fraction) * within)
        return np.maximum([contact, rest], LEAST_DEVIATION, dtype=np.float32)


_sum_blocks = Kernel(
    "sum_blocks",
    "f32[h,w,slopes] sigma, f32[h,w] weights, bool[h,w]? mask, f32[h,w] anchor, bool[h,w]? region, bool[h,w]? at_rest, "
    "f32 floor, i64 block, out f32[planes,w] work, out f32[planes,rows,columns] sums",
)
_errors_of_blocks = Kernel(
    "errors_of_blocks",
    "f32[planes,rows,columns] sums, out f32[rows,columns] weight, out f32[rows,columns,2] white, "
    "out f32[rows,columns,2] common, out f32[rows,columns,2] usual, i64 block, f32 share, f32 rest_share, f32 power, "
    "i64 h, i64 w",
)
_variance_of_depths = Kernel(
    "variance_of_depths",
    "f32[h,w,n] depths, bool[h,w] mask, f32[t] taps, out f32[m] work, out f32[h,w] variance",
)
_sigma_of_pixels = Kernel(
    "sigma_of_pixels",
    "f32[rows,columns] variance, f32[h,w,slopes] sigma, bool[h,w]? at_rest, f32[2] white, f32[2] within, f32[4] fading, "
    "f32[h,w] weights, f32 floor, f32[h,w]? anchor, i64 block, out f32[22,line] work, out f32[h,w] out",
)
# Blocks, standard deviation of the Gaussian that averages the probes' variance, because 32 probes are few.
SMOOTHING_BLOCKS = 0.6
LINES = 22  # rows of scratch memory of `sigma_of_pixels`

# Sums over the pixels of a block: pixels inside the mask, weight and its square, anchor, zero pixels, pixels at rest; then
# weight x sigma and its square for each slope.
INSIDE, WEIGHT, SQUARE, HOLD, REGION, REST, FIRST = range(7)


def block_rows_and_columns(shape: tuple[int, ...], block: int) -> tuple[int, int]:
    """Number of blocks that cover a frame (H, W): odd in each direction; the last ones may have no pixels.

    On a frame of odd size multigrid has coarse pixels on all borders, and two cycles are then enough everywhere.
    """
    return -(-shape[0] // block) | 1, -(-shape[1] // block) | 1


class Blocks:
    """The integration problem on blocks of `block` x `block` pixels; those at the far border may be partial.

    Attributes
    ----------
    mask : (h, w) bool; anchored : bool; problem : its couplings; size : pixels across a block
    region : (h, w), number of zero pixels inside the mask
    white, common : (h, w, 2)
        Standard deviation of the weighted mean slope of a block: of independent errors, and of common ones.
    """

    def __init__(
        self,
        sigma: NDArray[np.float32],
        weights: NDArray[np.float32],
        mask: NDArray[np.bool_] | None,
        anchor: NDArray[np.float32] | None,
        region: NDArray[np.bool_] | None,
        at_rest: NDArray[np.bool_] | None,
        floor: np.float32,
        parts: ErrorParts,
    ) -> None:
        block = self.size = parts.block
        pixels = weights.shape
        shape = block_rows_and_columns(pixels, block)
        sums = np.empty((FIRST + 2 * sigma.shape[2], *shape), dtype=np.float32)
        work = np.empty((len(sums), pixels[1]), dtype=np.float32)
        hold = constant_map(pixels, 0.0) if anchor is None else anchor
        _sum_blocks(
            sigma, weights, mask, hold, region, at_rest, floor=floor, block=block, work=work, sums=sums
        )
        weight = np.empty(shape, dtype=np.float32)
        self.white, self.common, self._usual = np.empty((3, *shape, 2), dtype=np.float32)
        share, rest_share, power = parts.of_blocks
        _errors_of_blocks(
            sums, weight, white=self.white, common=self.common, usual=self._usual, block=block, share=share,
            rest_share=rest_share, power=power, h=pixels[0], w=pixels[1],
        )  # fmt: skip
        self.mask = sums[INSIDE] > 0
        self.anchored = anchor is not None
        self.problem = problem_from_gradients(
            constant_map((*shape, 2), 0.0), weight, self.mask, sums[HOLD] if self.anchored else None
        )
        self.region = sums[REGION]
        # Slopes below the floor are replaced by a fill from their neighbors; they add no error.
        known = (weight >= FLOOR * weight.max()) | ~self.mask
        self._known = None if known.all() else known
        if self._known is not None:
            self.common = fill_unknown(self.common, known)  # filled like the slopes

    def share_in_median(self) -> NDArray[np.float32]:
        """Weight of each slope (h, w, 2) in the median over the zero pixels: its probability density near 0."""
        usual = self._usual if self._known is None else fill_unknown(self._usual, self._known)
        density = self.region[..., None] / np.maximum(usual, 1e-30) * (usual > 0)
        return np.asarray(density / density.sum(axis=(0, 1)), dtype=np.float32)


def less_mean(depths: NDArray[np.float32], pixels: NDArray[np.bool_], block: int) -> NDArray[np.float32]:
    """Depths (h, w, probes) of blocks minus the mean of each probe over pixels (H, W)."""
    height, width, probes = depths.shape
    padded = np.zeros((height * block, width * block), dtype=np.float32)
    padded[: pixels.shape[0], : pixels.shape[1]] = pixels
    fraction = padded.reshape(height, block, width, block).sum(axis=(1, 3)).ravel()
    flat = depths.reshape(-1, probes)
    mean = (fraction / max(float(fraction.sum()), 1.0)).astype(np.float32) @ flat
    return np.asarray((flat - mean).reshape(height, width, probes))


def variance_of_depths(depths: NDArray[np.float32], mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Mean square (h, w) over the probes of depths (h, w, probes), averaged over neighbors inside the mask."""
    taps = blur_taps(SMOOTHING_BLOCKS)
    work = np.empty(2 * (mask.size + mask.shape[1] + taps.size), dtype=np.float32)
    variance = np.empty(mask.shape, dtype=np.float32)
    _variance_of_depths(depths, mask, taps, work, variance)
    return variance


def sigma_of_pixels(
    variance: NDArray[np.float32],
    sigma: NDArray[np.float32],
    at_rest: NDArray[np.bool_] | None,
    white: NDArray[np.float32],
    within: NDArray[np.float32],
    fading: NDArray[np.float32],
    weights: NDArray[np.float32],
    floor: np.float32,
    anchor: NDArray[np.float32] | None,
    block: int,
) -> NDArray[np.float32]:
    """Standard deviation of pixels (H, W), including the part within blocks; smaller where an anchor holds a pixel.

    Parameters
    ----------
    variance : (h, w), mm^2, of the blocks, of `block` x `block` pixels; bilinear between their centers
    sigma : (H, W, 1 or 2), of the slopes
    at_rest, white : (H, W) and (2,), the fraction of sigma that is white within a block: in contact, and at rest
    within : (2,) of p and q: variance within a block for each unit of their variance
        It uses the usual sigma of 3x3 pixels, their harmonic mean: good pixels around a bad one hold it.
    fading : (4,), decrease of that where an anchor holds: see `fading_within_blocks`
    weights, floor : (H, W); slopes of less weight than the floor are not trusted
    anchor : (H, W)
        The variance of blocks is multiplied by ties over ties plus anchor: of 3x3 pixels, and of the pixel itself.
    """
    out = np.empty(weights.shape, dtype=np.float32)
    work = np.empty((LINES, weights.shape[1] + 2), dtype=np.float32)
    _sigma_of_pixels(
        variance, sigma, at_rest, white=white, within=within, fading=fading, weights=weights, floor=floor, anchor=anchor,
        block=block, work=work, out=out,
    )  # fmt: skip
    return out
