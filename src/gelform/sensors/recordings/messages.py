"""Pictures as ROS 2 messages: sensor_msgs/CompressedImage and Image, encoded as CDR.

CDR (OMG, DDS-XTypes 1.3, 7.4.1) starts with a header of 4 bytes. Numbers are aligned to their size and little-endian
here. Texts and arrays start with their length; texts end with a zero byte.
"""

from __future__ import annotations

import struct
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

SCHEMA_NAME, SCHEMA_ENCODING, MESSAGE_ENCODING = "sensor_msgs/msg/CompressedImage", "ros2msg", "cdr"
_LINE = "\n" + "=" * 80 + "\n"
SCHEMA = _LINE.join(
    [
        "std_msgs/Header header\nstring format\nuint8[] data",
        "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id",
        "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec",
    ]
)
RAW_SCHEMA_NAME = "sensor_msgs/msg/Image"
COLOR_ENCODINGS = ("rgb8", "bgr8")
_HEADER = b"\x00\x01\x00\x00"
_ZSTD = b"\x28\xb5\x2f\xfd"


def message_from_picture(content: bytes, picture_format: str, wall_time_ns: int, frame_id: str) -> bytes:
    """A message with a picture.

    Parameters
    ----------
    content : the bytes of a PNG or a JPEG
    picture_format : "png" or "jpeg"
    wall_time_ns : capture time, UTC
    frame_id : name of the camera
    """
    seconds, nanoseconds = divmod(wall_time_ns, 10**9)
    body = bytearray(struct.pack("<iI", seconds, nanoseconds))
    for text in (frame_id, picture_format):
        body += bytes(-len(body) % 4)
        code = text.encode() + b"\0"
        body += struct.pack("<I", len(code)) + code
    body += bytes(-len(body) % 4)
    return b"".join((_HEADER, body, struct.pack("<I", len(content)), content))


def picture_from_message(message: bytes) -> tuple[bytes, int]:
    """The picture's bytes and its time (UTC, ns); ValueError if the message is not of this type."""
    reader = _Fields(message)
    wall_time_ns = reader.time_ns()
    for _ in ("frame_id", "format"):
        reader.content()
    return reader.content(), wall_time_ns


class RawImage(NamedTuple):
    """A sensor_msgs/Image whose pixels are not decoded yet."""

    wall_time_ns: int
    shape: tuple[int, int]
    encoding: str
    step: int
    data: bytes


def raw_image_from_message(message: bytes) -> RawImage:
    """The fields of a message with an uncompressed picture; ValueError if it is of another type."""
    reader = _Fields(message)
    wall_time_ns = reader.time_ns()
    reader.content()  # frame_id
    shape = (reader.number(), reader.number())
    encoding = reader.content().rstrip(b"\0").decode(errors="replace")
    reader.at += 1  # is_bigendian: irrelevant for bytes
    return RawImage(wall_time_ns, shape, encoding, reader.number(), reader.content())


def pixels_from_raw(image: RawImage) -> NDArray[np.uint8]:
    """The pixels (H, W, 3) uint8, RGB; ValueError for an encoding outside COLOR_ENCODINGS or inconsistent sizes."""
    if image.encoding not in COLOR_ENCODINGS:
        raise ValueError(f"Expected pictures in {' or '.join(COLOR_ENCODINGS)}, got {image.encoding}.")
    height, width = image.shape
    if not (height and width) or image.step < 3 * width or len(image.data) != height * image.step:
        raise ValueError(
            f"Expected {height} rows of {width} pixels, got {len(image.data)} bytes in rows of {image.step}."
        )
    rows = np.frombuffer(image.data, np.uint8).reshape(height, image.step)
    pixels = rows[:, : 3 * width].reshape(height, width, 3)
    return np.ascontiguousarray(pixels if image.encoding == "rgb8" else pixels[..., ::-1])


class _Fields:
    """The fields of a message in order; ValueError if the message ends too early."""

    def __init__(self, message: bytes) -> None:
        if message[:4] == _ZSTD:
            raise ValueError("Its messages are compressed. Convert the bag without: ros2 bag convert.")
        if message[:2] != _HEADER[:2]:
            raise ValueError("Expected a message in little-endian CDR.")
        self._message, self.at = message, 0

    def _unpacked(self, form: str) -> tuple[Any, ...]:
        self.at += -self.at % 4
        try:
            values = struct.unpack_from(form, self._message, len(_HEADER) + self.at)
        except struct.error:
            raise ValueError("Expected a whole message, got a part of one.") from None
        self.at += struct.calcsize(form)
        return values

    def time_ns(self) -> int:
        seconds, nanoseconds = self._unpacked("<iI")
        return int(seconds * 10**9 + nanoseconds)

    def number(self) -> int:
        return int(self._unpacked("<I")[0])

    def content(self) -> bytes:
        """A text with its zero byte, or an array."""
        length = self.number()
        start = len(_HEADER) + self.at
        content = self._message[start : start + length]
        if len(content) != length:
            raise ValueError("Expected a whole message, got a part of one.")
        self.at += length
        return content
