"""All checks of a frame: what they found, and which pixels say nothing."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.checks import value_range
from gelform.errors import CalibrationError
from gelform.findings import Finding
from gelform.frames import as_levels
from gelform.health.blocks import (
    BLOCK_PX,
    FLAT_RANGE,
    JUMP,
    LEAST_TORN,
    Blocks,
    Levels,
    Torn,
    blocks_from_image,
    torn_finding,
)

# Fraction of the frame: one of one colour is dark or saturated where that is an end of the range.
MOST_TORN = 0.95


_signs = Kernel(
    "health_signs",
    "u8[bh,bw,3] means, u8[bh,bw] ranges, i64[h] digests, f32[h] jumps, u8[bh,bw,3] dark_to, u8[bh,bw,3] saturated_from, "
    "out i32[n] work, out i32[4] signs, i32 flat, f32 jump",
)


@dataclass(frozen=True, eq=False)
class FrameFaults:
    """What is wrong with a frame.

    Attributes
    ----------
    image : (H, W, 3), with the untouched image in place of what is lost, so that nothing is read from it
    findings : `dark`, `saturated`, `torn` (figure: fraction of the frame), `frozen` (figure 1)
    lost : (H, W) bool, pixels that say nothing about the gel, a margin around torn parts included; None: there are none
    """

    image: NDArray[Any]
    findings: tuple[Finding, ...] = ()
    lost: NDArray[np.bool_] | None = None

    def hidden(self, markers: NDArray[np.bool_] | None) -> NDArray[np.bool_] | None:
        """Pixels (H, W) that markers hide or that are lost; None where there are neither."""
        if self.lost is None or markers is None:
            return markers if self.lost is None else self.lost
        return markers | self.lost

    def without_lost(self, known: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """What is known (H, W), without what is lost."""
        return known if self.lost is None else known & ~self.lost

    def widen(self, sigma: NDArray[np.float32] | None, least: float) -> None:
        """Raise a standard deviation (H, W), in place, to `least` where the frame is lost."""
        if self.lost is not None and sigma is not None:
            np.maximum(sigma, np.float32(least), out=sigma, where=self.lost)


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
        self._pixels = as_levels(background)
        rest = blocks_from_image(self._pixels, self._pixels)
        self._rest_digests = rest.row_digests
        self._levels = Levels(rest)
        self._torn = Torn(background, rest)

    def __call__(self, image: NDArray[Any]) -> FrameFaults:
        """The faults of an image (H, W, 3), RGB, 0-255, of the background's size."""
        blocks = blocks_from_image(as_levels(image), self._pixels)
        if self._is_background(blocks, image):
            message = "The frame is the background itself, pixel for pixel: frozen, or the background was given as a frame."
            return FrameFaults(image, (Finding("frozen", message, 1.0),))
        if self._is_plainly_sound(blocks):
            return FrameFaults(image)
        torn = self._torn(blocks, image)
        if torn is not None and torn.mean() > MOST_TORN and self._levels(blocks)[1] is not None:
            torn = None
        levels, clipped = self._levels(blocks, None if torn is None else blocks.centered_in(torn))
        if torn is None and clipped is None:
            return FrameFaults(image)
        lost = np.zeros(image.shape[:2], dtype=bool) if torn is None else _grown(torn)
        if clipped is not None:
            lost |= blocks.pixels(clipped, image.shape[1])
        findings = (*(() if torn is None else (torn_finding(torn),)), *levels)
        return FrameFaults(np.where(lost[..., None], self._pixels, image), findings, lost)

    def _is_plainly_sound(self, blocks: Blocks) -> bool:
        """Nothing is to be seen of what any of the faults begins with: nearly every frame, and a tenth of their time."""
        signs, rows = np.empty(4, dtype=np.int32), len(blocks.row_digests)
        work = np.empty(1 << rows.bit_length(), dtype=np.int32)
        digests, ends = blocks.row_digests, (self._levels.dark_to, self._levels.saturated_from)
        _signs(blocks.means, blocks.ranges, digests, blocks.row_jumps, *ends, work, signs, FLAT_RANGE, JUMP)
        flat, ending, repeated, jumping = signs.tolist()
        few_flat, few_repeated = flat <= LEAST_TORN * blocks.ranges.size, repeated <= LEAST_TORN * rows
        return few_flat and few_repeated and not ending and not jumping

    def _is_background(self, blocks: Blocks, image: NDArray[Any]) -> bool:
        if blocks.row_digests[0] != self._rest_digests[0]:
            return False
        return np.array_equal(image, self._background)


def check_untouched_image(image: NDArray[Any], calibrated: NDArray[Any]) -> None:
    """Refuse an untouched image (H, W, 3) in which parts are dark, saturated or torn against the calibration's.

    Raises
    ------
    CalibrationError
        The finding's own words are in the message.
    """
    faults = FrameHealth(calibrated)(image)
    if faults.lost is not None:
        raise CalibrationError(
            f"This background cannot be one: {faults.findings[0].message} Take it again, with nothing touching the gel."
        )


def _grown(lost: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """With a block's width around: blocks that were cut in two count too."""
    kernel = np.ones((2 * BLOCK_PX + 1,) * 2, dtype=np.uint8)
    grown: NDArray[np.bool_] = cv2.dilate(lost.view(np.uint8), kernel).view(np.bool_)
    return grown


@dataclass(frozen=True)
class DepthLimit:
    """The largest depth that is possible, mm.

    Attributes
    ----------
    limit_mm : the gel's thickness where that is known, else the shorter side of the field of view
    is_thickness : which of the two it is
    """

    limit_mm: float
    is_thickness: bool

    @classmethod
    def of(cls, shape: tuple[int, int], mm_per_px: float, thickness_mm: float | None = None) -> DepthLimit:
        """The limit of images (H, W) of square pixels."""
        if thickness_mm is not None:
            return cls(float(thickness_mm), True)
        return cls(min(shape) * float(mm_per_px), False)

    @property
    def ignorance_mm(self) -> float:
        """Standard deviation of a depth of which nothing but the limit is known: that of a uniform distribution."""
        return self.limit_mm / sqrt(12)

    def bound(self, depth_mm: NDArray[np.float32]) -> tuple[NDArray[np.float32], tuple[Finding, ...]]:
        """The depth (H, W) within plus and minus the limit, and a finding where it was not."""
        low, high = value_range(depth_mm)
        largest = max(high, -low)
        if largest <= self.limit_mm:
            return depth_mm, ()
        what = "the gel is thick" if self.is_thickness else "the field of view is wide"
        message = (
            f"Depth up to {largest:.3g} mm was read, more than {what} ({self.limit_mm:.3g} mm): cut there. "
            "The image does not fit the calibration; do not trust this depth."
        )
        limit = np.float32(self.limit_mm)
        return np.clip(depth_mm, -limit, limit), (Finding("beyond_gel", message, largest),)
