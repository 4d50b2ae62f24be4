"""A frame: what one look of a camera gave, and when; and the identity of pixels."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.foundations.checks import check_image


@dataclass(frozen=True)
class Frame:
    """One picture of a camera, as it came.

    Attributes
    ----------
    image : (H, W, 3) uint8, RGB, before any view
    time_s : float
        Monotonic clock, for ages and rates.
    wall_time_ns : int
        UTC, for records.
    index : int
        Counts the frames of a source from 0; a gap is a dropped frame.
    encoded : the JPEG as the camera compressed it, for recorders; None where frames come uncompressed
    """

    image: NDArray[Any]
    time_s: float
    wall_time_ns: int
    index: int
    encoded: bytes | None = field(default=None, repr=False)


def pixels_digest(pixels: NDArray[Any]) -> str:
    """SHA-256 (hex) of an image's shape and bytes: how presses and backgrounds are recognised again.

    The same picture in another dtype has another digest.
    """
    return hashlib.sha256(repr(pixels.shape).encode() + np.ascontiguousarray(pixels).tobytes()).hexdigest()


def check_viewed_image(
    shape: tuple[int, int], frame_shape: tuple[int, int] | None, image: ArrayLike, name: str = "image"
) -> NDArray[Any]:
    """An RGB image of that shape, as `check_image`; where it has the shape of a frame, the message says so."""
    try:
        return check_image(image, shape=shape, name=name)
    except ValueError as problem:
        if getattr(image, "shape", ())[:2] != frame_shape or frame_shape == shape:
            raise
        hint = "It has the size of the camera's frames: image_from_frame(frame, calibration.view) first."
        raise ValueError(f"{problem} {hint}") from None


def as_levels(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Whole grey levels of an image (H, W, 3), uint8 or float 0-255, in C order: as a camera would have given it."""
    return np.ascontiguousarray(image if image.dtype == np.uint8 else np.rint(image).astype(np.uint8))


def whole_levels(image: NDArray[Any]) -> NDArray[Any]:
    """The image (H, W, 3), as uint8 where its floats 0-255 are all whole: the same picture gives the same bytes."""
    levels = as_levels(image)
    return levels if levels is image or np.array_equal(levels, image) else image
