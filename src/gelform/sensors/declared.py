"""The size that a picture's file declares, read before any memory is used for its pixels."""

from __future__ import annotations

import re
import struct
from typing import BinaryIO

from gelform.image.view.view import MAX_PIXELS
from gelform.sensors.jpeg import SIGNATURE as JPEG
from gelform.sensors.jpeg import jpeg_shape
from gelform.sensors.png_bytes import SIGNATURE as PNG

MAX_PAGES = 10**6  # of a TIFF; 11 hours at 25 per second
_PPM = re.compile(rb"P[36](?:\s+|#[^\n]*\n)+(\d{1,9})(?:\s+|#[^\n]*\n)+(\d{1,9})\s")
_TIFF_WIDTH, _TIFF_HEIGHT = 256, 257  # tags of the first directory (TIFF 6.0, section 8)


def check_declared(content: bytes, most_pixels: float = MAX_PIXELS) -> None:
    """Refuse a picture that declares too many pixels.

    ValueError: it declares more than `most_pixels`. A header that cannot be read is the decoder's to refuse.
    """
    try:
        height, width = declared_shape(content) or (0, 0)
    except (struct.error, IndexError):
        return
    if height * width > most_pixels:
        raise ValueError(
            f"Expected a picture of at most {most_pixels / 1e6:.4g} megapixels, got one that states {height}x{width} px"
        )


def declared_shape(content: bytes) -> tuple[int, int] | None:
    """(H, W) from the header of a PNG, JPEG, BMP, TIFF, WebP or PPM; None for anything else.

    struct.error, IndexError: the header is cut.
    """
    if content.startswith(PNG):
        width, height = struct.unpack_from(">II", content, 16)
        return height, width
    if content.startswith(JPEG):
        return jpeg_shape(content)
    if content.startswith(b"BM"):
        width, height = struct.unpack_from("<ii", content, 18)
        return abs(height), abs(width)
    if content.startswith((b"II*\0", b"MM\0*")):
        return _of_tiff(content, "<" if content.startswith(b"II") else ">")
    if content[:4] == b"RIFF" and content[8:12] == b"WEBP":
        return _of_webp(content)
    found = _PPM.match(content[:4096])
    return None if found is None else (int(found.group(2)), int(found.group(1)))


def _of_tiff(content: bytes, order: str) -> tuple[int, int]:
    (start,) = struct.unpack_from(f"{order}I", content, 4)
    (count,) = struct.unpack_from(f"{order}H", content, start)
    sizes = {}
    for at in range(start + 2, start + 2 + 12 * count, 12):
        tag, kind = struct.unpack_from(f"{order}HH", content, at)
        if tag in (_TIFF_WIDTH, _TIFF_HEIGHT):
            (sizes[tag],) = struct.unpack_from(f"{order}{'H' if kind == 3 else 'I'}", content, at + 8)
    return sizes.get(_TIFF_HEIGHT, 0), sizes.get(_TIFF_WIDTH, 0)


def _of_webp(content: bytes) -> tuple[int, int]:
    """(H, W) of the three kinds: lossy, lossless, extended (WebP container specification)."""
    if content[12:16] == b"VP8 ":
        width, height = struct.unpack_from("<HH", content, 26)
        return height & 0x3FFF, width & 0x3FFF
    if content[12:16] == b"VP8L":
        (bits,) = struct.unpack_from("<I", content, 21)
        return (bits >> 14 & 0x3FFF) + 1, (bits & 0x3FFF) + 1
    return int.from_bytes(content[27:30], "little") + 1, int.from_bytes(content[24:27], "little") + 1


def tiff_pages(file: BinaryIO, most: int = MAX_PAGES) -> tuple[int, ...]:
    """Places of the directories of a TIFF's first pages, classic or BigTIFF; () for another file, and up to damage."""
    start = file.read(16)
    order = {b"II": "<", b"MM": ">"}.get(start[:2], "")
    big = start[2:4] in (b"+\0", b"\0+")
    if not order or not (big or start[2:4] in (b"*\0", b"\0*")):
        return ()
    pages: list[int] = []
    seen: set[int] = set()  # a damaged file may lead back
    try:
        (at,) = struct.unpack_from(f"{order}{'Q' if big else 'I'}", start, 8 if big else 4)
        while at and at not in seen and len(pages) < most:
            pages.append(at)
            seen.add(at)
            file.seek(at)
            (count,) = struct.unpack(f"{order}{'Q' if big else 'H'}", file.read(8 if big else 2))
            file.seek(at + (8 + 20 * count if big else 2 + 12 * count))
            (at,) = struct.unpack(f"{order}{'Q' if big else 'I'}", file.read(8 if big else 4))
    except (struct.error, OSError, OverflowError, ValueError):
        pages = pages[:-1] or pages  # the last one is cut; the decoder says so of a lone one
    return tuple(pages)


def begin_tiff_at(content: bytearray, place: int) -> None:
    """Make a TIFF begin with the page at a place: readers of one picture take the first."""
    order, big = "<" if content[:2] == b"II" else ">", content[2:4] in (b"+\0", b"\0+")
    struct.pack_into(f"{order}{'Q' if big else 'I'}", content, 8 if big else 4, place)
