"""All checks of a frame: what they found, and which pixels say nothing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.background.check import Finding
from gelform.health.blocks import BLOCK_PX, Blocks, blocks_from_image, pixels_from_image
from gelform.health.levels import Levels
from gelform.health.torn import Torn, torn_finding

MOST_TORN = 0.95  # a frame of one colour is dark or saturated where that colour is an end of the range


@dataclass(frozen=True)
class FrameFaults:
    """What is wrong with a frame.

    Attributes
    ----------
    findings : `dark`, `saturated`, `torn` (figure: share of the frame), `frozen` (figure 1)
    lost : (H, W) bool, pixels that say nothing about the gel, a margin around torn parts included; None: there are none
    """

    findings: tuple[Finding, ...] = ()
    lost: NDArray[np.bool_] | None = None

    @property
    def all_is_lost(self) -> bool:
        """Not one pixel is left to measure with."""
        return self.lost is not None and bool(self.lost.all())


SOUND = FrameFaults()


class FrameHealth:
    """Looks for faults of frames of one sensor; prepared once, immutable, shared by threads.

    A pure function of the frame: what needs memory, such as a camera that gives one image again and again, belongs to a
    stream. Here only the untouched image itself is known again.

    Parameters
    ----------
    background : (H, W, 3), 0-255, the untouched image
    """

    def __init__(self, background: NDArray[Any]) -> None:
        self._background = background
        self._pixels = pixels_from_image(background)
        rest = blocks_from_image(self._pixels, self._pixels)
        self._rest_digests = rest.row_digests
        self._levels = Levels(rest)
        self._torn = Torn(background, rest)

    def __call__(self, image: NDArray[Any]) -> FrameFaults:
        """The faults of an image (H, W, 3), RGB, 0-255, of the background's size."""
        blocks = blocks_from_image(pixels_from_image(image), self._pixels)
        if self._is_background(blocks, image):
            message = "The frame is the background itself, pixel for pixel: frozen, or the background was given as a frame."
            return FrameFaults((Finding("frozen", message, 1.0),))
        torn = self._torn(blocks, image)
        if torn is not None and torn.mean() > MOST_TORN and self._levels(blocks)[1] is not None:
            torn = None
        levels, clipped = self._levels(blocks, None if torn is None else blocks.centered_in(torn))
        if torn is None and clipped is None:
            return SOUND
        lost = np.zeros(image.shape[:2], dtype=bool) if torn is None else _grown(torn)
        if clipped is not None:
            lost |= blocks.pixels(clipped, image.shape[1])
        return FrameFaults((*(() if torn is None else (torn_finding(torn),)), *levels), lost)

    def _is_background(self, blocks: Blocks, image: NDArray[Any]) -> bool:
        if blocks.row_digests[0] != self._rest_digests[0]:
            return False
        return np.array_equal(image, self._background)


def _grown(lost: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """With a block's width around: blocks that were cut in two count too."""
    kernel = np.ones((2 * BLOCK_PX + 1,) * 2, dtype=np.uint8)
    grown: NDArray[np.bool_] = cv2.dilate(lost.view(np.uint8), kernel).view(np.bool_)
    return grown
