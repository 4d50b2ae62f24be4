"""Clipped channels: at an end of the camera's range, and not so in the images that the calibration was made from."""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel

DARK_TO, SATURATED_FROM = 2, 254  # grey levels from which a channel counts as clipped
BLOOMS_PX = 1  # further than the color change's blur reaches

_clipped_channels = Kernel(
    "clipped_channels",
    "u8[h,w,3] image, bool[3] low, bool[3] high, out u8[h,w,3] clipped, i32 dark_to, i32 saturated_from",
)


class Clipped(NamedTuple):
    """Of one frame.

    Attributes
    ----------
    channels : (H, W, 3) uint8, 1 where a channel is clipped or a clipped one blurred into it; None: nowhere
    unseen : (H, W) bool, where too few channels are left for two slopes; None: nowhere
    """

    channels: NDArray[np.uint8] | None
    unseen: NDArray[np.bool_] | None


class ClippedChannels:
    """Finds them in frames of one calibration; immutable, shared by threads.

    Parameters
    ----------
    blur_px : of the color change
    learnt : (2, 3) bool, red, green, blue at the lower and the upper end in the calibration's own presses: what was learnt
        holds there; None: nowhere
    spare : channels that a slope can be read without: 1 where there is a forward response's step, else 0
    outside : (H, W) bool, where no light comes at rest: dark there is no fault; None: nowhere
    """

    def __init__(
        self,
        blur_px: float,
        learnt: NDArray[np.bool_] | None,
        spare: int,
        outside: NDArray[np.bool_] | None = None,
    ) -> None:
        usual = np.ones((2, 3), dtype=bool) if learnt is None else ~np.asarray(learnt, dtype=bool)
        self._counts, self._spare = [np.ascontiguousarray(row) for row in usual], spare
        self._outside = outside
        self._disc = bloom_disc(blur_px)

    def __call__(self, pixels: NDArray[np.uint8], hidden: NDArray[np.bool_] | None) -> Clipped:
        """The clipped channels of an image (H, W, 3), but for those of hidden pixels (H, W), which reach nowhere."""
        channels = np.empty_like(pixels)
        if not _clipped_channels(pixels, *self._counts, channels, DARK_TO, SATURATED_FROM):
            return Clipped(None, None)
        for nothing in (hidden, self._outside):
            if nothing is not None:
                channels[nothing] = 0
        if not channels.any():
            return Clipped(None, None)
        channels = np.asarray(cv2.dilate(channels, self._disc), dtype=np.uint8)
        unseen = channels.sum(axis=-1, dtype=np.uint8) > self._spare
        return Clipped(channels, unseen)


def bloom_disc(blur_px: float) -> NDArray[np.uint8]:
    """Structuring element of how far a clipped pixel reaches in a color change of that blur."""
    size = 2 * (int(np.ceil(2 * blur_px)) + BLOOMS_PX) + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)), dtype=np.uint8)


def ends_shown(images: NDArray[Any]) -> NDArray[np.float64]:
    """Share (2, 3) of pixels (N, 3) whose red, green, blue is at the lower and at the upper end."""
    levels = np.asarray(images)
    return np.stack([np.mean(levels <= DARK_TO, axis=0), np.mean(levels >= SATURATED_FROM, axis=0)])
