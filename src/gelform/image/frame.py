"""Frame: one picture of a camera, with its time; and digests of pixels."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gelform.arrays import Array
from gelform.foundations.checks import check_number

# Gray levels, of means of pixels: a channel below or above says nothing of slopes, at either end of a camera's range.
DARK, BRIGHT = 8, 250


@dataclass(frozen=True)
class Frame:
    """One picture of a camera, unchanged.

    Attributes
    ----------
    image : (H, W, 3) uint8, RGB, before any view
    time_s : float
        Time of capture on the monotonic clock, for ages and rates.
    wall_time_ns : int
        Time of capture in UTC, for records.
    index : int
        Number of the frame in its source, from 0; a gap is a dropped frame.
    encoded : the camera's own JPEG, for recorders; None if frames arrive uncompressed
    """

    image: Array
    time_s: float
    wall_time_ns: int
    index: int
    encoded: bytes | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        for name in ("time_s", "wall_time_ns", "index"):
            if not math.isfinite(check_number(getattr(self, name), name)):
                raise ValueError(f"Expected a finite {name} of the frame, got {getattr(self, name)}.")


def pixels_digest(pixels: Array) -> str:
    """SHA-256 (hex) of an image's shape and bytes, which identifies presses and backgrounds.

    The same picture in another dtype has another digest.
    """
    return hashlib.sha256(repr(pixels.shape).encode() + np.ascontiguousarray(pixels).tobytes()).hexdigest()


def as_levels(image: Array) -> NDArray[np.uint8]:
    """An image (H, W, 3), uint8 or float 0-255, in whole gray levels and C order, as a camera would give it."""
    return np.ascontiguousarray(image if image.dtype == np.uint8 else np.rint(image).astype(np.uint8))


def whole_levels(image: Array) -> Array:
    """The image (H, W, 3) as uint8 if its floats 0-255 are all whole, so that the same picture has the same bytes."""
    levels = as_levels(image)
    return levels if levels is image or np.array_equal(levels, image) else image


def rgb_from_bgr(image: Array) -> Array:
    """An image (H, W, 3) whose channels are blue, green, red, in RGB."""
    return np.ascontiguousarray(image[..., ::-1])


def in_rgb(frame: Frame) -> Frame:
    """A frame that came as blue, green, red; the camera's JPEG is left out, because its colors are the wrong ones."""
    return replace(frame, image=rgb_from_bgr(frame.image), encoded=None)
