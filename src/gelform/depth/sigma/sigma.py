"""The standard deviation of depth at each pixel, relative to the zero reference.

Slope errors have a white part, which integration averages out, and a part that is correlated over some pixels
(a color model's bias), which it does not. At equal size the second part moves depth far more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform._native import Kernel
from gelform.depth.sigma.blocks import (
    Blocks,
    ErrorParts,
    block_rows_and_columns,
    less_mean,
    sigma_of_pixels,
    variance_of_depths,
)
from gelform.depth.sigma.closed_form import (
    correlation_of_blocks,
    fading_within_blocks,
    variance_of_white,
    variance_within_blocks,
)
from gelform.depth.sigma.probes import ProbeSolver, correlated_draws, white_draws
from gelform.depth.solvers.inputs import check_anchor
from gelform.depth.solvers.system import FLOOR, constant_map
from gelform.depth.zero import Level, Zero, checked_level, fitted_surface, zero_region
from gelform.errors import ConvergenceError
from gelform.foundations.checks import (
    as_array,
    check_is,
    check_map,
    check_mask,
    check_mm_per_px,
    check_numbers,
    check_within,
)

# pixels and probes; a larger number is a typing error, because no camera or memory has so many
MOST_PX, MOST_PROBES = 20_000, 10_000


def checked_sigma(gradients_sigma: ArrayLike, shape: tuple[int, int] | None = None) -> NDArray[np.float32]:
    """Standard deviations (H, W, 1 or 2)."""
    sigma = as_array(gradients_sigma, "gradients_sigma")
    size = sigma.shape[:2]
    alike = shape is not None and sigma.shape == tuple(shape)
    if not alike and (sigma.ndim != 3 or sigma.shape[2] != 2 or shape not in (None, size)):
        wanted = "(H, W, 2)" if shape is None else f"({shape[0]}, {shape[1]}, 2)"
        raise ValueError(f"Expected gradients_sigma of shape {wanted}, got {sigma.shape}.")
    if sigma.size == 0:
        raise ValueError(f"Expected gradients_sigma of some pixels, got none: shape {sigma.shape}.")
    if sigma.ndim == 3 and sigma.strides[2] == 0:
        sigma = sigma[..., 0]  # one map, broadcast to both slopes
    flat = check_map(sigma.reshape(size[0], -1), "gradients_sigma", nonnegative=True)
    if flat.min() == 0:
        raise ValueError("Expected gradients_sigma > 0, got 0: no slope is known exactly.")
    return flat.reshape(*size, -1)


def checked_weights(weights: ArrayLike, shape: tuple[int, int]) -> NDArray[np.float32]:
    array = check_map(weights, "weights", shape=shape, nonnegative=True)
    if array.ndim != 2:
        raise ValueError(f"Expected weights of shape ({shape[0]}, {shape[1]}), got {array.shape}.")
    return array


def checked_probes(probes: int) -> int:
    """Return a number of random draws that is enough for a standard deviation."""
    return int(check_within(probes, "probes", 2, MOST_PROBES))


def checked_share(correlation_px: float, correlated_share: float) -> float:
    check_within(correlation_px, "correlation_px", 0, MOST_PX)
    check_within(correlated_share, "correlated_share", 0, 1)
    return correlated_share if correlation_px > 0 else 0.0


def checked_rest(at_rest: ArrayLike | None, shape: tuple[int, int]) -> NDArray[np.bool_] | None:
    """Return the pixels (H, W) at rest, possibly none, as bool."""
    if at_rest is None:
        return None
    array = as_array(at_rest, "at_rest")
    if array.dtype != np.bool_ or array.shape != shape:
        raise ValueError(f"Expected rest as bool of shape {shape}, got {array.dtype} of {array.shape}.")
    return np.ascontiguousarray(array)


# Probes are solved on blocks, because sigma is smooth: about BLOCKS of them, from BLOCK_PX[0] to BLOCK_PX[1] pixels wide.
BLOCKS, BLOCK_PX = 2300, (2, 6)


class DepthSigma:
    """One standard deviation of the depth, frame by frame; everything that does not depend on the frame is prepared once.

    It is immutable and a pure function of its arguments; threads can share it.

    Parameters
    ----------
    shape : (H, W)
    mm_per_px : float or (x, y), mm
    correlation_px : float, >= 0
        Distance over which the correlated part of the slope errors falls to exp(-1/2) (a Gaussian); 0: all of
        the error is white.
    correlated_share : float, 0-1
        Share of the variance that is correlated, if `correlation_px` > 0.
    rest_correlated_share : float, 0-1, optional
        The same for pixels at rest; as elsewhere by default.
    rest_correlation_px : float, >= 0
        Distance over which the other part falls to exp(-1/2) at rest, a few pixels; 0: it is white.
    probes : int, >= 2
        Number of fields of random slope errors that are integrated; 32 leave an error of 3 to 9 % in
        the median over the frame.
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
        rest_correlated_share: float | None = None,
        rest_correlation_px: float = 0.0,
        probes: int = 32,
        rng: np.random.Generator | None = None,
    ) -> None:
        height, width = check_numbers(shape, "shape", 2)
        self.shape = shape = (
            int(check_within(height, "height", 1, MOST_PX)),
            int(check_within(width, "width", 1, MOST_PX)),
        )
        self.pitch = check_mm_per_px(mm_per_px)
        fraction = checked_share(correlation_px, correlated_share)
        rest_fraction = fraction if rest_correlated_share is None else rest_correlated_share
        rest_fraction = checked_share(correlation_px, rest_fraction)
        check_within(rest_correlation_px, "rest_correlation_px", 0, MOST_PX)
        probes = checked_probes(probes)
        block = self.block = int(np.clip(round((shape[0] * shape[1] / BLOCKS) ** 0.5), *BLOCK_PX))
        blocks = block_rows_and_columns(self.shape, block)
        rng = np.random.default_rng(0) if rng is None else check_is(rng, np.random.Generator, "rng")
        white = white_draws(probes, blocks, rng)
        common = np.zeros_like(white)
        if max(fraction, rest_fraction) > 0:
            length, power = correlation_of_blocks(correlation_px, block)
            common = np.float32(np.sqrt(power)) * correlated_draws(probes, blocks, length, rng)
        self._solver = ProbeSolver(white, common, (self.pitch[0] * block, self.pitch[1] * block))
        aspect, area = self.pitch[0] / self.pitch[1], self.pitch[0] * self.pitch[1]
        self.parts = ErrorParts(block, fraction, rest_fraction, rest_correlation_px, aspect)
        per_slope = variance_within_blocks(aspect, block)
        self._within = np.array(per_slope, dtype=np.float32) * np.float32(area)
        self._fading = np.array(fading_within_blocks(aspect, block), dtype=np.float32)

    def __call__(
        self,
        gradients_sigma: ArrayLike,
        *,
        weights: ArrayLike | None = None,
        mask: ArrayLike | None = None,
        anchor: ArrayLike | None = None,
        zero: Zero | NDArray[np.bool_] = "mean",
        level: Level | None = None,
        at_rest: ArrayLike | None = None,
        against: NDArray[np.bool_] | None = None,
    ) -> NDArray[np.float32]:
        """Standard deviation of depth, (H, W) float32, mm, of one frame.

        Parameters
        ----------
        gradients_sigma : (H, W, 2), or (H, W) for both slopes alike; mm/mm, > 0
        weights, mask, anchor, zero, level
            As for `depth_from_gradients`; weights per pixel.
        rest : (H, W) bool, optional
            Pixels at rest, where errors have the correlation of rest; none by default.
        against : (H, W) bool
            Gives the standard deviation of depth minus its mean over these pixels, that is, of the shape.
        """
        shape = self.shape
        sigma = checked_sigma(gradients_sigma, shape)
        weight = constant_map(shape, 1.0) if weights is None else checked_weights(weights, shape)
        inside = None if mask is None else check_mask(mask, shape=shape)
        hold = None if anchor is None else check_anchor(anchor, shape)
        region, level = zero_region(zero, shape), checked_level(level)
        at_rest = checked_rest(at_rest, shape)
        if inside is not None:
            weight = weight * inside
        pixels = None
        if against is not None:
            pixels = check_mask(against, shape=shape, name="against")
            pixels = pixels if inside is None else pixels & inside
        return self._of_pixels(sigma, weight, inside, hold, region, at_rest, level, pixels)

    def unchecked(
        self,
        gradients_sigma: NDArray[np.float32],
        *,
        weights: NDArray[np.float32] | None = None,
        anchor: NDArray[np.float32] | None = None,
        zero: NDArray[np.bool_] | None = None,
        at_rest: NDArray[np.bool_],
    ) -> NDArray[np.float32]:
        """The same of a frame that a Reconstructor made: its values were checked where they came in.

        `gradients_sigma` (H, W, 1 or 2) is as `checked_sigma` gives it, the maps (H, W) are in C order; without an anchor
        `zero` is
        needed.
        """
        weight = constant_map(self.shape, 1.0) if weights is None else weights
        return self._of_pixels(gradients_sigma, weight, None, anchor, zero, at_rest)

    def _of_pixels(
        self,
        sigma: NDArray[np.float32],
        weight: NDArray[np.float32],
        inside: NDArray[np.bool_] | None,
        anchor: NDArray[np.float32] | None,
        region: NDArray[np.bool_] | None,
        at_rest: NDArray[np.bool_] | None,
        level: Level | None = None,
        against: NDArray[np.bool_] | None = None,
    ) -> NDArray[np.float32]:
        """Standard deviation of pixels (H, W) from that of blocks."""
        floor = np.float32(FLOOR) * weight.max()
        blocks = Blocks(sigma, weight, inside, anchor, region, at_rest, floor, self.parts)
        median = blocks.share_in_median() if level == "slope" else None
        depths = self._solver(blocks.white, blocks.common, blocks.problem, median)
        variance = variance_of_depths(_against_zero(depths, blocks, level, against), blocks.mask)
        settings = self.parts.within_blocks, self._within, self._fading
        return sigma_of_pixels(variance, sigma, at_rest, *settings, weight, floor, anchor, self.block)


def depth_sigma_from_gradients_sigma(
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
    rest is Monte Carlo on a grid of blocks of up to 6 pixels; what that grid cannot see is added from the
    closed form.
    """
    pitch = check_mm_per_px(mm_per_px)
    sigma = checked_sigma(gradients_sigma)
    shape = sigma.shape[0], sigma.shape[1]
    checked_share(correlation_px, correlated_share)
    if rng is not None:
        check_is(rng, np.random.Generator, "rng")
    settings: dict[str, Any] = {
        "mm_per_px": pitch,
        "correlation_px": float(correlation_px),
        "correlated_share": float(correlated_share),
        "probes": checked_probes(probes),
    }
    uniform = weights is None and mask is None and anchor is None and checked_level(level) is None
    constant = bool(np.all(sigma == sigma[0, 0]))
    if uniform and constant and correlation_px == 0 and isinstance(zero, str) and zero == "mean":
        per_x, per_y = variance_of_white(shape, pitch)
        return np.sqrt(sigma[0, 0, 0] ** 2 * per_x + sigma[0, 0, -1] ** 2 * per_y).astype(np.float32)
    prepared = _prepared(shape, **settings) if rng is None else DepthSigma(shape, **settings, rng=rng)
    return prepared(sigma, weights=weights, mask=mask, anchor=anchor, zero=zero, level=level)


@lru_cache(maxsize=4)
def _prepared(shape: tuple[int, int], **settings: Any) -> DepthSigma:
    return DepthSigma(shape, **settings)


def _against_zero(
    depths: NDArray[np.float32], blocks: Blocks, level: Level | None, against: NDArray[np.bool_] | None
) -> NDArray[np.float32]:
    """Depths (h, w, probes) against their zero, or their mean over pixels (H, W)."""
    if not blocks.anchored:
        zero = blocks.region if blocks.region.any() else blocks.mask.astype(np.float32)
        flat = depths.reshape(-1, depths.shape[2])
        depths -= (zero / zero.sum()).reshape(-1) @ flat
    if level in ("plane", "quadratic"):
        fields = np.moveaxis(depths, -1, 0)
        surface = fitted_surface(fields, blocks.region > 0, 1 if level == "plane" else 2)
        depths = np.ascontiguousarray(depths - np.moveaxis(surface, 0, -1))
    return depths if against is None else less_mean(depths, against, blocks.size)


_add_in_proportion = Kernel("add_in_proportion", "out f32[...] sigma, f32[...] depth, f32 share, f32 most")


def add_in_proportion(
    sigma: NDArray[np.float32], depth: NDArray[np.float32], fraction: float, most: float
) -> NDArray[np.float32]:
    """Add an error of a fraction of the depth (H, W) to its standard deviation, in place; `most` is the limit.

    ConvergenceError: beyond what float32 holds.
    """
    if _add_in_proportion(sigma, depth, fraction, most):
        raise ConvergenceError(
            "Expected a finite standard deviation of depth, got infinity or NaN. Slopes, their deviation or "
            "mm_per_px differ by more than float32 holds: check the calibration's scales."
        )
    return sigma


@dataclass(frozen=True, eq=False)
class DepthDifference:
    """How well the depth of a frame is known against its own mean over a region.

    Attributes
    ----------
    prepared : DepthSigma
    gradients_sigma : (H, W, 2), of the slopes as they were read
    solve_args : weights and anchor, or zero, as the depth was solved with
    depth_mm : (H, W)
    gain_sigma : relative standard deviation of all slopes together, which moves differences of depth in proportion
    missing_mm : (H, W), depth that steep slopes may miss, one standard deviation; None: none
    """

    prepared: DepthSigma
    gradients_sigma: NDArray[np.float32]
    solve_args: dict[str, Any]
    depth_mm: NDArray[np.float32]
    gain_sigma: float
    missing_mm: NDArray[np.float32] | None = None

    def __call__(self, region: NDArray[np.bool_]) -> NDArray[np.float32]:
        """Standard deviation (H, W), mm, of the depth minus its mean over a region (H, W) of some pixels."""
        sigma = self.prepared(self.gradients_sigma, **self.solve_args, against=region)
        apart = self.depth_mm - np.float32(self.depth_mm[region].mean(dtype=np.float64))
        square = np.square(sigma) + np.square(np.float32(self.gain_sigma) * apart)
        if self.missing_mm is not None:
            square += np.square(self.missing_mm - self.missing_mm[region].mean())
        return np.asarray(np.sqrt(square))
