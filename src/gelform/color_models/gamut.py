"""The colours that a model was fitted on, and how far another colour is from them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

CELLS = 24
MARGIN = 0.25
OUTLIERS = 0.001


@dataclass(frozen=True, eq=False)
class Gamut:
    """How far a colour is from the nearest one of the training presses, on a grid of color changes.

    Attributes
    ----------
    distance : (24, 24, 24) float32, in slopes that such a difference of colour is worth on the training presses;
        0 within a cell's width of a colour that was seen
    low : (3,) float32, the color change of the first cell's centre
    cell : width of a cell, color change
    slope_per_change : RMS slope over RMS color change of the training presses
    """

    distance: NDArray[np.float32]
    low: NDArray[np.float32]
    cell: float
    slope_per_change: float

    @classmethod
    def fit(cls, color_change: NDArray[Any], gradients: NDArray[Any]) -> Gamut:
        """The gamut of color changes (N, 3) and their gradients (N, 2), without the few that stand alone."""
        low, high = np.quantile(color_change, (OUTLIERS, 1 - OUTLIERS), axis=0)
        width = float((high - low).max())
        cell = max(width * (1 + 2 * MARGIN) / (CELLS - 1), 1e-6)
        first = (low + high) / 2 - cell * (CELLS - 1) / 2
        index = np.rint((color_change - first) / cell).astype(int)
        within = ((index >= 0) & (index < CELLS)).all(axis=1)
        seen = np.zeros((CELLS,) * 3, dtype=bool)
        seen[tuple(index[within].T)] = True
        worth = float(np.sqrt(np.square(gradients).sum() / max(float(np.square(color_change).sum()), 1e-12)))
        away = worth * cell * np.maximum(distance_transform_edt(~seen) - 1, 0)
        return cls(away.astype(np.float32), first.astype(np.float32), cell, worth)

    def distance_of(self, color_change: NDArray[np.float32]) -> NDArray[np.float32]:
        """Distance (H, W), as a slope, of the colours of a frame (H, W, 3) to those of the training presses."""
        out = np.empty(color_change.shape[:2], dtype=np.float32)
        _distance(
            color_change,
            self.distance,
            self.low,
            np.float32(self.cell),
            np.float32(self.slope_per_change),
            out,
        )
        return out


@njit(cache=True, fastmath=True, nogil=True)
def _distance(change, table, low, cell, worth, out):  # type: ignore[no-untyped-def]
    """The nearest cell's distance; beyond the grid, that of its border plus the way there."""
    height, width, _ = change.shape
    last = table.shape[0] - 1
    for y in range(height):
        for x in range(width):
            beyond = np.float32(0)
            index = np.int64(0)
            for c in range(3):
                at = (change[y, x, c] - low[c]) / cell
                held = min(max(at, np.float32(0)), np.float32(last))
                beyond += (at - held) * (at - held)
                index = index * table.shape[0] + np.int64(held + np.float32(0.5))
            out[y, x] = table.ravel()[index] + (
                np.sqrt(beyond) * cell * worth if beyond > 0 else np.float32(0)
            )
