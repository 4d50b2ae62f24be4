"""Line integration: along the middle row and from there along columns, and the other way; the mean.

What one would write first. Exact on exact slopes, but the errors of all pixels on the way add up, and streaks
show it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.solvers.edges import edges_from_gradients


class PathSolver:
    """Gives depth of mean 0 for frames singly or as a stack."""

    def __init__(self, shape: tuple[int, int], mm_per_px: tuple[float, float]) -> None:
        self.shape = shape
        self.mm_per_px = mm_per_px

    def __call__(self, gradients: NDArray[Any]) -> NDArray[np.float32]:
        """Depth (..., H, W) in mm, mean 0, of gradients (..., H, W, 2)."""
        ex, ey = edges_from_gradients(np.asarray(gradients, dtype=np.float64))
        along_x = _running_sum(ex * self.mm_per_px[0], -1)
        along_y = _running_sum(ey * self.mm_per_px[1], -2)
        row, col = self.shape[0] // 2, self.shape[1] // 2
        rows_first = along_x[..., row : row + 1, :] + along_y - along_y[..., row : row + 1, :]
        columns_first = along_y[..., :, col : col + 1] + along_x - along_x[..., :, col : col + 1]
        depth = (rows_first - along_x[..., row : row + 1, col : col + 1]) / 2
        depth += (columns_first - along_y[..., row : row + 1, col : col + 1]) / 2
        return (depth - depth.mean(axis=(-2, -1), keepdims=True)).astype(np.float32)


def _running_sum(steps: NDArray[Any], axis: int) -> NDArray[Any]:
    """Heights at both ends of every step, starting from 0."""
    start = np.zeros_like(steps, shape=(*steps.shape[:axis], 1, *steps.shape[steps.ndim + axis + 1 :]))
    return np.concatenate([start, np.cumsum(steps, axis=axis)], axis=axis)
