"""The page's binary messages: a header and maps as bytes: depth as uint16, levels as uint8, the image raw or as JPEG.

A message is magic bytes, the header's length, the header as JSON, then the planes, each aligned to 8 bytes. There are two
encodings. `raw` is for a browser on the same machine, where bytes are cheap and time is not. `small` is for a network:
the image as JPEG, maps at half the resolution, packed with deflate.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.errors import DataError
from gelform.exchange.exporters.quantised import MM_PER_LEVEL, ZERO_LEVEL

ENCODINGS = ("raw", "small")
JPEG_QUALITY = 80  # of 100
LARGEST = 32767  # levels on either side of zero
MAGIC = b"GFL1"
ALIGNMENT = 8  # bytes, required by typed arrays in the browser


@dataclass(frozen=True)
class Plane:
    """A map's bytes.

    Attributes
    ----------
    facts : name, kind, height, width, packed; zero and step if its numbers are scaled
    data : the bytes
    """

    facts: dict[str, Any]
    data: bytes


def image_plane(image: NDArray[Any], encoding: str) -> Plane:
    """The image (H, W, 3) RGB, 0-255: `raw` bytes or a JPEG."""
    pixels = np.ascontiguousarray(image, dtype=np.uint8)
    if encoding == "raw":
        return _plane("image", "rgb", pixels)
    done, jpeg = cv2.imencode(".jpg", pixels[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if not done:
        raise DataError(f"OpenCV cannot encode an image of {pixels.shape[0]}x{pixels.shape[1]} px as JPEG.")
    return Plane(_facts("image", "jpeg", pixels.shape), jpeg.tobytes())


def depth_plane(depth: NDArray[np.float32], encoding: str, name: str = "depth") -> Plane:
    """Depth (H, W) as uint16 in steps of 1e-4 mm around 32768, or in larger steps if the range requires it.

    0 is never sent, because files use it for unknown pixels.
    """
    reach = float(np.abs(depth).max(initial=0.0))
    step = max(MM_PER_LEVEL, reach / LARGEST)
    levels = np.rint(depth * np.float32(1 / step)).astype(np.int32) + ZERO_LEVEL
    return _numbers(name, levels.clip(1, 65535).astype(np.uint16), encoding, zero=ZERO_LEVEL, step=step)


def level_plane(name: str, values: NDArray[Any], encoding: str, *, step: float = 1 / 255) -> Plane:
    """Values from 0 up (H, W) as uint8 in the given steps; values above 255 steps are clipped."""
    levels = np.rint(np.clip(values * np.float32(1 / step), 0, 255)).astype(np.uint8)
    return _numbers(name, levels, encoding, zero=0, step=step)


def bits_plane(name: str, bits: NDArray[Any], encoding: str) -> Plane:
    """Bit sets (H, W), uint8 or uint16; at lower resolution every second pixel."""
    return _numbers(name, bits, encoding, zero=0, step=1)


def _numbers(name: str, levels: NDArray[Any], encoding: str, *, zero: int, step: float) -> Plane:
    meaning = {"zero": zero, "step": step}
    if encoding == "raw":
        return _plane(name, f"u{8 * levels.itemsize}", levels, meaning)
    half = levels[::2, ::2]
    # Differences along rows are small on a smooth surface; they compress three times better.
    steps = np.diff(half, axis=1, prepend=half.dtype.type(0))
    data = zlib.compress(np.ascontiguousarray(steps).tobytes(), 1)
    return Plane(_facts(name, f"u{8 * levels.itemsize}", half.shape, packed=True) | meaning, data)


def _plane(name: str, kind: str, pixels: NDArray[Any], meaning: dict[str, Any] | None = None) -> Plane:
    return Plane(_facts(name, kind, pixels.shape) | (meaning or {}), np.ascontiguousarray(pixels).tobytes())


def _facts(name: str, kind: str, shape: tuple[int, ...], *, packed: bool = False) -> dict[str, Any]:
    return {"name": name, "kind": kind, "height": shape[0], "width": shape[1], "packed": packed}


def message(header: Mapping[str, Any], planes: Sequence[Plane]) -> bytes:
    """Bytes of a message.

    The header gains `planes`: for each its name, kind ("u8", "u16", "rgb", "jpeg"), height and width, whether it is packed
    ("deflate"), and `offset` and `length` in bytes from the end of the header. Number planes also have `zero` and
    `step`, with value = (number - zero) * step.
    """
    listed, at = [], 0
    for plane in planes:
        listed.append({**plane.facts, "offset": at, "length": len(plane.data)})
        at += _padded(len(plane.data))
    text = json.dumps({**header, "planes": listed}, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-(len(MAGIC) + 4 + len(text)) % ALIGNMENT)
    parts = [MAGIC, struct.pack("<I", len(text)), text]
    for plane in planes:
        parts += [plane.data, b"\0" * (_padded(len(plane.data)) - len(plane.data))]
    return b"".join(parts)


def read_message(data: bytes) -> tuple[dict[str, Any], dict[str, bytes]]:
    """The header and the bytes of each plane by name, for a client in Python.

    Raises
    ------
    DataError
        This is no such message, or it is truncated.
    """
    if data[:4] != MAGIC or len(data) < 8:
        raise DataError("Expected a message of gelform live, got other bytes.")
    start = 8 + struct.unpack("<I", data[4:8])[0]
    if start > len(data):
        raise DataError(f"Expected a header of {start - 8} bytes, got {len(data) - 8}.")
    header = json.loads(data[8:start])
    planes = {}
    for plane in header["planes"]:
        first = start + plane["offset"]
        planes[plane["name"]] = data[first : first + plane["length"]]
        if len(planes[plane["name"]]) != plane["length"]:
            raise DataError(f"Expected {plane['length']} bytes of {plane['name']}: the message is truncated.")
    return header, planes


def _padded(length: int) -> int:
    return length + (-length % ALIGNMENT)
