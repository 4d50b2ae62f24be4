"""Standard deviation of the slopes of the solved depth, which is what a result states: where balls showed them, and beyond.

A surface cannot follow errors of slopes that have curl, so solved slopes are better than those that were read; by how much,
held-out presses say by slope and place. What presses of balls hardly show is added: what blur takes at edges and walls.
None of it changes how slopes are weighted, nor the depth.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.confidence.slope_sigma import (
    LEAST_APART,
    MIN_IN_BIN,
    ONE_SIGMA,
    SlopeSigma,
    SolvedErrors,
    factor_at,
    place_factors,
)

STEEPEST_GEL = 1.0  # mm/mm: no slope of a gel is known less well; saturated or hidden, it is known no better
UNLIMITED = 4 * STEEPEST_GEL  # mm/mm, before the factors
LEAST_SOLVED_FACTOR = 0.3  # of the predicted deviation
PRIOR_SOLVED_PRESSES = 3.0  # a place counts for itself as far as more presses than this touched it
# Blur of standard deviation d px takes d^2/2 times its Laplacian from a slope (Taylor); BLURRED times that holds two thirds
# of the errors at edges and walls. To the blur of the color change comes the camera's, OPTICS_PX. Both were chosen on eight
# objects on twelve simulated sensors and on a real one, and held on eight others.
OPTICS_PX, BLURRED = 2.5, 0.6
REACH_BLURS = 1.6  # to the slopes that a slope is compared with: further than what the blur makes alike

_solved_sigma = Kernel(
    "solved_sigma",
    "f32[h,w] sigma, f32[h,w,2] gradients, f32[h,w] gentle, f32[h,w] steep, out f32[n] work, out f32[h,w] solved, "
    "f32 curvature, f32 unlimited, f32 from_slope, f32 per_slope, f32 limit, i32 reach",
)


class SolvedSigma:
    """Of whole frames of one calibration; immutable, shared by threads.

    Parameters
    ----------
    sigma : of the calibration; None where it knows none: what a color model states itself holds for solved slopes too
    shape : (H, W) of the images
    blur_px : of the color change; None of imported calibrations, whose blur is unknown: no slope is a wall's
    spread : relative standard deviation of slopes between units, of a starter
    """

    def __init__(
        self, sigma: SlopeSigma | None, shape: tuple[int, int], blur_px: float | None, spread: float = 0.0
    ) -> None:
        self._spread = np.float32(spread / np.sqrt(2))  # of one component of a slope
        y, x = ((np.arange(n) + 0.5) / n for n in shape)
        slopes: tuple[float, float] = (0.0, 1.0)
        grids: tuple[Any, ...] = (((1.0,),),) * 2
        if sigma is not None:
            slopes = sigma.solved_slopes or slopes
            grids = sigma.solved_places or (((sigma.solved_factor,),),) * 2
        self._factors = [
            factor_at(np.array(grid), x[None, :], y[:, None]).astype(np.float32) for grid in grids
        ]
        per_difference, reach = 0.0, 1
        if blur_px is not None:
            per_difference, reach = error_per_difference(blur_px), reach_px(blur_px)
        law = slopes[0], 1 / (slopes[1] - slopes[0])
        self._numbers = per_difference, UNLIMITED, *law, STEEPEST_GEL, reach

    def __call__(
        self, sigma: NDArray[np.float32] | None, gradients: NDArray[np.float32]
    ) -> NDArray[np.float32] | None:
        """Standard deviation (H, W, 2) of the slopes of the solved depth.

        A slope that was read badly follows from its neighbours: beside its own reading each is known by the two loops of
        four edges that it closes. Where slopes bend sharply they are off by what the blur takes. No slope is less known than
        within `STEEPEST_GEL` but for a wall's.

        Parameters
        ----------
        sigma : (H, W, 2) of the slopes as they were read; None where nobody knows
        gradients : (H, W, 2) of the solved depth
        """
        if sigma is None:
            return None
        alike = sigma.strides[-1] == 0  # one map for both components, broadcast
        maps = [self._map(np.ascontiguousarray(sigma[..., c]), gradients) for c in range(1 if alike else 2)]
        return for_both(maps[0]) if alike else np.stack(maps, axis=-1)

    def _map(self, sigma: NDArray[np.float32], gradients: NDArray[np.float32]) -> NDArray[np.float32]:
        solved, work = np.empty_like(sigma), np.empty(3 * sigma.shape[1] + 2, dtype=np.float32)
        _solved_sigma(sigma, gradients, *self._factors, work, solved, *self._numbers)
        if self._spread:
            solved = np.hypot(solved, self._spread * np.hypot(gradients[..., 0], gradients[..., 1]))
        return solved


def reach_px(blur_px: float) -> int:
    """How far from a pixel those lie that its slope is compared with, of a color change that is blurred so much."""
    return max(1, round(REACH_BLURS * blur_px))


def error_per_difference(blur_px: float) -> float:
    """Error of a slope over the sum of its differences to those `reach_px` away on four sides."""
    return float(BLURRED * (blur_px**2 + OPTICS_PX**2) / (2 * reach_px(blur_px) ** 2))


def for_both(sigma: NDArray[np.float32]) -> NDArray[np.float32]:
    """One map (H, W) as both components (H, W, 2), read-only: what `np.broadcast_to` gives, in a tenth of its time."""
    both: NDArray[np.float32] = np.ndarray((*sigma.shape, 2), sigma.dtype, sigma, 0, (*sigma.strides, 0))
    both.flags.writeable = False
    return both


def with_solved_factors(sigma: SlopeSigma, held_out: SolvedErrors) -> SlopeSigma:
    """The deviation with factors by slope and place that hold 68 % of the held-out errors of solved slopes within one sigma.

    A place's factor is drawn towards that of the whole frame where few presses touched it. Where all slopes are alike
    the deviation stays as it is.
    """
    if held_out.slopes.size < MIN_IN_BIN or np.ptp(held_out.slopes) < LEAST_APART:
        return sigma
    steep = held_out.slopes > held_out.slopes.mean()
    gentle_slope, steep_slope = (float(np.median(held_out.slopes[part])) for part in (~steep, steep))
    squares = np.maximum(held_out.predicted**2 - held_out.extra**2, 1e-12)
    ratio = (held_out.errors**2 - held_out.extra[:, None] ** 2) / squares[:, None]

    parts = [(part, _root_size(ratio[part])) for part in (~steep, steep)]
    grids = [place_factors(held_out, ratio, _root_size, PRIOR_SOLVED_PRESSES, *part) for part in parts]
    places = tuple(tuple(tuple(map(float, line)) for line in grid) for grid in grids)
    return replace(sigma, solved_slopes=(gentle_slope, steep_slope), solved_places=places)


def _root_size(squares: NDArray[Any]) -> float:
    return float(np.sqrt(max(np.quantile(squares, ONE_SIGMA), LEAST_SOLVED_FACTOR**2)))
