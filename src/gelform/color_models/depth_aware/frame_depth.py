"""The depth of a whole frame, from the slopes that a plain model reads, for models that correct them by it."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.color_models.seam import Samples
from gelform.medians import medians_where
from gelform.solvers.dct import DctSolver

COARSER = 4  # depth is smooth: a sixteenth of the pixels says it
UNTOUCHED = 0.99  # of the untouched samples have a color change under that which is called untouched
LEAST_UNTOUCHED = 0.02  # part of the frame


def untouched_change(samples: Samples) -> float:
    """Color change that most of the samples of untouched gel stay under: those whose slope is 0."""
    size = np.linalg.norm(samples.color_change, axis=1)
    rest = size[~samples.gradients.any(axis=1)]
    return float(np.quantile(rest if rest.size else size, UNTOUCHED))


def coarse_grid(shape: tuple[int, int]) -> tuple[tuple[int, int], tuple[float, float]]:
    """Rows and columns of the grid that is four times coarser than frames (H, W), and its pitch (x, y), px."""
    rows, columns = (max(2, size // COARSER) for size in shape)
    return (rows, columns), (shape[1] / columns, shape[0] / rows)


class FrameDepth:
    """Least-squares depth of frames of one shape; immutable, shared by threads.

    Parameters
    ----------
    shape : (H, W)
    untouched : color changes up to it say untouched gel, where depth is 0
    """

    def __init__(self, shape: tuple[int, int], untouched: float) -> None:
        self._shape, self._square = shape, np.float32(untouched**2)
        self._coarse, pitch_px = coarse_grid(shape)
        self._solver = DctSolver(self._coarse, pitch_px)

    def __call__(
        self, color_change: NDArray[np.float32], gradients: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Depth (H, W) of slopes (H, W, 2), px: 0 in the median of the untouched pixels, and nowhere less."""
        return self.in_full(self.coarse(color_change, gradients))

    def coarse(
        self, color_change: NDArray[np.float32], gradients: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """The same on a grid that is four times coarser."""
        change, slopes = self.made_coarse(color_change), self.made_coarse(gradients)
        change -= medians_where(change)[0]
        square = np.einsum("...c,...c->...", change, change)
        rest = square <= max(self._square, np.quantile(square, LEAST_UNTOUCHED))
        depth = self._solver(slopes - medians_where(slopes, rest)[0]).depth_mm
        depth -= medians_where(depth[..., None], rest)[0]
        np.maximum(depth, 0, out=depth)
        return depth

    def made_coarse(self, values: NDArray[Any]) -> NDArray[Any]:
        """Values (H, W, ...) on the coarser grid: means."""
        return np.asarray(cv2.resize(values, self._coarse[::-1], interpolation=cv2.INTER_AREA))

    def coarse_positions(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """x, y of the middle of each sample of the coarser grid, px."""
        y, x = ((np.arange(few) + 0.5) * many / few - 0.5 for few, many in zip(self._coarse, self._shape))
        return tuple(np.meshgrid(x, y))  # type: ignore[return-value]

    def in_full(self, values: NDArray[Any]) -> NDArray[Any]:
        """Values of the coarser grid for every pixel, bilinear."""
        return np.asarray(cv2.resize(values, self._shape[::-1], interpolation=cv2.INTER_LINEAR))
