"""Color change around a contact over that inside it: large for soft objects, and for contacts beyond the view."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.image.background.change import CHANGE_OFFSET

ROWS = 40  # of the coarse images; the measure is one of large areas
REACH = 1  # coarse pixels that the contact is widened by


class Surround:
    """Compares the color around a contact with that inside it, for the images of one background (H, W, 3), 0-255.

    The images are as they came: correcting the exposure would hide the change of light around a large soft contact.
    """

    def __init__(self, background: NDArray[np.float32]) -> None:
        height, width = background.shape[:2]
        step = max(1, height // ROWS)
        self._size = width // step, height // step
        rest = self._coarse(np.asarray(background, dtype=np.float32))
        self._gain = 1 / (rest + np.float32(CHANGE_OFFSET))
        self._at_rest = rest * self._gain
        self._widened = np.ones((2 * REACH + 1,) * 2, dtype=np.uint8)

    def __call__(self, image: NDArray[np.number], contact: NDArray[np.bool_]) -> float | None:
        """Median change outside a contact (H, W), over its mean inside; None if there is no inside or no outside."""
        inside = cv2.resize(contact.view(np.uint8), self._size, interpolation=cv2.INTER_NEAREST)
        outside = cv2.dilate(inside, self._widened) == 0
        if not inside.any() or not outside.any():
            return None
        change = self._coarse(image)
        change *= self._gain
        change -= self._at_rest
        change *= change
        square = change @ np.ones(change.shape[-1], dtype=np.float32)
        within = float(np.sqrt(square[inside > 0]).mean())
        around = square[outside]
        middle = len(around) // 2
        return float(np.sqrt(np.partition(around, middle)[middle])) / within if within > 0 else None

    def _coarse(self, image: NDArray[np.number]) -> NDArray[np.float32]:
        # Means of four pixels: a mean of all would take thirty times as long, and the measures are of large areas.
        return np.asarray(cv2.resize(image, self._size), dtype=np.float32)
