"""Causes that make a slope more uncertain than its step and place alone: one row for each cause, and its effect."""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.image.frame import DARK


class Cause(NamedTuple):
    """One cause of low confidence: its text and color in the command line, the plots and the live page.

    Attributes
    ----------
    sentence : sentence about the pixels that it is named for; "" if it is never named
    named_from : mm/mm, smallest standard deviation that it has to add to a slope to be named
    color : in pictures, "#rrggbb"
    """

    sentence: str
    named_from: float
    color: str


LEAVES_NOTHING = 0.35  # mm/mm, standard deviation that leaves no information; about the slope of a ball's rim
STEEP = 0.4  # mm/mm, of a slope 0.23 beyond those that presses have shown
SIX_SIGMA = 7.0  # mm/mm, standard deviation that a residual of 6 sigma adds; rims of real presses reach 5
# The colors are those of Okabe and Ito, distinct for every kind of color blindness; the last is not theirs.
CAUSES = {
    "saturated": Cause(
        "at the camera's upper end. Lower exposure, gain or the lights.", LEAVES_NOTHING, "#e69f00"
    ),
    "dark": Cause(
        "at the camera's lower end. Is a light off, or the exposure too short?", LEAVES_NOTHING, "#0072b2"
    ),
    "shadow": Cause("darker than any slope makes it: a cast shadow.", SIX_SIGMA, "#56b4e9"),
    "specular": Cause("brighter than any slope makes it: a mirrored light.", SIX_SIGMA, "#f0e442"),
    "off_gamut": Cause(
        "of colors that no slope gives: dust, a scratch, another gel, or slopes outside the training zone.",
        SIX_SIGMA,
        "#cc79a7",
    ),
    "steep": Cause("steeper than the presses have shown: at least about this slope.", STEEP, "#882255"),
    "inconsistent": Cause(
        "torn or from another moment: data of the frame were lost.", LEAVES_NOTHING, "#d55e00"
    ),
    "marker": Cause("hidden by markers.", LEAVES_NOTHING, "#999999"),
    "outside": Cause("not lit, or not gel.", LEAVES_NOTHING, "#009e73"),
    "wall": Cause("", LEAVES_NOTHING, "#000000"),  # an object's edge is no fault
    "light": Cause("", LEAVES_NOTHING, "#ffd8a8"),  # findings of the light name it
    "unit": Cause("", LEAVES_NOTHING, "#7f7f00"),  # the finding of a starter names it
    "compression": Cause(
        "noisier than the calibrated images. Raise the JPEG quality, or lower the camera's gain.",
        0.0,
        "#b08968",
    ),
}

LEAST_OUTSIDE_PX = 25  # smallest number of connected pixels; a smaller region is dust


def outside_of_gel(background: NDArray[Any]) -> NDArray[np.bool_] | None:
    """Pixels (H, W) of a background image without light, except regions as small as dust; None if there are none."""
    unlit = (np.asarray(background).max(axis=-1) <= DARK).astype(np.uint8)
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(unlit, connectivity=8)
    large = boxes[:, cv2.CC_STAT_AREA] >= LEAST_OUTSIDE_PX
    large[0] = False
    return large[labels] if count > 1 and large.any() else None


def either(one: NDArray[np.bool_] | None, other: NDArray[np.bool_] | None) -> NDArray[np.bool_] | None:
    """Union of two masks (H, W); a mask may be None, which means no pixel."""
    return one if other is None else other if one is None else one | other


JPEG_BLOCK_PX = 8
LEAST_BLOCKS = 4  # blocks across a frame; the medians over fewer columns are noise
EVERY_ROW = 4  # one of so many rows is used
USUAL_NOISE = (
    1.5  # times the calibrated images' noise; up to it noise is usual, because presses are no flat fields
)
LEAST_LEVELS = 1.0  # gray level, one step of the camera; less noise has no effect
# Standard deviation of a normal distribution over the mean |a - b| of two of its values: sqrt(pi)/2.
SIGMA_OF_JUMP = 0.8862
# Smallest jump between blocks over the usual jump.
JUMP_EXCESS = 1.15
_column_jumps = Kernel(
    "column_jumps", "u8[h,w,3] image, u8[h,w,3] rest, out i32[n] work, out f32[8] medians, i32 step"
)


def excess_noise(pixels: NDArray[np.uint8], rest: NDArray[np.uint8], usual_levels: float) -> float:
    """Noise of an image (H, W, 3) beyond the usual, gray levels: of single pixels, and of JPEG's blocks.

    Blocks of 8x8 pixels are rounded separately and jump at their borders. Such columns come every 8 pixels, at an offset
    that depends on the crop. The excess of their jumps over those of other columns is twice the blocks' variance.
    Pixels with an infinite usual deviation from the background image do not count.
    """
    width = pixels.shape[1]
    if (width - 1) // JPEG_BLOCK_PX < LEAST_BLOCKS:
        return 0.0
    medians = np.empty(JPEG_BLOCK_PX, dtype=np.float32)
    _column_jumps(pixels, rest, np.empty(4 * width, dtype=np.int32), medians, EVERY_ROW)
    by_place = sorted(medians.tolist())
    usual, most = (by_place[JPEG_BLOCK_PX // 2 - 1] + by_place[JPEG_BLOCK_PX // 2]) / 2, by_place[-1]
    single = SIGMA_OF_JUMP * usual
    blocks = SIGMA_OF_JUMP * sqrt(max(most**2 - usual**2, 0.0)) if most > JUMP_EXCESS * usual else 0.0
    added = sqrt(max(single**2 - (USUAL_NOISE * usual_levels) ** 2, 0.0) + blocks**2)
    return added if added > LEAST_LEVELS else 0.0


DARK_TO, SATURATED_FROM = 2, 254  # gray levels: up to the first and from the second a channel is clipped
BLOOMS_PX = 1  # px beyond the reach of the color change's blur

_clipped_channels = Kernel(
    "clipped_channels",
    "u8[h,w,3] image, bool[3] low, bool[3] high, out u8[h,w,3] clipped, i32 dark_to, i32 saturated_from",
)


class Clipped(NamedTuple):
    """The clipped parts of a frame that were not clipped in the images of the calibration.

    Attributes
    ----------
    channels : (H, W, 3) uint8, 1 where a channel is clipped or a clipped one blurred into it; None: nowhere
    unseen : (H, W) bool, pixels with too few channels left for two slopes; None: none
    """

    channels: NDArray[np.uint8] | None
    unseen: NDArray[np.bool_] | None


class ClippedChannels:
    """Finds clipped channels in frames of one calibration. It is immutable; threads can share it.

    Parameters
    ----------
    blur_px : of the color change
    learnt : (2, 3) bool, whether red, green, blue was clipped at the lower and the upper end in the calibration's own
        presses, so that the model learnt it; None: nowhere
    spare : number of channels that a slope can be read without: 1 with a forward response's step, else 0
    outside : (H, W) bool, pixels without light at rest, where dark is no fault; None: none
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
        """The clipped channels of an image (H, W, 3), without those of hidden pixels (H, W)."""
        channels = np.empty_like(pixels)
        low, high = self._counts
        if not _clipped_channels(pixels, low, high, channels, dark_to=DARK_TO, saturated_from=SATURATED_FROM):
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
    """Structuring element: the reach of a clipped pixel in a color change of that blur."""
    size = 2 * (int(np.ceil(2 * blur_px)) + BLOOMS_PX) + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)), dtype=np.uint8)


def ends_shown(images: NDArray[Any]) -> NDArray[np.float64]:
    """Share (2, 3) of pixels (N, 3) whose red, green, blue is at the lower and at the upper end."""
    levels = np.asarray(images)
    return np.stack([np.mean(levels <= DARK_TO, axis=0), np.mean(levels >= SATURATED_FROM, axis=0)])
