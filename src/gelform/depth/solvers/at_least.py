"""Depth with walls at least as steep as the slopes read there: rounds of `multigrid` with inequality terms.

Shading saturates with the slope, and the optics mix a wall with its surroundings. So a wall reads too flat, never too
steep. Where the slopes of the depth exceed the slopes read on a wall, in their direction, those lose their weight in the
next round; elsewhere they keep it (an active set: J. Nocedal and S. Wright, Numerical Optimization, 2006, ch. 16).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.depth.solvers.multigrid import MultigridSolver
from gelform.depth.solvers.seam import Solution, Weights
from gelform.slopes.gradients import slopes_of_solution

# px, mm/mm: a slope that differs by more from one at this distance belongs to a wall or its edge.
REACH_PX, WALL_DIFFERENCE = 2, 0.1
EXCEEDED_WEIGHT = 0.01  # weight of a slope on a wall that the depth's slope exceeds: close to none


class AtLeastSolver(MultigridSolver):
    """As `MultigridSolver`, with at most `rounds` more rounds if there are walls."""

    def __init__(self, shape: tuple[int, int], mm_per_px: tuple[float, float], *, rounds: int = 4) -> None:
        super().__init__(shape, mm_per_px)
        self.rounds = rounds

    def __call__(
        self,
        gradients: NDArray[Any],
        weights: Weights = None,
        mask: NDArray[np.bool_] | None = None,
        anchor: NDArray[Any] | None = None,
    ) -> Solution:
        """Depth of one frame; without walls it is that of `multigrid`."""
        solution, walls = super().__call__(gradients, weights, mask, anchor), _walls(gradients)
        square = np.square(gradients).sum(axis=-1)
        for _ in range(self.rounds if walls.any() else 0):
            slopes = slopes_of_solution(solution.depth_mm, self.mm_per_px)
            exceeded = walls & ((slopes * gradients).sum(axis=-1) > square)
            factors = np.where(exceeded, np.float32(EXCEEDED_WEIGHT), np.float32(1))
            solution = super().__call__(gradients, _weighted(weights, factors), mask, anchor)
        return solution


def _walls(gradients: NDArray[Any]) -> NDArray[np.bool_]:
    """Pixels (H, W) whose slopes differ by more from those `REACH_PX` away: root of half the sum of squares."""
    squares = np.zeros(gradients.shape[:2], dtype=np.float32)
    for axis in (0, 1):
        along, lines = np.moveaxis(gradients, axis, 0), np.moveaxis(squares, axis, 0)
        apart = np.square(along[REACH_PX:] - along[:-REACH_PX]).sum(axis=-1)
        lines[REACH_PX:] += apart
        lines[: len(apart)] += apart
    return np.asarray(squares > 2 * WALL_DIFFERENCE**2)


def _weighted(weights: Weights, factors: NDArray[np.float32]) -> Weights:
    """The weights of pixels or edges, times the factors of the pixels; an edge takes the smaller of its two."""
    if isinstance(weights, tuple):
        across, down = weights
        return (
            across * np.minimum(factors[:, 1:], factors[:, :-1]),
            down * np.minimum(factors[1:], factors[:-1]),
        )
    return factors if weights is None else np.asarray(weights * factors, dtype=np.float32)
