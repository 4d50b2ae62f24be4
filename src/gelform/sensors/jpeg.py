"""JPEG pictures of files and cameras: whether they are whole, their size, and their pixels at the size that is needed."""

from __future__ import annotations

import numpy as np
import simplejpeg
from numpy.typing import NDArray

SIGNATURE = b"\xff\xd8\xff"
_START, _END = b"\xff\xd8", b"\xff\xd9"
# Larger pictures need their start and end only: drivers of cameras with millions of pixels leave stray bytes in them.
MAX_STRICT_BYTES = 100_000  # 640x480 px at good quality
MAX_TORN = 10  # torn pictures of a camera in a row after which it is opened anew
LEAST_SHAPE = (480, 640)  # px, of a reduced frame: twice what the path works on
_REDUCTIONS = (1, 2, 4, 8)  # that a JPEG decoder offers


def pixels_of_jpeg(content: bytes, reduction: int = 1, *, strict: bool = True) -> NDArray[np.uint8]:
    """The pixels (H, W, 3) uint8 RGB of a picture, each side divided by `reduction`, not turned by an orientation tag.

    With `strict`, every code has to be readable and to end where the bytes do; what follows the end is no concern.
    Damage that leaves a valid file cannot be seen: a number changed into another of as many bits.

    ValueError: the picture is damaged or cut, in the decoder's words.
    """
    height, width = simplejpeg.decode_jpeg_header(content)[:2]
    least = {"min_height": -(-height // reduction), "min_width": -(-width // reduction)}
    decoded = simplejpeg.decode_jpeg(content, min_factor=reduction, strict=strict, **least)
    return np.asarray(decoded, dtype=np.uint8)


def is_grey_jpeg(content: bytes) -> bool:
    """Whether a picture has one channel; ValueError where its header is damaged."""
    return bool(simplejpeg.decode_jpeg_header(content)[2] == "Gray")


def jpeg_shape(content: bytes) -> tuple[int, int] | None:
    """(H, W) as the picture's header says it; None where there is no such header."""
    try:
        height, width = simplejpeg.decode_jpeg_header(content)[:2]
    except ValueError:
        return None
    return height, width


def reduction_of(shape: tuple[int, int]) -> int:
    """By how much frames (H, W) are reduced while they are decoded: 1, 2, 4 or 8.

    The largest that leaves 480x640 px: an image of 8 megapixels decoded to 612x816 takes a third of the time, and a
    sensor's image is no larger. A function of the camera's frame alone, so that calibration and use agree.
    """
    fits = [n for n in _REDUCTIONS if shape[0] // n >= LEAST_SHAPE[0] and shape[1] // n >= LEAST_SHAPE[1]]
    return max(fits, default=1)


def image_from_jpeg(content: bytes, reduction: int = 1) -> NDArray[np.uint8] | None:
    """The pixels of a camera's picture (see `pixels_of_jpeg`); None where it is torn. Cameras may pad with zeros."""
    strict = len(content) <= MAX_STRICT_BYTES
    if not strict and not (content.startswith(_START) and content.rstrip(b"\0").endswith(_END)):
        return None
    try:
        return pixels_of_jpeg(content, reduction, strict=strict)
    except ValueError:
        return None
