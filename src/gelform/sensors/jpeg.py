"""JPEG pictures of files and cameras: whether they are complete, their size, and their pixels at the needed size."""

from __future__ import annotations

import numpy as np
import simplejpeg
from numpy.typing import NDArray

from gelform.image.view.view import MAX_PIXELS

SIGNATURE = b"\xff\xd8\xff"
_START, _END = b"\xff\xd8", b"\xff\xd9"
# Bytes. For larger pictures only start and end are checked: drivers of cameras with megapixels leave stray bytes in them.
MAX_STRICT_BYTES = 100_000  # a 640x480 px picture of good quality
MAX_TORN = 10  # torn pictures in a row after which the camera is reopened
LEAST_SHAPE = (480, 640)  # px, smallest reduced frame: twice the size of the image that is reconstructed
_REDUCTIONS = (1, 2, 4, 8)  # factors that a JPEG decoder offers


def pixels_of_jpeg(content: bytes, reduction: int = 1, *, strict: bool = True) -> NDArray[np.uint8]:
    """The pixels (H, W, 3) uint8 RGB of a picture, each side divided by `reduction`, ignoring an orientation tag.

    With `strict`, every code must be readable and the codes must end where the bytes do; data after the end marker is
    ignored. Damage that leaves a valid file goes unnoticed, such as one number replaced by another with as many bits.

    ValueError: the picture is damaged or truncated; the message is the decoder's.
    """
    height, width = simplejpeg.decode_jpeg_header(content)[:2]
    if height * width > MAX_PIXELS:
        raise ValueError(f"its header states {height}x{width} px")
    least = {"min_height": -(-height // reduction), "min_width": -(-width // reduction)}
    decoded = simplejpeg.decode_jpeg(content, min_factor=reduction, strict=strict, **least)
    return np.asarray(decoded, dtype=np.uint8)


def is_gray_jpeg(content: bytes) -> bool:
    """Whether a picture has one channel; ValueError if its header is damaged."""
    return bool(simplejpeg.decode_jpeg_header(content)[2] == "Gray")


def jpeg_shape(content: bytes) -> tuple[int, int] | None:
    """(H, W) from the picture's header; None if there is no such header."""
    try:
        height, width = simplejpeg.decode_jpeg_header(content)[:2]
    except ValueError:
        return None
    return height, width


def reduction_of(shape: tuple[int, int]) -> int:
    """The reduction of frames (H, W) during decoding: 1, 2, 4 or 8.

    It is the largest one that leaves 480x640 px. Decoding an image of 8 megapixels to 612x816 takes a third of the time, and
    a sensor's image is no larger. It depends on the frame size alone, so that calibration and use agree.
    """
    fits = [n for n in _REDUCTIONS if shape[0] // n >= LEAST_SHAPE[0] and shape[1] // n >= LEAST_SHAPE[1]]
    return max(fits, default=1)


def image_from_jpeg(content: bytes, reduction: int = 1) -> NDArray[np.uint8] | None:
    """The pixels of a camera's picture (see `pixels_of_jpeg`); None if it is torn. Cameras may pad pictures with zeros."""
    strict = len(content) <= MAX_STRICT_BYTES
    if not strict and not (content.startswith(_START) and content.rstrip(b"\0").endswith(_END)):
        return None
    try:
        return pixels_of_jpeg(content, reduction, strict=strict)
    except ValueError:
        return None
