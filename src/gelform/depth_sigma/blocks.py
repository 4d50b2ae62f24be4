"""The integration problem on cells of several pixels, and the way back: sigma is smooth, probes need no more."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gelform.gradients import fill_unknown
from gelform.solvers.multigrid.cycle import KERNEL
from gelform.solvers.system import FLOOR, problem_from_gradients

# What is summed over the pixels of a cell: those inside the mask, weight and its square, anchor, zero pixels;
# then per slope weight x sigma and its square.
INSIDE, WEIGHT, SQUARE, HOLD, REGION, FIRST = range(6)
PER_SLOPE = 2


class Cells:
    """The integration problem on cells of `cell` x `cell` pixels; those at the far border may be partial.

    Attributes
    ----------
    mask : (h, w) bool; anchored : bool; problem : its couplings
    region : (h, w), pixels that are zero pixels, inside the mask
    white, common : (h, w, 2)
        Standard deviation of the weighted mean slope of a cell: of independent errors, and of common ones.
    """

    def __init__(
        self,
        sigma: NDArray[np.float32],
        weights: NDArray[np.float32],
        mask: NDArray[np.bool_],
        anchor: NDArray[np.float32] | None,
        region: NDArray[np.bool_],
        floor: np.float32,
        cell: int,
    ) -> None:
        shape = -(-mask.shape[0] // cell), -(-mask.shape[1] // cell)
        slopes = sigma.shape[2]
        sums = np.zeros((FIRST + PER_SLOPE * slopes, *shape), dtype=np.float32)
        hold = zeros(mask.shape) if anchor is None else anchor
        _sum_cells(sigma, weights, mask, hold, region, floor, cell, sums)
        count = sums[INSIDE]
        total = np.maximum(sums[WEIGHT], 1e-30)
        self.mask = count > 0
        self.anchored = anchor is not None
        weight = sums[WEIGHT] / np.maximum(count, 1)
        no_slope = np.zeros((*shape, 2), dtype=np.float32)
        self.problem = problem_from_gradients(
            no_slope, weight, self.mask, sums[HOLD] if self.anchored else None
        )
        self.region = sums[REGION]
        # Slopes of less weight than the floor are replaced by a fill from their neighbours: they bring no
        # error. Holes make independent errors go round: worse by the unevenness of the weights in the cell.
        uneven = np.sqrt(count * sums[SQUARE]) / total
        uneven[uneven == 0] = 1
        moved, square = np.moveaxis(sums[FIRST:].reshape(slopes, PER_SLOPE, *shape), (0, 1), (-1, 0))
        self.common = moved / total[..., None]
        self.white = np.sqrt(square) * (uneven / total)[..., None]
        if slopes == 1:
            self.white, self.common = (np.repeat(v, 2, axis=-1) for v in (self.white, self.common))
        known = weight >= FLOOR * weight.max()
        if not known.all():
            self.common = fill_unknown(self.common, known)  # as the slopes are

    def share_in_median(self) -> NDArray[np.float32]:
        """How much each slope (h, w, 2) counts in the zero pixels' median: as likely as it is near 0."""
        density = self.region[..., None] / np.maximum(self.common, 1e-30) * (self.common > 0)
        return np.asarray(density / density.sum(axis=(0, 1)), dtype=np.float32)


@njit(**KERNEL)  # type: ignore[misc]
def _sum_cells(
    sigma: Any, weights: Any, mask: Any, anchor: Any, region: Any, floor: Any, cell: int, sums: Any
) -> None:
    height, width = weights.shape
    line = np.zeros((sums.shape[0], width), dtype=np.float32)
    for top in range(0, height, cell):
        line[:] = 0
        for i in range(top, min(top + cell, height)):
            for j in range(width):
                inside = np.float32(mask[i, j])
                told = inside if weights[i, j] >= floor else np.float32(0)
                weight = told * weights[i, j]
                line[INSIDE, j] += inside
                line[WEIGHT, j] += weight
                line[SQUARE, j] += weight * weight
                line[HOLD, j] += inside * anchor[i, j]
                line[REGION, j] += inside * np.float32(region[i, j])
            for c in range(sigma.shape[2]):
                plane = FIRST + PER_SLOPE * c
                for j in range(width):
                    told = np.float32(mask[i, j]) if weights[i, j] >= floor else np.float32(0)
                    moved = told * weights[i, j] * sigma[i, j, c]
                    line[plane, j] += moved
                    line[plane + 1, j] += moved * moved
        for plane in range(sums.shape[0]):
            for k in range(sums.shape[2]):
                total = np.float32(0)
                for j in range(k * cell, min(k * cell + cell, width)):
                    total += line[plane, j]
                sums[plane, top // cell, k] = total


@njit(**KERNEL)  # type: ignore[misc]
def sigma_of_pixels(
    variance: Any, sigma: Any, within: Any, weights: Any, floor: Any, anchor: Any, out: Any
) -> None:
    """Standard deviation, with what cells do not see; less where an anchor holds a pixel.

    Within a cell counts the usual sigma of 3x3 pixels, their harmonic mean: one bad pixel among good ones is
    held by them. An anchored pixel follows its neighbours by ties over ties and anchor.
    """
    height, width = out.shape
    one, two, tiny = np.float32(1), np.float32(2), np.float32(1e-30)
    line = np.zeros((6, width + 2), dtype=np.float32)
    up, here, down, certain, count, total = line
    for i in range(height):
        above, below = max(i - 1, 0), min(i + 1, height - 1)
        for j in range(width):
            up[j + 1] = max(weights[above, j], floor)
            here[j + 1] = max(weights[i, j], floor)
            down[j + 1] = max(weights[below, j], floor)
            total[j] = variance[i, j]
        here[0], here[width + 1] = here[1], here[width]
        for slope in range(sigma.shape[2]):
            share = within[slope] if sigma.shape[2] == 2 else within[0] + within[1]
            certain[:] = 0
            count[:] = 0
            for k in range(above, below + 1):
                for j in range(width):
                    told = one if weights[k, j] >= floor else np.float32(0)
                    certain[j + 1] += told / sigma[k, j, slope]
                    count[j + 1] += told
            for j in range(width):
                usual = (count[j] + count[j + 1] + count[j + 2]) / (
                    certain[j] + certain[j + 1] + certain[j + 2] + tiny
                )
                total[j] += share * usual * usual
        for j in range(width):
            a, b, c, d, e = here[j], here[j + 2], up[j + 1], down[j + 1], here[j + 1]
            ties = two * e * (a / (e + a) + b / (e + b) + c / (e + c) + d / (e + d))
            out[i, j] = np.sqrt(total[j]) * ties / (ties + anchor[i, j])


@lru_cache(maxsize=16)
def zeros(shape: tuple[int, int]) -> NDArray[Any]:
    """A map of zeros, shared: nobody writes to it."""
    return np.zeros(shape, dtype=np.float32)
