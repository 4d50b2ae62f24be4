"""The colours that a model was fitted on, and how far another colour is from them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # its parts load at first use
from numpy.typing import NDArray

from gelform._native import Kernel

BINS = 24
MARGIN = 0.25
OUTLIERS = 0.001

_gamut_distance = Kernel(
    "gamut_distance",
    "f32[h,w,3] change, f32[bins,bins,bins] table, f32[3] low, out f32[h,w] distance, f32 per_bin, f32 worth",
)


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
        away = worth * bin_width * np.maximum(scipy.ndimage.distance_transform_edt(~seen) - 1, 0)
        return cls(away.astype(np.float32), first.astype(np.float32), bin_width, worth)

    def distance_of(self, color_change: NDArray[np.float32]) -> NDArray[np.float32]:
        """Distance (H, W), as a slope, of the colours of a frame (H, W, 3) to those of the training presses."""
        out = np.empty(color_change.shape[:2], dtype=np.float32)
        worth = self.bin_width * self.slope_per_change
        _gamut_distance(color_change, self.distance, self.low, out, 1 / self.bin_width, worth)
        return out
