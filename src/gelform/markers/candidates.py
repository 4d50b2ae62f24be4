"""Places of an image where a dot could be: darker than what is around, by a dot's size."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

INNER, OUTER = 1.3, 3.6  # widths of the two boxes, of a dot's radius
LEAST = 0.35  # of the typical dot's response


class CandidateFinder:
    """Prepared for dots of one size and darkness.

    Parameters
    ----------
    logs : (H, W) float32, logarithm of the untouched image
    centers_px : (N, 2) its dots
    radius_px : of a dot
    """

    def __init__(self, logs: NDArray[np.float32], centers_px: NDArray[Any], radius_px: float) -> None:
        self._inner, self._outer = (max(1, round(share * radius_px)) | 1 for share in (INNER, OUTER))
        self._near = np.ones((max(3, round(radius_px) | 1),) * 2, dtype=np.uint8)
        column, row = np.rint(centers_px).astype(np.intp).T
        self._threshold = LEAST * float(np.median(self._response(logs)[row, column]))

    def __call__(self, logs: NDArray[np.float32]) -> NDArray[np.float32]:
        """Candidates (M, 2), x and y, to about a pixel."""
        response = self._response(logs)
        peaks = (response >= cv2.dilate(response, self._near)) & (response > self._threshold)
        row, column = np.nonzero(peaks)
        return np.stack([column, row], axis=-1).astype(np.float32)

    def _response(self, logs: NDArray[np.float32]) -> NDArray[np.float32]:
        inner, outer = (cv2.blur(logs, (size, size)) for size in (self._inner, self._outer))
        return np.asarray(outer - inner)
