"""Frames in MCAP files, as ROS 2 messages: they stay readable if the recorder is killed, and are read unfinished too."""

from __future__ import annotations

import os
import struct
import time
from collections.abc import Container, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import cv2
import numpy as np

from gelform.arrays import MIB, Image
from gelform.errors import DataError, cannot, needed, said
from gelform.foundations.files import conversion_of_bag
from gelform.image.view import Frame
from gelform.sensors.playback import (
    ATTACHABLE,
    Film,
    RecordingFacts,
    encoded_from_frame,
    image_from_encoded,
    reduction_in,
)

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
    stamp = store.types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, NS_PER_S))
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
    return int(message.header.stamp.sec * NS_PER_S + message.header.stamp.nanosec)


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
        with cannot(f"write {path}"):
            try:
                self._file = path.open("xb")
            except FileExistsError:
                raise DataError(f"{path} is there already. Give another name, or remove it.") from None
        uncompressed = mcap.CompressionType.NONE  # pictures are already compressed
        self._writer = mcap.Writer(self._file, chunk_size=16 * MIB, compression=uncompressed)
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
        if not os.fstat(self._file.fileno()).st_nlink:
            self._file.close()
            self.frames = 0
            raise DataError(f"Cannot write {self.path} any further: it was deleted. No frame of it is kept.")
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


MAGIC = b"\x89MCAP0\r\n"  # at the start and the end of a file (MCAP specification)
CUT = "The frames before that are read; how many follow is not known."
METADATA_FILE, METADATA_KEY = "metadata.yaml", "rosbag2_bagfile_information"
NS_PER_S = 1_000_000_000
# Bytes of a record or a decompressed chunk; a larger one is damaged and would fill the memory.
MAX_RECORD_BYTES = 256 * MIB
SAMPLED_RECORDS = 200  # records that are read to find which pictures a file contains


def is_bag_folder(path: Path) -> bool:
    """Whether a folder is a rosbag2 folder, by its metadata.yaml."""
    file = path / METADATA_FILE
    if not file.is_file():
        return False
    with file.open(encoding="utf-8", errors="replace") as text:
        return METADATA_KEY in text.read(4096)


def refuse_bag(path: Path) -> None:
    """Refuse a rosbag2 folder where images are expected; DataError with the way to them."""
    if is_bag_folder(path):
        file = mcap_file_in(path)
        raise DataError(
            f"Expected images, got the bag {path}. Its frames: gelform batch {file} -c CAL.npz -o out --keep all, "
            f"or gelform live {path}."
        )


def mcap_file_in(path: Path) -> Path:
    """A file unchanged, or the only MCAP file of a rosbag2 folder.

    DataError: its files are of sqlite3, compressed as a whole, several or missing; the message says what to do.
    """
    if not path.is_dir():
        return path
    files = sorted(file for file in path.iterdir() if file.is_file() and file.name != METADATA_FILE)
    whole = [file for file in files if file.suffix == ".mcap"]
    if len(whole) == 1:
        return whole[0]
    if whole:
        raise DataError(
            f"Expected a bag of one file, got {len(whole)} in {path}. Open them one after the other, such as {whole[0]}."
        )
    if any(file.suffix == ".db3" for file in files):
        raise DataError(
            f"{path} is a bag of sqlite3. {conversion_of_bag(path.name, path.name)} Or ros2 bag convert with "
            "storage_id mcap."
        )
    compressed = [file for file in files if file.name.endswith((".mcap.zstd", ".mcap.lz4"))]
    if compressed:
        raise DataError(
            f"{compressed[0]} is compressed as a whole. Decompress it: zstd -d {compressed[0].name} -o {path.name}.mcap"
        )
    raise DataError(
        f"Expected a file *.mcap beside {METADATA_FILE} in {path}, got none. Copy the whole folder."
    )


def end_missing(path: Path) -> str:
    """A sentence about a recording (*.mcap) without its end, which lacks frames; "" for a whole one or a video."""
    if path.suffix.lower() != ".mcap":
        return ""
    try:
        with path.open("rb") as file:
            file.seek(-len(MAGIC), os.SEEK_END)
            whole = file.read() == MAGIC
    except OSError:
        return ""  # reading it gives the error
    return "" if whole else f"{path} has no end: its recorder was killed, or it was copied in part. {CUT}"


def mcap_records(path: Path) -> Iterator[tuple[str, str, Any]]:
    """Each record, after its channel's topic and message type ("" without one); schemas and known channels are left out.

    DataError: as `records_from`.
    """
    schemas: dict[int, str] = {}
    channels: dict[int, tuple[str, str]] = {}
    for record in chain.from_iterable(records for _, records in records_from(path)):
        kind = type(record).__name__
        if kind == "Schema":
            schemas[record.id] = record.name
        elif kind != "Channel":
            yield *channels.get(getattr(record, "channel_id", -1), ("", "")), record
        elif record.id not in channels:
            channels[record.id] = record.topic, schemas.get(record.schema_id, "")
            yield *channels[record.id], record


def records_from(path: Path, offset: int = 0) -> Iterator[tuple[int, list[Any]]]:
    """(offset, contents) of each record from an offset on; the contents are the record itself or those of a chunk.

    The first offset is 0, or one that this function returned before.

    DataError: the file is missing, no MCAP file or damaged, or the extra `mcap` is not installed.
    """
    if not path.is_file():
        raise DataError(f"No recording {path}. Check the path.")
    mcap = needed("mcap.stream_reader", "mcap", "An MCAP file")
    with path.open("rb") as file, _faults_named(path):
        file.seek(offset)
        reader = mcap.StreamReader(
            _WholeReads(file),
            skip_magic=offset > 0,
            emit_chunks=True,
            validate_crcs=offset == 0,  # of all records from the first on; those of a chunk are its own
            record_size_limit=MAX_RECORD_BYTES,
        )
        begins = offset or 8  # after the magic at the start
        for record in reader.records:
            is_chunk = type(record).__name__ == "Chunk"
            inside = mcap.breakup_chunk(_decompressed(record), validate_crc=True) if is_chunk else [record]
            yield begins, inside
            begins = file.tell()


def _decompressed(chunk: Any) -> Any:
    """A chunk without compression; ValueError if it states a size beyond reason, or another one than it has.

    The library trusts a compressed chunk, whose few bytes can become gigabytes.
    """
    size = chunk.uncompressed_size
    if size > MAX_RECORD_BYTES:
        raise ValueError(f"a chunk states {size / 1e6:.3g} MB, more than {MAX_RECORD_BYTES // MIB} MB.")
    if chunk.compression not in ("zstd", "lz4"):
        return chunk
    compressed = needed("zstandard" if chunk.compression == "zstd" else "lz4.frame", "mcap", "An MCAP file")
    try:
        if chunk.compression == "zstd":
            data = compressed.ZstdDecompressor().stream_reader(chunk.data).read(size + 1)
        else:
            data = compressed.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    except (RuntimeError, getattr(compressed, "ZstdError", RuntimeError)) as problem:
        raise ValueError(f"a chunk cannot be decompressed: {said(problem)}.") from problem
    if len(data) != size:
        raise ValueError(
            f"a chunk states {size} bytes and holds {'more' if len(data) > size else len(data)}."
        )
    return replace(chunk, compression="", data=data)


@contextmanager
def _faults_named(path: Path) -> Iterator[None]:
    """Context for reading records: damage raises DataError; a file whose recorder was killed just ends."""
    from mcap.exceptions import EndOfFile, McapError

    try:
        yield
    except EndOfFile:
        return  # unfinished: the recorder was killed
    except (ValueError, KeyError, struct.error, MemoryError, OverflowError, McapError) as problem:
        raise DataError(f"{path} is no MCAP file, or a damaged one: {problem}") from problem


class _WholeReads:
    """A file that ends where fewer bytes are left than requested; the library trusts the length that a record states."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    def read(self, count: int) -> bytes:
        data = self._file.read(count)
        return data if len(data) == count else b""


@dataclass(frozen=True)
class PictureTopic:
    """A topic of pictures: compressed or raw, and whether its messages number the frames (gelform's recordings do)."""

    name: str
    raw: bool = False
    numbered: bool = False


def picture_topic_of(path: Path) -> tuple[RecordingFacts, PictureTopic]:
    """The facts and the topic of pictures, from the first records: gelform's own topic, else the only one.

    DataError: there is no readable topic, or several; the message names them and says what to do.
    """
    facts: RecordingFacts | None = None
    compressed, others = list[str](), list[str]()
    encodings: dict[str, str] = {}  # of raw pictures; "" until the first message
    for count, (topic, schema, record) in enumerate(mcap_records(path)):
        kind = type(record).__name__
        if kind == "Metadata" and record.name == METADATA:
            facts = RecordingFacts.from_json(record.metadata.get("facts", ""), str(path))
        elif kind == "Channel":
            # image_transport's compressed depth has the message type of a picture.
            readable = record.message_encoding == MESSAGE_ENCODING and not topic.endswith("/compressedDepth")
            if readable and schema == RAW_SCHEMA_NAME:
                encodings[topic] = ""
            else:
                (compressed if readable and schema == SCHEMA_NAME else others).append(topic)
        elif kind == "Message" and encodings.get(topic) == "":
            try:
                encodings[topic] = decoded(record.data, RAW_SCHEMA_NAME).encoding
            except ValueError as problem:
                raise DataError(f"{path}: {topic} cannot be read. {problem}") from problem
        if TOPIC in compressed or (count > SAMPLED_RECORDS and "" not in encodings.values()):
            break
    if TOPIC in compressed:
        return facts or RecordingFacts(path.name), PictureTopic(TOPIC, numbered=facts is not None)
    topics = [*compressed, *(topic for topic, encoding in encodings.items() if encoding in COLOR_ENCODINGS)]
    if len(topics) == 1:
        return RecordingFacts(path.name), PictureTopic(topics[0], raw=topics[0] in encodings)
    if facts is not None and not topics:
        raise DataError(f"{path} holds no frame yet: its recorder ended, or was killed, before the first.")
    raise DataError(_refusal(path, topics, encodings, others))


def _refusal(path: Path, topics: list[str], encodings: dict[str, str], others: list[str]) -> str:
    """Why there is no readable topic, and what to do."""
    if topics:
        return (
            f"Expected one topic of pictures in {path}, got {', '.join(topics)}. Keep the sensor's alone, for example: "
            f"mcap filter {path.name} -y {topics[0]} -o one.mcap"
        )
    wrong = [f"{topic} ({encoding})" for topic, encoding in encodings.items() if encoding]
    if wrong:
        return (
            f"Expected pictures of encoding {' or '.join(COLOR_ENCODINGS)} in {path}, got {', '.join(wrong)}."
            + way_for_encoding(next(filter(None, encodings.values())))
        )
    beside = ", ".join([*encodings, *others])
    return (
        f"Expected a topic of {SCHEMA_NAME} (PNG, JPEG) or {RAW_SCHEMA_NAME} with messages in {path}, got none"
        + (f", beside {beside}." if beside else ".")
        + " Record the camera's image topic, not compressed depth or video."
    )


class MessagePlace(NamedTuple):
    """Place of a message in a file."""

    log_time: int
    offset: int  # of its record: a chunk, or itself
    nth: int  # message of that record


class Recording(Film):
    """The frames of an MCAP file, or of the one in a rosbag2 folder, in its order or by number.

    If the recorder was killed, it has the frames up to the last complete chunk. Frames of other tools' files are numbered in
    their order, because the numbers in their messages are unreliable. For any frame the file is scanned once; 32 bytes per
    frame and the two last used chunks stay in memory.

    DataError: the file is missing, no MCAP file, has no readable topic of pictures (or several, none of them gelform's), or
    the extra `mcap` is not installed; in a loop: its bytes are damaged.
    """

    def __init__(self, path: Path) -> None:
        self._file = mcap_file_in(path)
        camera, self._topic = picture_topic_of(self._file)
        super().__init__(path, camera)
        self._channels: set[int] = set()
        self._messages_at = lru_cache(maxsize=2)(
            lambda offset: list(self._wanted(next(records_from(self._file, offset))[1]))
        )

    def _frames(self, only: Container[int] | None = None) -> Iterator[Frame]:
        first_ns: int | None = None
        messages = chain.from_iterable(self._wanted(inside) for _, inside in records_from(self._file))
        for number, message in enumerate(messages):
            first_ns = message.log_time if first_ns is None else first_ns
            if only is None or number in only:
                yield self._frame_of(message, (message.log_time - first_ns) / 1e9, number)

    @cached_property
    def times_s(self) -> Sequence[float]:
        """Time of each frame, counted from the first."""
        self._places = sorted(
            MessagePlace(message.log_time, offset, nth)
            for offset, inside in records_from(self._file)
            for nth, message in enumerate(self._wanted(inside))
        )
        return tuple((place.log_time - self._places[0].log_time) / 1e9 for place in self._places)

    def _frame(self, number: int) -> Frame:
        time_s, place = self.times_s[number], self._places[number]
        messages = self._messages_at(place.offset)
        if place.nth >= len(messages) or messages[place.nth].log_time != place.log_time:
            raise DataError(f"{self._file} was changed while it was open. Open it again.")
        return self._frame_of(messages[place.nth], time_s, number)

    def _frame_of(self, message: Any, time_s: float, number: int) -> Frame:
        """The frame of a message with a picture; DataError if it is damaged."""
        index = message.sequence if self._topic.numbered else number
        where = f"Frame {index} of {self._file}"
        try:
            if self._topic.raw:
                raw = decoded(message.data, RAW_SCHEMA_NAME)
                return Frame(pixels_from_raw(raw), time_s, time_ns_of(raw), index)
            picture = decoded(message.data, SCHEMA_NAME)
        except ValueError as problem:
            raise DataError(f"{where} is damaged: {problem}") from problem
        content = picture.data.tobytes()
        encoded = content if content.startswith(b"\xff\xd8") else None
        image = image_from_encoded(content, reduction_in(self.camera.settings), where)
        return Frame(image, time_s, time_ns_of(picture), index, encoded)

    def _wanted(self, inside: list[Any]) -> Iterator[Any]:
        """The topic's messages among records; also notes the numbers of its channels."""
        for one in inside:
            kind = type(one).__name__
            if kind == "Channel" and one.topic == self._topic.name:
                self._channels.add(one.id)
            elif kind == "Message" and one.channel_id in self._channels:
                yield one
