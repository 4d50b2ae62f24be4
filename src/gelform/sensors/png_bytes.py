"""The pixels of a PNG of the usual kind: OpenCV's reader takes 2.0 ms for 240x320 px, this one 1.6, and 0.9 with ISA-L."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.image.view.view import MAX_PIXELS

# The extra `png`: Intel's ISA-L decompresses to the same bytes in a quarter of the time.
inflate: Any = import_module("isal.isal_zlib") if find_spec("isal") else zlib
SIGNATURE = b"\x89PNG\r\n\x1a\n"
USUAL = (8, 2, 0, 0, 0)  # bits, RGB, compression, filters, no interlace
_png_rows = Kernel("png_rows", "u8[h,r] rows, u8[n] zeros, out u8[h,n] pixels")


def pixels_of_png(content: bytes) -> NDArray[np.uint8] | None:
    """RGB pixels (H, W, 3) of a PNG of 8-bit RGB without interlace and transparency; None for any other kind.

    Every chunk must match its checksum, up to the last one (PNG specification, section 5.3), and so must the compressed
    pixels.

    ValueError: it is truncated, damaged or too large.
    """
    chunks = list(_chunks(content))
    header = next((data for kind, data in chunks if kind == b"IHDR"), b"")
    if len(header) != 13:
        raise ValueError("it has no header")
    width, height = struct.unpack(">II", header[:8])
    if not 0 < width * height <= MAX_PIXELS:
        raise ValueError(f"its header states {height}x{width} px")
    if tuple(header[8:]) != USUAL or any(kind in (b"PLTE", b"tRNS") for kind, _ in chunks):
        return None
    size, stream = height * (3 * width + 1), inflate.decompressobj()
    try:
        rows = stream.decompress(b"".join(data for kind, data in chunks if kind == b"IDAT"), size + 1)
    except inflate.error as problem:
        raise ValueError("its pixels cannot be decompressed") from problem
    if len(rows) != size or not stream.eof:
        raise ValueError("it has fewer or more pixels than its header states")
    pixels = np.empty((height, 3 * width), dtype=np.uint8)
    filtered = np.frombuffer(rows, dtype=np.uint8).reshape(height, 3 * width + 1)
    if _png_rows(filtered, np.zeros(3 * width, dtype=np.uint8), pixels):
        raise ValueError("a row of its pixels has an unknown filter")
    return pixels.reshape(height, width, 3)


def _chunks(content: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Kind and data of each chunk before the last one; ValueError if one is damaged or missing."""
    position, kind = len(SIGNATURE), b""
    while kind != b"IEND":
        (length,) = struct.unpack(">I", content[position : position + 4].rjust(4, b"\xff"))
        end = position + 12 + length
        body = content[position + 4 : end - 4]
        if end > len(content) or zlib.crc32(body) != struct.unpack(">I", content[end - 4 : end])[0]:
            raise ValueError("a chunk of it does not match its checksum, or is missing")
        kind, position = body[:4], end
        yield kind, body[4:]
