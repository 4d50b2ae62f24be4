"""Standard deviation of the slopes of the solved depth, which results state, for slopes of balls and of other objects.

A surface cannot follow slope errors that have curl, so solved slopes are better than slopes as read. Held-out presses
show by how much, by slope and place. An error at edges and walls is added, because presses of balls hardly show what the
blur takes there. None of this changes the weights of slopes or the depth.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.slopes.confidence.slope_sigma import (
    LEAST_APART,
    LEAST_FACTOR,
    MIN_IN_BIN,
    ONE_SIGMA,
    PRIOR_PRESSES,
    SlopeSigma,
    SolvedErrors,
    factor_at,
    place_factors,
)
from gelform.slopes.gradients import STEEPEST_GEL

UNLIMITED = 4 * STEEPEST_GEL  # mm/mm, largest deviation before the factors
# A blur of standard deviation d px removes d^2/2 times its Laplacian from a slope (Taylor); BLURRED times that contains two
# thirds of the errors at edges and walls. OPTICS_PX, px, is the camera's blur, added to that of the color change. Both were
# chosen on eight objects on twelve simulated sensors and a real one, and confirmed on eight others.
OPTICS_PX, BLURRED = 2.5, 0.6
# blurs, distance of the slopes that a slope is compared with; it is longer than the blur's own correlation
REACH_BLURS = 1.6

_solved_sigma = Kernel(
    "solved_sigma",
    "f32[h,w] sigma, f32[h,w,2] gradients, f32[h,w] gentle, f32[h,w] steep, out f32[n] work, out f32[h,w] solved, "
    "out f32[h,w] wall, f32 curvature, f32 unlimited, f32 from_slope, f32 per_slope, f32 limit, i32 reach",
)


class SolvedSigma:
    """Standard deviation of the solved slopes for whole frames of one calibration. It is immutable; threads can share it.

    Parameters
    ----------
    sigma : of the calibration; None if unknown: a color model's own deviation then holds for solved slopes too
    shape : (H, W) of the images
    blur_px : of the color change; None for imported calibrations, whose blur is unknown, so that no slope is a wall's
    spread : relative standard deviation of slopes between units, of a starter
    """

    def __init__(
        self, sigma: SlopeSigma | None, shape: tuple[int, int], blur_px: float | None, spread: float = 0.0
    ) -> None:
        self._spread = np.float32(spread / np.sqrt(2))  # for one component of a slope
        y, x = ((np.arange(n) + 0.5) / n for n in shape)
        slopes: tuple[float, float] = (0.0, 1.0)
        grids: tuple[Any, ...] = (((1.0,),),) * 2
        if sigma is not None:
            slopes = sigma.solved_slopes or slopes
            grids = sigma.solved_places or grids
        self._factors = [
            factor_at(np.array(grid), x[None, :], y[:, None]).astype(np.float32) for grid in grids
        ]
        per_difference, reach = 0.0, 1
        if blur_px is not None:
            per_difference, reach = error_per_difference(blur_px), reach_px(blur_px)
        self._numbers = {
            "curvature": per_difference, "unlimited": UNLIMITED, "from_slope": slopes[0],
            "per_slope": 1 / (slopes[1] - slopes[0]), "limit": STEEPEST_GEL, "reach": reach,
        }  # fmt: skip

    def __call__(
        self, sigma: NDArray[np.float32] | None, gradients: NDArray[np.float32]
    ) -> NDArray[np.float32] | None:
        """Standard deviation (H, W, 2) of the slopes of the solved depth, as `with_walls` gives it."""
        return self.with_walls(sigma, gradients)[0]

    def with_walls(
        self, sigma: NDArray[np.float32] | None, gradients: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32] | None, NDArray[np.float32] | None]:
        """Standard deviation (H, W, 2) of the slopes of the solved depth, and its part (H, W) from the blur at walls.

        A badly read slope follows from its neighbors: besides its own reading, the two loops of four edges that it closes
        determine it. Sharply bending slopes have the error of the blur. No deviation exceeds `STEEPEST_GEL` except that of
        a wall.

        Parameters
        ----------
        sigma : (H, W, 2) of the slopes as they were read; None if unknown
        gradients : (H, W, 2) of the solved depth
        """
        if sigma is None:
            return None, None
        alike = sigma.strides[-1] == 0  # one map for both components, broadcast
        wall = np.empty(sigma.shape[:2], dtype=np.float32)  # nearly alike by p and by q; the last is kept
        maps = [
            self._map(np.ascontiguousarray(sigma[..., c]), gradients, wall) for c in range(1 if alike else 2)
        ]
        return for_both(maps[0]) if alike else np.stack(maps, axis=-1), wall

    def _map(
        self, sigma: NDArray[np.float32], gradients: NDArray[np.float32], wall: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        solved, work = np.empty_like(sigma), np.empty(3 * sigma.shape[1] + 2, dtype=np.float32)
        gentle, steep = self._factors
        _solved_sigma(sigma, gradients, gentle, steep, work, solved, wall, **self._numbers)
        if self._spread:
            solved = np.hypot(solved, self._spread * np.hypot(gradients[..., 0], gradients[..., 1]))
        return solved


def reach_px(blur_px: float) -> int:
    """Distance, px, of the slopes that a slope is compared with, for a color change of that blur."""
    return max(1, round(REACH_BLURS * blur_px))


def error_per_difference(blur_px: float) -> float:
    """Error of a slope over the sum of its differences to those `reach_px` away on four sides."""
    return float(BLURRED * (blur_px**2 + OPTICS_PX**2) / (2 * reach_px(blur_px) ** 2))


def for_both(sigma: NDArray[np.float32]) -> NDArray[np.float32]:
    """One map (H, W) for both components (H, W, 2), read-only: as `np.broadcast_to`, in a tenth of its time."""
    both: NDArray[np.float32] = np.ndarray((*sigma.shape, 2), sigma.dtype, sigma, 0, (*sigma.strides, 0))
    both.flags.writeable = False
    return both


def with_solved_factors(sigma: SlopeSigma, held_out: SolvedErrors) -> SlopeSigma:
    """The deviation with factors by slope and place, so that 68 % of held-out errors of solved slopes lie within one sigma.

    A place's factor is pulled toward that of the whole frame if few presses touched it. If all slopes are alike,
    the deviation stays unchanged.
    """
    if held_out.slopes.size < MIN_IN_BIN or np.ptp(held_out.slopes) < LEAST_APART:
        return sigma
    steep = held_out.slopes > held_out.slopes.mean()
    gentle_slope, steep_slope = (float(np.median(held_out.slopes[part])) for part in (~steep, steep))
    squares = np.maximum(held_out.predicted**2 - held_out.extra**2, 1e-12)
    ratio = (held_out.errors**2 - held_out.extra[:, None] ** 2) / squares[:, None]

    parts = [(part, _root_size(ratio[part])) for part in (~steep, steep)]
    grids = [place_factors(held_out, ratio, _root_size, PRIOR_PRESSES, *part) for part in parts]
    places = tuple(tuple(tuple(map(float, line)) for line in grid) for grid in grids)
    return replace(sigma, solved_slopes=(gentle_slope, steep_slope), solved_places=places)


def _root_size(squares: NDArray[Any]) -> float:
    return float(np.sqrt(max(np.quantile(squares, ONE_SIGMA), LEAST_FACTOR**2)))
