"""Pictures from bytes and numbers: what is taken and what is refused, whole JPEG, fast PNG, values of a data set."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

import cv2
import numpy as np
import simplejpeg

from gelform._native import Kernel
from gelform.arrays import Array, Image
from gelform.errors import DataError, cannot, said
from gelform.foundations.files import refuse_pickled
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


def pixels_of_png(content: bytes | bytearray) -> Image | None:
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


def _chunks(content: bytes | bytearray) -> Iterator[tuple[bytes, bytes]]:
    """Kind and data of each chunk before the last one; ValueError if one is damaged or missing."""
    position, kind = len(PNG), b""
    while kind != b"IEND":
        (length,) = struct.unpack(">I", content[position : position + 4].rjust(4, b"\xff"))
        end = position + 12 + length
        body = content[position + 4 : end - 4]
        if end > len(content) or zlib.crc32(body) != struct.unpack(">I", content[end - 4 : end])[0]:
            raise ValueError("a chunk of it does not match its checksum, or is missing")
        kind, position = bytes(body[:4]), end
        yield kind, bytes(body[4:])


MAX_PAGES = 1_000_000  # of a TIFF; 11 hours at 25 per second
SIDE = 2**14 - 1  # bits of a side of a WebP
_PPM = re.compile(rb"P[36](?:\s+|#[^\n]*\n)+(\d{1,9})(?:\s+|#[^\n]*\n)+(\d{1,9})\s")


def check_declared(content: bytes | bytearray, most_pixels: float = MAX_PIXELS) -> None:
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


def declared_shape(content: bytes | bytearray) -> tuple[int, int] | None:
    """(H, W) from the header of a PNG, JPEG, BMP, TIFF, WebP or PPM; None for anything else.

    struct.error, IndexError: the header is cut.
    """
    if content.startswith(PNG):
        width, height = struct.unpack_from(">II", content, 16)
        return height, width
    if content.startswith(JPEG):
        return jpeg_shape(bytes(content))
    if content.startswith(b"BM"):
        width, height = struct.unpack_from("<ii", content, 18)
        return abs(height), abs(width)
    if content.startswith((b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")):
        tags = _tiff_tags(content)
        return tags.get(257, (0, 0))[0], tags.get(256, (0, 0))[0]
    if content[:4] == b"RIFF" and content[8:12] == b"WEBP":
        # One of three kinds: lossy, lossless, extended (WebP container specification).
        if content[12:16] == b"VP8 ":
            width, height = struct.unpack_from("<HH", content, 26)
            return height & SIDE, width & SIDE
        if content[12:16] == b"VP8L":
            (bits,) = struct.unpack_from("<I", content, 21)
            return (bits >> SIDE.bit_length() & SIDE) + 1, (bits & SIDE) + 1
        return int.from_bytes(content[27:30], "little") + 1, int.from_bytes(content[24:27], "little") + 1
    found = _PPM.match(content[:4096])
    return None if found is None else (int(found.group(2)), int(found.group(1)))


def _tiff_tags(content: bytes | bytearray) -> dict[int, tuple[int, int]]:
    """First value of each tag of the first directory, and the place of its bytes (TIFF 6.0, section 2; BigTIFF).

    struct.error: it is cut.
    """
    order, big = "<" if content.startswith(b"II") else ">", content[2:4] in (b"+\0", b"\0+")
    (start,) = struct.unpack_from(f"{order}{'Q' if big else 'I'}", content, 8 if big else 4)
    (count,) = struct.unpack_from(f"{order}{'Q' if big else 'H'}", content, start)
    step, first = _tiff_sizes(big)[0], start + _tiff_sizes(big)[1]
    tags: dict[int, tuple[int, int]] = {}
    for at in range(first, min(first + step * count, len(content)), step):
        tag, kind = struct.unpack_from(f"{order}HH", content, at)
        place = at + step - (8 if big else 4)
        tags[tag] = struct.unpack_from(f"{order}{'H' if kind == 3 else 'I'}", content, place)[0], place
    return tags


def _tiff_sizes(big: bool) -> tuple[int, int]:
    """Bytes of an entry (tag, kind, count, value) and of the number of entries before the first, classic or BigTIFF."""
    entry, number = ("=HHQQ", "=Q") if big else ("=HHII", "=H")
    return struct.calcsize(entry), struct.calcsize(number)


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
            file.seek(at + _tiff_sizes(big)[1] + _tiff_sizes(big)[0] * count)
            (at,) = struct.unpack(f"{order}{'Q' if big else 'I'}", file.read(8 if big else 4))
    except (struct.error, OSError, OverflowError, ValueError):
        pages = pages[:-1] or pages  # the last one is cut; the decoder says so of a lone one
    return tuple(pages)


def begin_tiff_at(content: bytearray, place: int) -> None:
    """Make a TIFF begin with the page at a place: readers of one picture take the first."""
    order, big = "<" if content[:2] == b"II" else ">", content[2:4] in (b"+\0", b"\0+")
    struct.pack_into(f"{order}{'Q' if big else 'I'}", content, 8 if big else 4, place)


IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".ppm")
COLOR_FRAMES = "Save the camera's color frames."
# What a picture may be that is no frame of a camera's red, green and blue with 8 bits each.
REFUSED = {
    "gray": f"Expected a color image, got a gray one: {{}}. Three lights need three channels. {COLOR_FRAMES}",
    "palette": "Expected 8 bits for each of red, green and blue, got a palette of up to 256 colors: {}. Slopes are read "
    "from small differences of color, which a palette rounds away. Save the camera's frames in full color.",
    "inks": f"Expected red, green and blue, got another color space, such as that of print (CMYK): {{}}. {COLOR_FRAMES}",
    "several": "Expected one image, got several, such as an animation: {}. Save each frame as an image, or all as a video.",
    "deep": "Expected 8-bit color, got more or fewer bits in {}. Save the camera's frames with 8 bits per channel (0-255).",
    "transparent": "Expected an image of three channels, got transparency (an alpha channel): {}. Save it without.",
}


def image_from_bytes(
    content: bytes | bytearray,
    name: str,
    most_pixels: float = MAX_PIXELS,
    *,
    alone: bool = True,
    hint: str = "",
) -> Image:
    """The pixels (H, W, 3) uint8 RGB of a PNG, JPEG, BMP, TIFF, WebP or PPM, as stored: an orientation tag is ignored.

    Zeros or other bytes after its end are ignored. `name` stands for it in errors, `hint` follows those about bytes that
    are no image. With `alone` a TIFF of several pages is refused.

    DataError: it is empty, no image, truncated or damaged, declares more than `most_pixels`, or is one of `REFUSED`.
    """
    if not content:
        raise DataError(f"{name} is empty. Copy or record it again.")
    try:
        check_declared(content, most_pixels)
    except ValueError as problem:
        raise DataError(f"{name}: {problem}. It is damaged, or no frame of this sensor.") from problem
    try:
        refused, usual = _refused_kind(content, alone), None
        if refused is None and content.startswith(PNG):
            usual = pixels_of_png(content)
        elif refused is None and content.startswith(JPEG):
            usual = pixels_of_jpeg(bytes(content))
    except (ValueError, struct.error, IndexError) as problem:
        why = str(problem).rstrip(".")
        raise DataError(f"{name} is truncated or damaged: {why}. Copy or record it again.") from None
    if refused is not None:
        raise DataError(REFUSED[refused].format(name))
    return _decoded(content, name, hint) if usual is None else usual


def _refused_kind(content: bytes | bytearray, alone: bool) -> str | None:
    """The key of `REFUSED` that a picture's header shows, or None; ValueError, struct.error, IndexError: it is damaged."""
    if content.startswith(PNG):
        kinds = {0: "gray", 3: "palette", 4: "gray"}  # PNG specification, 11.2.2
        animated = content.find(b"acTL", 0, content.find(b"IDAT")) > 0  # the pixels are not searched
        return "several" if animated else kinds.get(content[25])
    if content.startswith(JPEG):
        space = simplejpeg.decode_jpeg_header(bytes(content))[2]
        return {"Gray": "gray", "CMYK": "inks", "YCCK": "inks"}.get(space)
    if content.startswith(b"BM"):
        return "palette" if struct.unpack_from("<H", content, 28)[0] <= 8 else None
    if content[:4] == b"RIFF" and content[12:16] == b"VP8X":
        return "several" if content[20] & 2 else None
    if content.startswith((b"II", b"MM")):
        if alone and len(tiff_pages(BytesIO(content), 2)) > 1:
            return "several"
        tags = _tiff_tags(content)
        # Whether 0 is white or black, a palette, inks and others (TIFF 6.0, section 8).
        kinds = {0: "gray", 1: "gray", 3: "palette", 5: "inks", 8: "inks", 9: "inks", 10: "inks"}
        return kinds.get(tags.get(262, (2, 0))[0])
    return None


def _decoded(content: bytes | bytearray, name: str, hint: str) -> Image:
    """The pixels of what OpenCV reads of the kinds that `image_from_bytes` takes."""
    pixels = None
    starts = (PNG, JPEG, b"BM", b"II*\0", b"MM\0*", b"II+\0", b"MM\0+", b"RIFF", b"P6", b"P3", b"P5", b"P2")
    if content.startswith(starts):
        # How it should be turned.
        if content.startswith((b"II", b"MM")) and (place := _tiff_tags(content).get(274)):
            content = bytearray(content)
            struct.pack_into("<H" if content.startswith(b"II") else ">H", content, place[1], 1)
        try:
            with _opencv_silent():
                pixels = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
        except cv2.error as problem:
            raise DataError(f"{name} cannot be read as an image: {problem.err}.") from problem
    if pixels is None:
        kinds = ", ".join(suffix[1:].upper() for suffix in IMAGE_SUFFIXES)
        raise DataError(
            f"{name} is no image that can be read, or a damaged one. Expected one of {kinds}.{hint}"
        )
    channels = 1 if pixels.ndim == 2 else pixels.shape[2]
    refused = "deep" if pixels.dtype != np.uint8 else "gray" if channels < 3 else None
    if channels == 4 and (pixels[..., 3] != 255).any():
        refused = "transparent"
    if refused is not None:
        raise DataError(REFUSED[refused].format(name))
    return np.ascontiguousarray(pixels[..., 2::-1])


@contextmanager
def _opencv_silent() -> Iterator[None]:
    """Silence OpenCV's own messages on the terminal; our error reports the fault. Wheels of 4.x lack this switch."""
    logging = getattr(cv2.utils, "logging", None)
    if logging is None:
        yield
        return
    level = logging.getLogLevel()
    logging.setLogLevel(logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        logging.setLogLevel(level)


def image_from_values(values: Array | DataError, most_pixels: float = MAX_PIXELS) -> Image:
    """An RGB image (H, W, 3) uint8 from a dataset's values for one frame; DataError if they are no image.

    The values are (H, W, 3) or (3, H, W): uint8, whole numbers 0-255 as floats, or 0-1 as floats of such levels. Or (L,)
    uint8: the bytes of a picture as in `image_from_bytes`, padded with zeros.
    """
    if isinstance(values, DataError):
        raise values
    if values.ndim == 1 and values.dtype == np.uint8:
        return image_from_bytes(values.tobytes(), "An encoded picture", most_pixels)
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
    most = 255.0 * float(np.finfo(np.float16).epsneg)  # that a level over 255 is off in float16
    if values.min() >= 0 and values.max() <= 1 and np.abs(levels - 255.0 * values).max() <= most:
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
    with cannot(f"read {path}"), path.open("rb") as file:
        refuse_pickled(path, file.read(256))
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
