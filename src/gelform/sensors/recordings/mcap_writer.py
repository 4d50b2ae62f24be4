"""Frames into an MCAP file, as ROS 2 messages; it stays readable whenever the recorder stops, even if it is killed."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from gelform.arrays import Image
from gelform.errors import DataError, needed
from gelform.image.frame import Frame
from gelform.sensors.playback import ATTACHABLE, RecordingFacts, encoded_from_frame

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


def message_from_picture(content: bytes, picture_format: str, wall_time_ns: int, frame_id: str) -> bytes:
    """A message with the bytes of a "png" or a "jpeg", its capture time (UTC) and the name of its camera."""
    store = typestore()
    header = header_of(store, wall_time_ns, frame_id)
    picture = store.types[SCHEMA_NAME](header, picture_format, np.frombuffer(content, np.uint8))
    return bytes(store.serialize_cdr(picture, SCHEMA_NAME))


def decoded(message: bytes, kind: str) -> Any:
    """The message of a kind (SCHEMA_NAME, RAW_SCHEMA_NAME), with its fields; ValueError if it is not of this kind."""
    from rosbags.serde import SerdeError

    if message[:4] == _ZSTD:
        raise ValueError("Its messages are compressed. Convert the bag without: ros2 bag convert.")
    try:
        return typestore().deserialize_cdr(message, kind)
    except SerdeError as problem:
        raise ValueError(f"Expected a whole message of {kind}: {problem}") from problem


def time_ns_of(message: Any) -> int:
    """The time of a message with a header, UTC, ns."""
    return int(message.header.stamp.sec * 10**9 + message.header.stamp.nanosec)


def pixels_from_raw(image: Any) -> Image:
    """The pixels (H, W, 3), RGB, of a sensor_msgs/Image; ValueError for other encodings, or inconsistent sizes."""
    if image.encoding not in COLOR_ENCODINGS:
        raise ValueError(
            f"Expected pictures in {' or '.join(COLOR_ENCODINGS)}, got {image.encoding}.{way_for_encoding(image.encoding)}"
        )
    height, width = image.height, image.width
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


TOPIC, METADATA = "/gelform/image/compressed", "gelform"
FLUSH_S = 0.5  # s of frames that a killed recorder loses


class McapRecording:
    """An MCAP file that is being written.

    Frames are gathered in chunks of half a second, each with its checksum and index, and handed to the system at once. A
    recorder that is killed loses the last half second. Time stamps start as UTC and advance with the monotonic clock of
    `Frame.time_s`, so that a change of the system clock does not shift them.

    The path is a new file's, the facts are the camera's, and `attached` are files by name: `attachments_of`.

    DataError: the file exists or cannot be written, or the extra `mcap` is not installed.
    """

    frames: int  # written; once the disk has refused more, those that can be read

    def __init__(
        self, path: Path, facts: RecordingFacts, attached: Mapping[str, bytes] | None = None
    ) -> None:
        mcap = needed("mcap.writer", "mcap", "An MCAP file")
        definition = typestore().generate_msgdef(SCHEMA_NAME, ros_version=2)[0].encode()
        self.path = path
        self.frames = self._kept = self._kept_bytes = 0
        self._frame_id = facts.serial or facts.name
        self._epoch_ns: int | None = None
        try:
            self._file = path.open("xb")
        except FileExistsError:
            raise DataError(f"{path} is there already. Give another name, or remove it.") from None
        except OSError as problem:
            raise DataError(f"Cannot write {path}: {problem.strerror}.") from problem
        uncompressed = mcap.CompressionType.NONE  # pictures are already compressed
        self._writer = mcap.Writer(self._file, chunk_size=2**24, compression=uncompressed)
        # The library ends a chunk only by its size; the method that ends one is private (a test guards this use).
        self._end_chunk = self._writer._Writer__finalize_chunk
        try:
            with self._faults_named():
                self._writer.start(profile="ros2", library=f"gelform {facts.library_version}")
                self._writer.add_metadata(METADATA, {"facts": facts.to_json()})
                for name, content in (attached or {}).items():
                    now_ns = time.time_ns()
                    self._writer.add_attachment(now_ns, now_ns, name, ATTACHABLE[name], content)
                schema = self._writer.register_schema(SCHEMA_NAME, SCHEMA_ENCODING, definition)
                self._channel = self._writer.register_channel(TOPIC, MESSAGE_ENCODING, schema)
            self._flush()
        except DataError:
            path.unlink(missing_ok=True)
            raise

    def write(self, frame: Frame) -> int:
        """Add a frame; return its size in bytes."""
        picture_format, content = encoded_from_frame(frame)
        time_ns = round(frame.time_s * 1e9)
        if self._epoch_ns is None:
            self._epoch_ns = frame.wall_time_ns - time_ns
        stamp = self._epoch_ns + time_ns
        message = message_from_picture(content, picture_format, frame.wall_time_ns, self._frame_id)
        with self._faults_named():
            self._writer.add_message(self._channel, stamp, message, stamp, frame.index % 2**32)
        self.frames += 1
        self.flush_if_due()
        return len(content)

    def flush_if_due(self) -> None:
        """Write the gathered frames to the file if half a second has passed."""
        if time.monotonic() - self._flushed_s >= FLUSH_S:
            self._flush()

    def close(self) -> None:
        """Write the index, and close the file."""
        if self._file.closed:
            return
        self._flush()
        with self._faults_named():
            self._writer.finish()
            self._file.close()

    def _flush(self) -> None:
        with self._faults_named():
            self._end_chunk()
            self._file.flush()
        self._kept, self._kept_bytes = self.frames, self._file.tell()
        self._flushed_s = time.monotonic()

    @contextmanager
    def _faults_named(self) -> Iterator[None]:
        """Context for writing: what the disk refuses raises DataError, and the file keeps what can be read.

        It ends as a killed recorder's, at its last whole chunk, and is deleted without a frame.
        """
        try:
            yield
        except OSError as problem:
            self.frames = self._kept
            with suppress(OSError):
                self._file.close()  # tries to write again
            with suppress(OSError):
                if self.frames:
                    os.truncate(self.path, self._kept_bytes)
                else:
                    self.path.unlink()
            kept = (
                f"Its first {self.frames} frames can be read." if self.frames else "No frame of it is kept."
            )
            raise DataError(f"Cannot write {self.path} any further: {problem.strerror}. {kept}") from problem
