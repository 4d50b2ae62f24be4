"""Pictures as messages that robots' tools read: sensor_msgs/CompressedImage of ROS 2, in its encoding CDR.

CDR (OMG, DDS-XTypes 1.3, 7.4.1): numbers aligned to their size after a header of 4 bytes, here little-endian; texts and
arrays preceded by their length, texts with a zero at their end.
"""

from __future__ import annotations

import struct

SCHEMA_NAME, SCHEMA_ENCODING, MESSAGE_ENCODING = "sensor_msgs/msg/CompressedImage", "ros2msg", "cdr"
_LINE = "\n" + "=" * 80 + "\n"
SCHEMA = _LINE.join(
    [
        "std_msgs/Header header\nstring format\nuint8[] data",
        "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id",
        "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec",
    ]
)
_HEADER = b"\x00\x01\x00\x00"


def message_from_picture(content: bytes, picture_format: str, wall_time_ns: int, frame_id: str) -> bytes:
    """A message that holds a picture.

    Parameters
    ----------
    content : the bytes of a PNG or a JPEG
    picture_format : "png" or "jpeg"
    wall_time_ns : when it was taken, UTC
    frame_id : which camera
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
    """The picture's bytes, and when it was taken (UTC, ns); ValueError where the message is no such."""
    if message[:2] != _HEADER[:2]:
        raise ValueError("Expected a message in little-endian CDR.")
    try:
        seconds, nanoseconds = struct.unpack_from("<iI", message, 4)
        at = 8
        for _ in ("frame_id", "format"):
            at += -at % 4
            at += 4 + struct.unpack_from("<I", message, 4 + at)[0]
        at += -at % 4
        (length,) = struct.unpack_from("<I", message, 4 + at)
    except struct.error:
        raise ValueError("Expected a whole message, got a part of one.") from None
    content = message[8 + at : 8 + at + length]
    if len(content) != length:
        raise ValueError("Expected a whole message, got a part of one.")
    return content, seconds * 10**9 + nanoseconds
