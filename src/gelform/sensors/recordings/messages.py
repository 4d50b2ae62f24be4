"""Pictures as ROS 2 messages: sensor_msgs/CompressedImage and Image, encoded as CDR by rosbags."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.errors import needed

SCHEMA_NAME, SCHEMA_ENCODING, MESSAGE_ENCODING = "sensor_msgs/msg/CompressedImage", "ros2msg", "cdr"
RAW_SCHEMA_NAME = "sensor_msgs/msg/Image"
# Bytes of a pixel, and OpenCV's code for its conversion to RGB. The names are ROS's (image_encodings.hpp).
COLOR_ENCODINGS = {
    "rgb8": (3, None),
    "bgr8": (3, cv2.COLOR_BGR2RGB),
    "rgba8": (4, cv2.COLOR_RGBA2RGB),
    "bgra8": (4, cv2.COLOR_BGRA2RGB),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2RGB_YUY2),
    "yuv422": (2, cv2.COLOR_YUV2RGB_UYVY),
}
_ZSTD = b"\x28\xb5\x2f\xfd"


@cache
def typestore() -> Any:
    """Definitions of ROS 2's own messages; DataError, naming the extra `mcap`, if rosbags is not installed."""
    typesys = needed("rosbags.typesys", "mcap", "An MCAP file")
    return typesys.get_typestore(typesys.Stores.ROS2_JAZZY)


def header_of(store: Any, stamp_ns: int, frame_id: str) -> Any:
    """A std_msgs/Header of a time, UTC, and the name of a camera or a coordinate frame."""
    stamp = store.types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
    return store.types["std_msgs/msg/Header"](stamp, frame_id)


def schema_of_picture() -> bytes:
    """The definition of SCHEMA_NAME, as MCAP files have it."""
    definition: str = typestore().generate_msgdef(SCHEMA_NAME, ros_version=2)[0]
    return definition.encode()


def message_from_picture(content: bytes, picture_format: str, wall_time_ns: int, frame_id: str) -> bytes:
    """A message with a picture.

    Parameters
    ----------
    content : the bytes of a PNG or a JPEG
    picture_format : "png" or "jpeg"
    wall_time_ns : capture time, UTC
    frame_id : name of the camera
    """
    store = typestore()
    header = header_of(store, wall_time_ns, frame_id)
    picture = store.types[SCHEMA_NAME](header, picture_format, np.frombuffer(content, np.uint8))
    return bytes(store.serialize_cdr(picture, SCHEMA_NAME))


def picture_from_message(message: bytes) -> tuple[bytes, int]:
    """The picture's bytes and its time (UTC, ns); ValueError if the message is not of this type."""
    found = _decoded(message, SCHEMA_NAME)
    return found.data.tobytes(), _time_ns(found)


class RawImage(NamedTuple):
    """A sensor_msgs/Image whose pixels are not decoded yet."""

    wall_time_ns: int
    shape: tuple[int, int]
    encoding: str
    step: int
    data: NDArray[np.uint8]


def raw_image_from_message(message: bytes) -> RawImage:
    """The fields of a message with an uncompressed picture; ValueError if it is of another type."""
    found = _decoded(message, RAW_SCHEMA_NAME)
    return RawImage(_time_ns(found), (found.height, found.width), found.encoding, found.step, found.data)


def pixels_from_raw(image: RawImage) -> NDArray[np.uint8]:
    """The pixels (H, W, 3) uint8, RGB; ValueError for an encoding outside COLOR_ENCODINGS or inconsistent sizes."""
    if image.encoding not in COLOR_ENCODINGS:
        raise ValueError(
            f"Expected pictures in {' or '.join(COLOR_ENCODINGS)}, got {image.encoding}.{way_for_encoding(image.encoding)}"
        )
    height, width = image.shape
    size, code = COLOR_ENCODINGS[image.encoding]
    fits = image.step >= size * width and len(image.data) == height * image.step
    if not (height and width and fits) or (size == 2 and width % 2):
        raise ValueError(
            f"Expected {height} rows of {width} pixels, got {len(image.data)} bytes in rows of {image.step}."
        )
    rows = image.data.reshape(height, image.step)[:, : size * width]
    pixels = np.ascontiguousarray(rows.reshape(height, width, size))
    return pixels if code is None else np.asarray(cv2.cvtColor(pixels, code), dtype=np.uint8)


def way_for_encoding(encoding: str) -> str:
    """What to do with pictures of an encoding that is not read, after a space."""
    if encoding.startswith("bayer"):
        return " Each pixel has one color. Let image_proc make the others, and record its topic image_color."
    if encoding.startswith("mono"):
        return " Three lights need three channels: record the camera's topic in color."
    return " It does not say which channel is red: set the camera driver's encoding to rgb8 or bgr8 and record again."


def _decoded(message: bytes, kind: str) -> Any:
    from rosbags.serde import SerdeError

    if message[:4] == _ZSTD:
        raise ValueError("Its messages are compressed. Convert the bag without: ros2 bag convert.")
    try:
        return typestore().deserialize_cdr(message, kind)
    except SerdeError as problem:
        raise ValueError(f"Expected a whole message of {kind}: {problem}") from problem


def _time_ns(message: Any) -> int:
    return int(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)
