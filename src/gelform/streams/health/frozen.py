"""Frozen: a camera that gives one image again and again."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.findings import Finding

FROZEN = "frozen"
FROZEN_S, FROZEN_FRAMES = 0.25, 3  # videos repeat a frame now and then; noise makes no two images alike
ROWS_APART = 16


class Frozen:
    """Counts for how long the images of a sequence have been the same, pixel for pixel."""

    def __init__(self) -> None:
        self._last: NDArray[Any] | None = None
        self._since_s = 0.0
        self._count = 0

    def __call__(self, image: NDArray[Any], time_s: float) -> tuple[Finding, ...]:
        """The finding `frozen` (figure: for how long, s) from the third equal image and 0.25 s on."""
        if self._last is None or not _equal(image, self._last) or time_s < self._since_s:
            self._last, self._since_s, self._count = image, time_s, 1
            return ()
        self._count += 1
        for_s = time_s - self._since_s
        if self._count < FROZEN_FRAMES or for_s < FROZEN_S:
            return ()
        message = (
            f"The camera has given the same image for {for_s:.1f} s: it hangs. Depth is that of the image."
        )
        return (Finding(FROZEN, message, for_s),)


def _equal(image: NDArray[Any], other: NDArray[Any]) -> bool:
    if image.shape != other.shape or not np.array_equal(image[::ROWS_APART], other[::ROWS_APART]):
        return False
    return np.array_equal(image, other)
