"""Where and when something last touched the gel, with a generous margin around it."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

OUTLIER = 5.0  # deviations of noise
LEAST_CHANGE = 0.0025  # of a block's brightness: slopes of about 0.2 %
LONG_S, MOST_CHANGE = (
    10.0,
    0.01,
)  # what is slight is averaged for long; what is not must not stay in the average
MARGIN = 0.1  # of the image's shorter side: the gel is drawn down, and rises, around what touches it


class Touched:
    """When each block was last touched, or may have been.

    Parameters
    ----------
    blocks : (h, w), how many blocks
    """

    def __init__(self, blocks: tuple[int, int]) -> None:
        self._last_s = np.full(blocks, -np.inf)
        self._long = np.zeros((*blocks, 3), dtype=np.float32)
        reach = max(1, round(MARGIN * min(blocks)))
        self._kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1,) * 2)

    def see(
        self,
        time_s: float,
        step_s: float,
        contact: NDArray[np.bool_],
        change: NDArray[np.float32],
        rest: NDArray[np.float32],
    ) -> NDArray[np.bool_]:
        """The blocks (h, w) that may be touched at this time, margin included; remembered.

        A block may be touched where contact was seen in it, and where its brightness stands out among all blocks, in the
        last second or in the mean of some ten.

        Parameters
        ----------
        step_s : the time since the last call, s
        contact : (h, w), blocks in which contact was seen
        change : (h, w, 3), relative change of the blocks against the untouched image in today's light
        rest : (h, w, 3), that image, grey levels
        """
        slight = np.clip(change, -MOST_CHANGE, MOST_CHANGE)
        self._long += np.float32(-np.expm1(-step_s / LONG_S)) * (slight - self._long)
        touched = contact | _stands_out(change, rest) | _stands_out(self._long, rest)
        near: NDArray[np.bool_] = cv2.dilate(touched.astype(np.uint8), self._kernel).view(np.bool_)
        self._last_s[near] = time_s
        return near

    def everywhere(self, time_s: float) -> None:
        """Nobody looked: something may have touched anywhere."""
        self._last_s[:] = time_s

    def nowhere(self) -> None:
        """Forget all touches."""
        self._last_s[:] = -np.inf

    def not_since(self, time_s: float) -> NDArray[np.bool_]:
        """Blocks (h, w) that nothing has touched since."""
        return self._last_s < time_s


def _stands_out(change: NDArray[np.float32], rest: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Blocks (h, w) that changed by more than noise, which is alike in grey levels, and by more than drift."""
    size = np.abs(change)
    levels = size * rest
    noise = 1.4826 * np.median(levels, axis=(0, 1))
    odd = (levels > OUTLIER * noise) & (size > LEAST_CHANGE)
    return np.asarray(odd.any(axis=-1))
