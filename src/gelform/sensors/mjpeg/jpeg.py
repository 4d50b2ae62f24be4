"""One JPEG picture of a camera: whether it is whole, its size, and its pixels at the size that is needed."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.sensors.jpeg_bytes import jpeg_fault

START, END = b"\xff\xd8", b"\xff\xd9"
MAX_READ_BYTES = 100_000  # 640x480 px at good quality: 3 ms
LEAST_SHAPE = (480, 640)  # of a reduced frame: twice what the path works on
FLAGS = {
    1: cv2.IMREAD_COLOR,
    2: cv2.IMREAD_REDUCED_COLOR_2,
    4: cv2.IMREAD_REDUCED_COLOR_4,
    8: cv2.IMREAD_REDUCED_COLOR_8,
}
# Markers without a length, and the frame headers that hold the size (ITU-T T.81, table B.1).
BARE = {0x01, *range(0xD0, 0xDA)}
FRAME_HEADERS = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}


def is_whole(content: bytes) -> bool:
    """Whether a picture has its start and its end; a small one also every code between them (see `jpeg_fault`).

    Cameras may pad pictures with zeros. Reading all codes of a large picture costs as much as decoding it.
    """
    if len(content) <= MAX_READ_BYTES:
        return jpeg_fault(content) is None
    return content.startswith(START) and content.rstrip(b"\0").endswith(END)


def jpeg_shape(content: bytes) -> tuple[int, int] | None:
    """(H, W) as the picture's header says it; None where there is no such header (ITU-T T.81, B.2.2)."""
    at = 2
    while at + 9 < len(content) and content[at] == 0xFF:
        marker = content[at + 1]
        if marker in FRAME_HEADERS:
            return (content[at + 5] << 8) + content[at + 6], (content[at + 7] << 8) + content[at + 8]
        length = 0 if marker in BARE else (content[at + 2] << 8) + content[at + 3]
        at += 1 if marker == 0xFF else 2 + length
    return None


def reduction_of(shape: tuple[int, int]) -> int:
    """By how much frames (H, W) are reduced while they are decoded: 1, 2, 4 or 8.

    The largest that leaves 480x640 px: an image of 8 megapixels decoded to 612x816 takes a third of the time, and a
    sensor's image is no larger. A function of the camera's frame alone, so that calibration and use agree.
    """
    fits = [n for n in FLAGS if shape[0] // n >= LEAST_SHAPE[0] and shape[1] // n >= LEAST_SHAPE[1]]
    return max(fits, default=1)


def image_from_jpeg(content: bytes, reduction: int = 1) -> NDArray[np.uint8] | None:
    """The pixels (H, W, 3) uint8 RGB of a picture, each side divided by `reduction`; None where it is torn.

    Not turned by an orientation tag: as the camera's rows lie.
    """
    if not is_whole(content):
        return None
    flag = FLAGS[reduction] | cv2.IMREAD_IGNORE_ORIENTATION
    pixels = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), flag)
    return None if pixels is None else np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB), dtype=np.uint8)
