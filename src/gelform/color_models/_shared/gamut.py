"""The colours that a model was fitted on, and how far another colour is from them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

BINS = 24
MARGIN = 0.25
OUTLIERS = 0.001


@dataclass(frozen=True, eq=False)
class Gamut:
    """How far a colour is from the nearest one of the training presses, on a grid of color changes.

    Attributes
    ----------
    distance : (24, 24, 24) float32, in slopes that such a difference of colour is worth on the training presses;
        0 within a bin's width of a colour that was seen
    low : (3,) float32, the color change of the first bin's centre
    bin_width : of color change
    slope_per_change : RMS slope over RMS color change of the training presses
    """

    distance: NDArray[np.float32]
    low: NDArray[np.float32]
    bin_width: float
    slope_per_change: float

    @classmethod
    def fit(cls, color_change: NDArray[Any], gradients: NDArray[Any]) -> Gamut:
        """The gamut of color changes (N, 3) and their gradients (N, 2), without the few that stand alone."""
        low, high = np.quantile(color_change, (OUTLIERS, 1 - OUTLIERS), axis=0)
        width = float((high - low).max())
        bin_width = max(width * (1 + 2 * MARGIN) / (BINS - 1), 1e-6)
        first = (low + high) / 2 - bin_width * (BINS - 1) / 2
        index = np.rint((color_change - first) / bin_width).astype(int)
        within = ((index >= 0) & (index < BINS)).all(axis=1)
        seen = np.zeros((BINS,) * 3, dtype=bool)
        seen[tuple(index[within].T)] = True
        worth = float(np.sqrt(np.square(gradients).sum() / max(float(np.square(color_change).sum()), 1e-12)))
        away = worth * bin_width * np.maximum(distance_transform_edt(~seen) - 1, 0)
        return cls(away.astype(np.float32), first.astype(np.float32), bin_width, worth)

    def distance_of(self, color_change: NDArray[np.float32]) -> NDArray[np.float32]:
        """Distance (H, W), as a slope, of the colours of a frame (H, W, 3) to those of the training presses."""
        out = np.empty(color_change.shape[:2], dtype=np.float32)
        worth = np.float32(self.bin_width * self.slope_per_change)
        _distance(color_change, self.distance.ravel(), self.low, np.float32(1 / self.bin_width), worth, out)
        return out


@njit(cache=True, fastmath=True, nogil=True)
def _distance(change, table, low, per_cell, worth, out):  # type: ignore[no-untyped-def]
    """The nearest bin's distance; beyond the grid, that of its border plus the way there."""
    height, width, _ = change.shape
    last, half, zero = np.float32(BINS - 1), np.float32(0.5), np.float32(0)
    r0, g0, b0 = low[0] * per_cell, low[1] * per_cell, low[2] * per_cell
    for y in range(height):
        for x in range(width):
            r = change[y, x, 0] * per_cell - r0
            g = change[y, x, 1] * per_cell - g0
            b = change[y, x, 2] * per_cell - b0
            i, j, k = min(max(r, zero), last), min(max(g, zero), last), min(max(b, zero), last)
            beyond = (r - i) * (r - i) + (g - j) * (g - j) + (b - k) * (b - k)
            nearest = (np.int32(i + half) * BINS + np.int32(j + half)) * BINS + np.int32(k + half)
            out[y, x] = table[nearest] + worth * np.sqrt(beyond)
