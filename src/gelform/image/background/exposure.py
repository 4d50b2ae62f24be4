"""Gain of each channel between a frame and the background image: exposure and white balance without touch.

Both images are averaged over about 1200 blocks. Exposure and white balance multiply a channel alike everywhere. A touch
turns the gel's surface, which changes the three channels differently from place to place. So the gain is where
the blocks' log ratios are densest, in all three channels at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform._native import Kernel
from gelform.foundations.checks import check_image
from gelform.image.frame import BRIGHT, DARK

BLOCKS = 1200  # blocks of an image: each averages out the noise and is smaller than a contact
# Largest distance from the gain, in logarithm, of a block that counts as at rest in each round.
HALF_WIDTHS_LOG = np.array([0.06, 0.04, 0.03, 0.02, 0.02, 0.02])
# Fraction of the image that agrees on the gain: above the first the gain counts in part, from the second on fully. Of real
# presses with less than the first, nothing can be told.
MIN_SHARE, FULL_SHARE = 0.07, 0.15
GAIN_SIGMA = (
    0.05  # standard deviation of an unknown gain: of a camera that is asked for a new background beyond 10 %
)

_means_of_bytes = Kernel(
    "means_of_bytes", "u8[h,w,3] image, i64 step, out u16[n] work, out f32[bh,bw,3] means"
)
_lit_ratios = Kernel(
    "lit_ratios", "f32[n,3] blocks, f32[n,3] untouched, f32 dark, f32 bright, out f32[most,3] ratios"
)
_crowd_of_ratios = Kernel(
    "crowd_of_ratios", "f32[n,3] logs, f64[rounds] half_widths, out f64[3] center, out f64[n] distances"
)


@dataclass(frozen=True)
class Exposure:
    """A frame's brightness relative to the background image.

    Attributes
    ----------
    gain : (3,) float64, R, G, B, or None
        Brightness of pixels at rest over that in the background image. None: no block counts, because each is dark or
        saturated in the image or in the background image.
    share : float, 0-1
        Part of the image that agrees on the gain to 2 %, in all three channels.
    least_change : float
        Distance from that gain of the quarter of the image that changed least; 0.01 is one per cent of its brightness.
        It is noise and small drift for a frame of this sensor, whatever touches it; it is more for another sensor.
    middle_change : float
        The same for the half that changed least, for comparing two background images.
    """

    gain: NDArray[np.float64] | None
    share: float
    least_change: float
    middle_change: float

    @property
    def is_known(self) -> bool:
        """Whether enough of the image agrees (7 %) to use the gain."""
        return self.share >= MIN_SHARE

    @property
    def believed_part(self) -> float:
        """Part of the gain's logarithm to compensate, 0-1: none if too little of the image agrees, all from 15 % on.

        In between it grows in proportion, so that the compensation never jumps from frame to frame.
        """
        return min(max((self.share - MIN_SHARE) / (FULL_SHARE - MIN_SHARE), 0.0), 1.0)

    @property
    def believed_gain(self) -> NDArray[np.float64]:
        """The gain to compensate, (3,): the believed part of it."""
        return (
            np.ones(3) if self.gain is None else np.asarray(self.gain**self.believed_part, dtype=np.float64)
        )

    @property
    def gain_sigma(self) -> float:
        """Standard deviation of the gain's logarithm from what is not compensated; 0 if all is."""
        return GAIN_SIGMA * (1 - self.believed_part)


def exposure_from_image(image: ArrayLike, background: ArrayLike) -> Exposure:
    """Gain of each channel between an image and the background image, from the pixels at rest.

    Parameters
    ----------
    image, background : (H, W, 3), RGB, 0-255

    Returns
    -------
    Exposure
        A large contact does not bias the gain, but can leave too few pixels at rest to measure it. Then
        `is_known` is False, and the gain must not be used.

    Raises
    ------
    ValueError, TypeError
        The image or the background is no (H, W, 3) of numbers in 0-255, or they differ in size.
    """
    untouched = check_image(background, name="background")
    pressed = check_image(image, shape=untouched.shape[:2])
    return exposure_from_blocks(block_means(pressed), block_means(untouched))


def block_means(image: NDArray[Any]) -> NDArray[np.float32]:
    """Means over about 1200 square blocks, (h, w, 3) float32."""
    height, width = image.shape[:2]
    step = max(1.0, (height * width / BLOCKS) ** 0.5)
    size = (max(1, round(width / step)), max(1, round(height / step)))
    block = width // size[0]  # OpenCV rounds halves up for 2x2 pixels, to even for more
    if image.dtype == np.uint8 and (height, width) == (block * size[1], block * size[0]) and 2 < block <= 256:
        means = np.empty((size[1], size[0], 3), dtype=np.float32)
        _means_of_bytes(np.ascontiguousarray(image), block, np.empty(3 * width, dtype=np.uint16), means)
        return means
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.float32)


def exposure_from_blocks(blocks: NDArray[np.float32], untouched: NDArray[np.float32]) -> Exposure:
    """`exposure_from_image` for images averaged by `block_means`."""
    ratios = np.empty((blocks.size // 3 + 1, 3), dtype=np.float32)
    lit = _lit_ratios(blocks.reshape(-1, 3), untouched.reshape(-1, 3), DARK, BRIGHT, ratios)
    if not lit:
        return Exposure(None, 0.0, np.inf, np.inf)
    logs = np.log(ratios[:lit])
    center, distances = np.empty(3), np.empty(len(logs))
    inside = _crowd_of_ratios(logs, HALF_WIDTHS_LOG, center, distances)
    quarter, half = len(distances) // 4, len(distances) // 2
    order = np.partition(distances, (quarter, half))
    return Exposure(np.exp(center), inside / (blocks.size // 3), float(order[quarter]), float(order[half]))
