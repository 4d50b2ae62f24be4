"""One message: magic bytes, the header's length, the header as JSON, then the planes, each aligned to 8 bytes."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from typing import Any

from gelform.errors import DataError
from gelform.live.wire.planes import Plane

MAGIC = b"GFL1"
ALIGNMENT = 8


def message(header: Mapping[str, Any], planes: Sequence[Plane]) -> bytes:
    """Bytes of a message.

    The header gains `planes`: for each its name, kind ("u8", "u16", "rgb", "jpeg"), height and width, whether it is
    packed ("deflate") and `offset` and `length` in bytes from the end of the header; for numbers also `zero` and
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
    """The header and the bytes of each plane by name: what a client in Python reads.

    Raises
    ------
    DataError
        No such message, or a truncated one.
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
