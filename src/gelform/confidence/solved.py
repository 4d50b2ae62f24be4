"""Standard deviation of the slopes of the solved depth, which is what a result states: where balls showed them, and beyond.

A surface cannot follow errors of slopes that have curl, so solved slopes are better than those that were read; by how much,
held-out presses say by slope and place. What presses of balls hardly show is added: what blur takes at edges and walls.
None of it changes how slopes are weighted, nor the depth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.confidence.slope_sigma import LEAST_APART, MIN_IN_BIN, ONE_SIGMA, PLACES, SlopeSigma, factor_at

STEEPEST = (
    1.0  # mm/mm: no slope of a gel is known less well than that; saturated or hidden, it is known no better
)
UNLIMITED = 4 * STEEPEST  # before the factors
LEAST_FACTOR = 0.3
PRIOR_PRESSES = 3.0  # a place counts for itself as far as more presses than this touched it
# Blur of standard deviation d px takes d^2/2 times its Laplacian from a slope (Taylor); BLURRED times that holds two thirds
# of the errors at edges and walls. To the blur of the color change comes the camera's, OPTICS_PX. Both were chosen on eight
# objects on twelve simulated sensors and on a real one, and held on eight others.
OPTICS_PX, BLURRED = 2.5, 0.6
REACH = 1.6  # blurs, to the slopes that a slope is compared with

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
    """

    def __init__(self, sigma: SlopeSigma | None, shape: tuple[int, int], blur_px: float | None) -> None:
        y, x = ((np.arange(n) + 0.5) / n for n in shape)
        slopes: tuple[float, float] = (0.0, 1.0)
        grids: tuple[Any, ...] = (((1.0,),),) * 2
        if sigma is not None:
            slopes = sigma.solved_slopes or slopes
            grids = sigma.solved_places or (((sigma.solved_factor,),),) * 2
        self._factors = [
            factor_at(np.array(grid), x[None, :], y[:, None]).astype(np.float32) for grid in grids
        ]
        walls = (0.0, 1) if blur_px is None else (curvature_worth(blur_px), reach_px(blur_px))
        law = slopes[0], 1 / (slopes[1] - slopes[0])
        self._numbers = (walls[0], UNLIMITED, *law, STEEPEST, walls[1])

    def __call__(
        self, sigma: NDArray[np.float32] | None, gradients: NDArray[np.float32]
    ) -> NDArray[np.float32] | None:
        """Standard deviation (H, W, 2) of the slopes of the solved depth.

        A slope that was read badly follows from its neighbours: beside its own reading each is known by the two loops of
        four edges that it closes. Where slopes bend sharply they are off by what the blur takes. No slope is less known than
        within `STEEPEST` but for a wall's.

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
        return solved


def reach_px(blur_px: float) -> int:
    """How far from a pixel those lie that its slope is compared with, of a color change that is blurred so much."""
    return max(1, round(REACH * blur_px))


def curvature_worth(blur_px: float) -> float:
    """Error of a slope over the sum of its differences to those `reach_px` away on four sides."""
    return float(BLURRED * (blur_px**2 + OPTICS_PX**2) / (2 * reach_px(blur_px) ** 2))


def for_both(sigma: NDArray[np.float32]) -> NDArray[np.float32]:
    """One map (H, W) as both components (H, W, 2), read-only: what `np.broadcast_to` gives, in a tenth of its time."""
    both: NDArray[np.float32] = np.ndarray((*sigma.shape, 2), sigma.dtype, sigma, 0, (*sigma.strides, 0))
    both.flags.writeable = False
    return both


@dataclass(frozen=True)
class SolvedErrors:
    """Errors of solved slopes on presses that the model has not seen.

    Attributes
    ----------
    slopes : (N,) |gradient| of the solved depth
    errors : (N, 2) of its components
    foretold : (N,) standard deviation by a `SolvedSigma` without factors
    beyond : (N,) the part of it that does not come from the readings
    x, y : (N,) place in the frame, 0-1
    press : (N,) index of the press
    """

    slopes: NDArray[Any]
    errors: NDArray[Any]
    foretold: NDArray[Any]
    beyond: NDArray[Any]
    x: NDArray[Any]
    y: NDArray[Any]
    press: NDArray[Any]


def with_solved_factors(sigma: SlopeSigma, held_out: SolvedErrors) -> SlopeSigma:
    """The deviation with factors by slope and place that hold 68 % of the held-out errors of solved slopes within one sigma.

    A place's factor is drawn towards that of the whole frame where few presses touched it. Where all slopes are alike
    the deviation stays as it is.
    """
    if held_out.slopes.size < MIN_IN_BIN or np.ptp(held_out.slopes) < LEAST_APART:
        return sigma
    steep = held_out.slopes > held_out.slopes.mean()
    gentle_slope, steep_slope = (float(np.median(held_out.slopes[part])) for part in (~steep, steep))
    squares = np.maximum(held_out.foretold**2 - held_out.beyond**2, 1e-12)
    ratio = (held_out.errors**2 - held_out.beyond[:, None] ** 2) / squares[:, None]
    grids = tuple(_factors(ratio, held_out, part) for part in (~steep, steep))
    return replace(sigma, solved_slopes=(gentle_slope, steep_slope), solved_places=grids)


def _factors(
    ratio: NDArray[Any], held_out: SolvedErrors, among: NDArray[np.bool_]
) -> tuple[tuple[float, ...], ...]:
    """Of one range of slopes, on a grid of places; `ratio` (N, 2) are squares of errors over those foretold."""
    rows, columns = PLACES
    row = np.clip((held_out.y * rows).astype(int), 0, rows - 1)
    place = row * columns + np.clip((held_out.x * columns).astype(int), 0, columns - 1)
    whole = _root_of_share(ratio[among])
    factors = np.full(rows * columns, whole)
    for k in range(factors.size):
        here = among & (place == k)
        if np.count_nonzero(here) >= MIN_IN_BIN:
            presses = len(np.unique(held_out.press[here]))
            trust = presses / (presses + PRIOR_PRESSES)
            factors[k] = whole ** (1 - trust) * _root_of_share(ratio[here]) ** trust
    return tuple(tuple(map(float, line)) for line in factors.reshape(PLACES))


def _root_of_share(ratio: NDArray[Any]) -> float:
    return float(np.sqrt(max(np.quantile(ratio, ONE_SIGMA), LEAST_FACTOR**2)))
