"""Pictures from bytes and numbers: the declared size, complete JPEG, fast PNG, and values of a data set."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any, BinaryIO

import cv2
import numpy as np
import simplejpeg

from gelform._native import Kernel
from gelform.arrays import Array, Image
from gelform.errors import DataError, said
from gelform.image.view import MAX_PIXELS

JPEG = b"\xff\xd8\xff"
# Bytes. For larger pictures only start and end are checked: drivers of cameras with megapixels leave stray bytes in them.
MAX_STRICT_BYTES = 100_000  # a 640x480 px picture of good quality
MAX_TORN = 10  # torn pictures in a row after which the camera is reopened
LEAST_SHAPE = (480, 640)  # px, smallest reduced frame: twice the size of the image that is reconstructed


def pixels_of_jpeg(content: bytes, reduction: int = 1, *, strict: bool = True) -> Image:
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
    fits = [n for n in (1, 2, 4, 8) if shape[0] // n >= LEAST_SHAPE[0] and shape[1] // n >= LEAST_SHAPE[1]]
    return max(fits, default=1)


def image_from_jpeg(content: bytes, reduction: int = 1) -> Image | None:
    """The pixels of a camera's picture (see `pixels_of_jpeg`); None if it is torn. Cameras may pad pictures with zeros."""
    strict = len(content) <= MAX_STRICT_BYTES
    if not strict and not (content.startswith(b"\xff\xd8") and content.rstrip(b"\0").endswith(b"\xff\xd9")):
        return None
    try:
        return pixels_of_jpeg(content, reduction, strict=strict)
    except ValueError:
        return None


# The extra `png`: Intel's ISA-L decompresses to the same bytes in a quarter of the time.
inflate: Any = import_module("isal.isal_zlib") if find_spec("isal") else zlib
PNG = b"\x89PNG\r\n\x1a\n"
_png_rows = Kernel("png_rows", "u8[h,r] rows, u8[n] zeros, out u8[h,n] pixels")


def pixels_of_png(content: bytes) -> Image | None:
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
    usual = bytes((8, 2, 0, 0, 0))  # bits, RGB, compression, filters, no interlace
    if header[8:] != usual or any(kind in (b"PLTE", b"tRNS") for kind, _ in chunks):
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
    position, kind = len(PNG), b""
    while kind != b"IEND":
        (length,) = struct.unpack(">I", content[position : position + 4].rjust(4, b"\xff"))
        end = position + 12 + length
        body = content[position + 4 : end - 4]
        if end > len(content) or zlib.crc32(body) != struct.unpack(">I", content[end - 4 : end])[0]:
            raise ValueError("a chunk of it does not match its checksum, or is missing")
        kind, position = body[:4], end
        yield kind, body[4:]


MAX_PAGES = 10**6  # of a TIFF; 11 hours at 25 per second
_PPM = re.compile(rb"P[36](?:\s+|#[^\n]*\n)+(\d{1,9})(?:\s+|#[^\n]*\n)+(\d{1,9})\s")


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
        # One of three kinds: lossy, lossless, extended (WebP container specification).
        if content[12:16] == b"VP8 ":
            width, height = struct.unpack_from("<HH", content, 26)
            return height & 0x3FFF, width & 0x3FFF
        if content[12:16] == b"VP8L":
            (bits,) = struct.unpack_from("<I", content, 21)
            return (bits >> 14 & 0x3FFF) + 1, (bits & 0x3FFF) + 1
        return int.from_bytes(content[27:30], "little") + 1, int.from_bytes(content[24:27], "little") + 1
    found = _PPM.match(content[:4096])
    return None if found is None else (int(found.group(2)), int(found.group(1)))


def _of_tiff(content: bytes, order: str) -> tuple[int, int]:
    """(H, W) from the tags 257 and 256 of the first directory (TIFF 6.0, section 8)."""
    (start,) = struct.unpack_from(f"{order}I", content, 4)
    (count,) = struct.unpack_from(f"{order}H", content, start)
    sizes = {257: 0, 256: 0}
    for at in range(start + 2, start + 2 + 12 * count, 12):
        tag, kind = struct.unpack_from(f"{order}HH", content, at)
        if tag in sizes:
            (sizes[tag],) = struct.unpack_from(f"{order}{'H' if kind == 3 else 'I'}", content, at + 8)
    return sizes[257], sizes[256]


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


def image_from_values(values: Array | DataError, most_pixels: float = MAX_PIXELS) -> Image:
    """An RGB image (H, W, 3) uint8 from a dataset's values for one frame; DataError if they are no image.

    The values are (H, W, 3) or (3, H, W): uint8, whole numbers 0-255 as floats, or 0-1 as floats of such levels. Or (L,)
    uint8: a JPEG or PNG, padded with zeros.
    """
    if isinstance(values, DataError):
        raise values
    if values.ndim == 1 and values.dtype == np.uint8:
        try:
            check_declared(values.tobytes(), most_pixels)
        except ValueError as problem:
            raise DataError(f"{problem}.") from problem
        decoded = cv2.imdecode(values, cv2.IMREAD_COLOR) if len(values) else None
        if decoded is None:
            raise DataError("Expected a JPEG or PNG, got bytes that are no image.")
        return np.ascontiguousarray(decoded[..., ::-1], dtype=np.uint8)
    if values.ndim == 3 and values.shape[2] != 3 and values.shape[0] == 3:
        values = np.ascontiguousarray(np.moveaxis(values, 0, 2))
    if values.ndim != 3 or values.shape[2] != 3:
        raise DataError(f"Expected frames (H, W, 3) or (3, H, W), got {values.shape}.")
    if values.dtype == np.uint8:
        return values
    with np.errstate(invalid="ignore"):
        whole = values.astype(np.uint8)
    if np.array_equal(whole, values):
        return whole
    levels = np.rint(255 * values.astype(np.float64))
    # In float16 a level over 255 is off by 0.13 gray levels at most.
    if values.min() >= 0 and values.max() <= 1 and np.abs(levels - 255.0 * values).max() <= 0.13:
        return levels.astype(np.uint8)
    raise DataError(
        f"Expected whole numbers from 0 to 255, or such levels over 255, got {values.dtype} "
        f"{values.shape} from {values.min()} to {values.max()}. Write it as uint8."
    )


def is_npy(path: Path) -> bool:
    """Whether a path is an array file, by its name."""
    return path.suffix.lower() == ".npy"


def npy_values(path: Path, most_pixels: float = MAX_PIXELS) -> Array:
    """The array (H, W, 3) or (N, H, W, 3) of a `.npy` file, read from the disk where it is used; nothing is unpickled.

    DataError: it is missing, damaged, of another shape, or of larger frames.
    """
    if not path.is_file():
        raise DataError(f"No file {path}. Check the path.")
    try:
        values = np.load(path, mmap_mode="r", allow_pickle=False)
        shape = values.shape
    except Exception as problem:  # a damaged header fails in numpy's tokenizer in a dozen ways
        raise DataError(
            f"{path} is no array file (.npy) of numbers, or a damaged one: {said(problem)}."
        ) from problem
    if len(shape) not in (3, 4) or shape[-1] != 3 or 0 in shape or shape[-3] * shape[-2] > most_pixels:
        raise DataError(
            f"Expected RGB frames in {path}, an array (N, H, W, 3) or one image (H, W, 3) of at most "
            f"{most_pixels / 1e6:.4g} megapixels, got {shape}. Move the axis of the colors last."
        )
    return values


def image_of_npy(values: Array, where: str) -> Image:
    """An image (H, W, 3) uint8 from an array's values; DataError, naming `where`, if they are none."""
    try:
        return np.ascontiguousarray(image_from_values(np.asarray(values)))
    except DataError as problem:
        raise DataError(f"{where}: {problem}") from problem
