"""How well depth is known: one standard deviation per pixel against the zero reference.

Slope errors have a white part, which integration averages out, and a part that is correlated over some pixels
(a color model's bias), which it does not: at equal size the second moves depth far more.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from gelform.checks import check_map, check_mask, check_mm_per_px
from gelform.depth import Level, Zero, checked_anchor, fitted_surface, zero_region
from gelform.gradients import fill
from gelform.solvers.cycle import KERNEL
from gelform.solvers.modes import correlation_of_cells, variance_of_white, variance_within_cells
from gelform.solvers.probes import ProbeSolver, correlated_draws, white_draws
from gelform.solvers.system import FLOOR, problem_from_gradients

# Probes are solved on cells (sigma is smooth): about so many of them, of so many pixels across.
CELLS = 2300
CELL_PX = 2, 6
# Variance of the probes is averaged over so many cells (standard deviation).
SMOOTHING_CELLS = 0.6


class DepthSigma:
    """One standard deviation of the depth, frame by frame: what does not depend on the frame is prepared once.

    Immutable; a pure function of its arguments, and safe to share between threads.

    Parameters
    ----------
    shape : (H, W)
    mm_per_px : float or (x, y), mm
    correlation_px : float, >= 0
        Distance over which the correlated part of the slope errors falls to exp(-1/2) (a Gaussian); 0: all of
        the error is white.
    correlated_share : float, 0-1
        Share of the variance that is correlated, if `correlation_px` > 0.
    probes : int, >= 2
        Fields of random slope errors that are integrated; the relative error of the result is about
        0.4/sqrt(probes), and the cost in proportion.
    rng : numpy Generator
        Draws the probes; a fixed seed if None, so that the same arguments give the same map.

    Raises
    ------
    ValueError
        A setting out of range.
    """

    def __init__(
        self,
        shape: tuple[int, int],
        *,
        mm_per_px: float | Sequence[float],
        correlation_px: float = 0.0,
        correlated_share: float = 0.5,
        probes: int = 32,
        rng: np.random.Generator | None = None,
    ) -> None:
        self.shape = shape
        self.pitch = check_mm_per_px(mm_per_px)
        self.share = _checked_share(correlation_px, correlated_share)
        if probes < 2:
            raise ValueError(f"Expected probes >= 2, got {probes}.")
        cell = self.cell = int(np.clip(round((shape[0] * shape[1] / CELLS) ** 0.5), *CELL_PX))
        cells = -(-shape[0] // cell), -(-shape[1] // cell)
        rng = rng or np.random.default_rng(0)
        white = np.float32(np.sqrt(1 - self.share)) * white_draws(probes, cells, rng)
        common = np.zeros_like(white)
        if self.share > 0:
            length, power = correlation_of_cells(correlation_px, cell)
            common = np.float32(np.sqrt(self.share * power)) * correlated_draws(probes, cells, length, rng)
        self._solver = ProbeSolver(white, common, (self.pitch[0] * cell, self.pitch[1] * cell))
        aspect, area = self.pitch[0] / self.pitch[1], self.pitch[0] * self.pitch[1]
        per_slope = variance_within_cells(aspect, cell)
        self._within = np.array(per_slope, dtype=np.float32) * np.float32(area * (1 - self.share))

    def __call__(
        self,
        gradients_sigma: ArrayLike,
        *,
        weights: ArrayLike | None = None,
        mask: ArrayLike | None = None,
        anchor: ArrayLike | None = None,
        zero: Zero | NDArray[np.bool_] = "mean",
        level: Level | None = None,
    ) -> NDArray[np.float32]:
        """Standard deviation of depth, (H, W) float32, mm, of one frame.

        Parameters
        ----------
        gradients_sigma : (H, W, 2), or (H, W) for both slopes alike; mm/mm, > 0
        weights, mask, anchor, zero, level
            As for `depth_from_gradients`; weights per pixel.
        """
        shape = self.shape
        sigma = _checked_sigma(gradients_sigma, shape)
        weight = _ones(shape) if weights is None else _checked_weights(weights, shape)
        inside = _ones(shape, bool) if mask is None else check_mask(mask, shape=shape)
        hold = None if anchor is None else checked_anchor(anchor, shape)
        region = zero_region(zero, shape)
        floor = np.float32(FLOOR) * weight.max()
        cells = _Cells(sigma, weight, inside, hold, region, floor, self.cell)
        median = cells.share_in_median() if level == "slope" else None
        depths = self._solver(cells.white, cells.common, cells.problem, median)
        variance = _smoothed(_variance(depths, cells, level), cells.mask)
        return self._of_pixels(variance, sigma, weight * inside, floor, hold)

    def _of_pixels(
        self,
        variance: NDArray[np.float32],
        sigma: NDArray[np.float32],
        weight: NDArray[np.float32],
        floor: np.float32,
        anchor: NDArray[np.float32] | None,
    ) -> NDArray[np.float32]:
        """Standard deviation of pixels from the variance of cells."""
        size = variance.shape[1] * self.cell, variance.shape[0] * self.cell
        pixels = cv2.resize(variance, size).reshape(size[1], size[0])
        out = np.empty(self.shape, dtype=np.float32)
        hold = _zeros(self.shape) if anchor is None else anchor
        _finish(pixels, sigma, self._within, weight, floor, hold, out)
        return out


def depth_sigma(
    gradients_sigma: ArrayLike,
    *,
    mm_per_px: float | Sequence[float],
    weights: ArrayLike | None = None,
    mask: ArrayLike | None = None,
    anchor: ArrayLike | None = None,
    zero: Zero | NDArray[np.bool_] = "mean",
    level: Level | None = None,
    correlation_px: float = 0.0,
    correlated_share: float = 0.5,
    probes: int = 32,
    rng: np.random.Generator | None = None,
) -> NDArray[np.float32]:
    """One standard deviation of the depth that `depth_from_gradients` gives with the same arguments.

    For many frames of one shape prepare a `DepthSigma`, which takes these arguments in two parts.

    Parameters
    ----------
    gradients_sigma : (H, W, 2), mm/mm, > 0
        Standard deviation of the slopes, all causes included.
    mm_per_px, weights, mask, anchor, zero, level
        As for `depth_from_gradients`; weights per pixel.
    correlation_px, correlated_share, probes, rng
        As for `DepthSigma`.

    Returns
    -------
    depth_sigma_mm : (H, W) float32, mm; without the uncertainty of the scale. Outside the mask: of the
        pixels it was filled from.

    Notes
    -----
    Uniform slope errors without weights, mask, anchor and correlation have a closed form in cosine modes; the
    rest is Monte Carlo on a grid of cells of up to 6 pixels; what that grid cannot see is added from the
    closed form.
    """
    pitch = check_mm_per_px(mm_per_px)
    sigma = _checked_sigma(gradients_sigma)
    shape = sigma.shape[0], sigma.shape[1]
    uniform = weights is None and mask is None and anchor is None and level is None
    constant = bool(np.all(sigma == sigma[0, 0]))
    if uniform and constant and correlation_px == 0 and isinstance(zero, str) and zero == "mean":
        per_x, per_y = variance_of_white(shape, pitch)
        return np.sqrt(sigma[0, 0, 0] ** 2 * per_x + sigma[0, 0, -1] ** 2 * per_y).astype(np.float32)
    settings = shape, pitch, float(correlation_px), float(correlated_share), probes
    prepared = _prepared(*settings) if rng is None else _prepared.__wrapped__(*settings, rng)
    return prepared(sigma, weights=weights, mask=mask, anchor=anchor, zero=zero, level=level)


@lru_cache(maxsize=4)
def _prepared(
    shape: tuple[int, int],
    pitch: tuple[float, float],
    correlation_px: float,
    correlated_share: float,
    probes: int,
    rng: np.random.Generator | None = None,
) -> DepthSigma:
    return DepthSigma(
        shape,
        mm_per_px=pitch,
        correlation_px=correlation_px,
        correlated_share=correlated_share,
        probes=probes,
        rng=rng,
    )


def _checked_sigma(gradients_sigma: ArrayLike, shape: tuple[int, int] | None = None) -> NDArray[np.float32]:
    """Standard deviations (H, W, 1 or 2)."""
    sigma = np.asarray(gradients_sigma)
    size = sigma.shape[:2]
    alike = shape is not None and sigma.shape == tuple(shape)
    if not alike and (sigma.ndim != 3 or sigma.shape[2] != 2 or shape not in (None, size)):
        wanted = "(H, W, 2)" if shape is None else f"({shape[0]}, {shape[1]}, 2)"
        raise ValueError(f"Expected gradients_sigma of shape {wanted}, got {sigma.shape}.")
    flat = sigma.reshape(size[0], -1)
    flat = check_map(flat, "gradients_sigma", nonnegative=True)
    if flat.min() == 0:
        raise ValueError("Expected gradients_sigma > 0, got 0: no slope is known exactly.")
    return flat.reshape(*size, -1)


def _checked_weights(weights: ArrayLike, shape: tuple[int, int]) -> NDArray[np.float32]:
    array = check_map(weights, "weights", shape=shape, nonnegative=True)
    if array.ndim != 2:
        raise ValueError(f"Expected weights of shape ({shape[0]}, {shape[1]}), got {array.shape}.")
    return array


def _checked_share(correlation_px: float, correlated_share: float) -> float:
    if not 0 <= correlation_px < np.inf:
        raise ValueError(f"Expected correlation_px >= 0, got {correlation_px}.")
    if not 0 <= correlated_share <= 1:
        raise ValueError(f"Expected correlated_share within 0-1, got {correlated_share}.")
    return correlated_share if correlation_px > 0 else 0.0


@lru_cache(maxsize=16)
def _ones(shape: tuple[int, int], dtype: Any = np.float32) -> NDArray[Any]:
    """A map of ones, shared: nobody writes to it."""
    return np.ones(shape, dtype=dtype)


@lru_cache(maxsize=16)
def _zeros(shape: tuple[int, int]) -> NDArray[Any]:
    return np.zeros(shape, dtype=np.float32)


# What is summed over the pixels of a cell: those inside the mask, weight and its square, anchor, zero pixels;
# then per slope weight x sigma and its square.
INSIDE, WEIGHT, SQUARE, HOLD, REGION, FIRST = range(6)
PER_SLOPE = 2


class _Cells:
    """The integration problem on cells.

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
        hold = _zeros(mask.shape) if anchor is None else anchor
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
            self.common = fill(self.common, known)  # as the slopes are

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


def _variance(depths: NDArray[np.float32], cells: _Cells, level: Level | None) -> NDArray[np.float32]:
    """Mean square over the probes of depth (h, w, probes) against its zero."""
    if not cells.anchored:
        zero = cells.region if cells.region.any() else cells.mask.astype(np.float32)
        flat = depths.reshape(-1, depths.shape[2])
        depths -= (zero / zero.sum()).reshape(-1) @ flat
    if level in ("plane", "quadratic"):
        fields = np.moveaxis(depths, -1, 0)
        surface = fitted_surface(fields, cells.region > 0, 1 if level == "plane" else 2)
        depths = depths - np.moveaxis(surface, 0, -1)
    return np.asarray(np.einsum("ijk,ijk->ij", depths, depths) / np.float32(depths.shape[2]))


def _smoothed(variance: NDArray[np.float32], mask: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Averaged over neighbours inside the mask."""
    blur = (0, 0), SMOOTHING_CELLS
    if mask.all():
        return np.asarray(cv2.GaussianBlur(variance, *blur)).reshape(mask.shape)
    inside = cv2.GaussianBlur(mask.astype(np.float32), *blur).reshape(mask.shape)
    smooth = cv2.GaussianBlur(np.where(mask, variance, 0).astype(np.float32), *blur).reshape(mask.shape)
    return np.asarray(smooth / np.maximum(inside, 1e-6), dtype=np.float32)


@njit(**KERNEL)  # type: ignore[misc]
def _finish(variance: Any, sigma: Any, within: Any, weights: Any, floor: Any, anchor: Any, out: Any) -> None:
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
