"""Frames from an MCAP file: a recording of gelform's, another one of pictures, a bag of ROS 2; finished or not."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

from gelform.errors import DataError
from gelform.frames import Frame
from gelform.sensors.playback import Playback
from gelform.sensors.recordings.facts import (
    RecordingFacts,
    RecordingSummary,
    image_from_encoded,
    playback_of,
    reduction_in,
)
from gelform.sensors.recordings.mcap_writer import METADATA, TOPIC
from gelform.sensors.recordings.messages import (
    COLOR_ENCODINGS,
    MESSAGE_ENCODING,
    RAW_SCHEMA_NAME,
    SCHEMA_NAME,
    picture_from_message,
    pixels_from_raw,
    raw_image_from_message,
)

METADATA_FILE, METADATA_KEY = "metadata.yaml", "rosbag2_bagfile_information"
MAX_KEY_AT = 4096  # characters of metadata.yaml
MAX_RECORD_BYTES = 256 * 2**20  # more is damage, and would take all memory
SAMPLED_RECORDS = 200  # looked at, for what kind of pictures a file holds
DEPTH_SUFFIX = "/compressedDepth"  # of image_transport: the message is that of a picture, its content is none


def is_bag_folder(path: Path) -> bool:
    """Whether a folder is one of rosbag2: by its metadata.yaml."""
    file = path / METADATA_FILE
    if not file.is_file():
        return False
    with file.open(encoding="utf-8", errors="replace") as text:
        return METADATA_KEY in text.read(MAX_KEY_AT)


def mcap_file_in(path: Path) -> Path:
    """The one MCAP file of a rosbag2 folder.

    DataError: its files are of sqlite3, compressed as a whole, several or missing; the message says what to do.
    """
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
            f"{path} is a bag of sqlite3. Convert it: ros2 bag convert with storage_id mcap, or rosbags-convert "
            f"--src {path.name} --dst {path.name}_mcap --dst-storage mcap."
        )
    compressed = [file for file in files if file.name.endswith((".mcap.zstd", ".mcap.lz4"))]
    if compressed:
        raise DataError(
            f"{compressed[0]} is compressed as a whole. Decompress it: zstd -d {compressed[0].name} -o {path.name}.mcap"
        )
    raise DataError(
        f"Expected a file *.mcap beside {METADATA_FILE} in {path}, got none. Copy the whole folder."
    )


@dataclass(frozen=True)
class Channel:
    """A topic with the name of its messages' type, and how they are encoded."""

    topic: str
    schema: str
    encoding: str


@dataclass(frozen=True)
class Placed:
    """A message with the topic that it belongs to."""

    topic: str
    message: Any


def mcap_records(path: Path) -> Iterator[Any]:
    """Channels, messages with their topic, and all other records as the library has them.

    DataError: the file is missing, none of MCAP or damaged, or the extra `mcap` is not installed.
    """
    try:
        from mcap.stream_reader import StreamReader
    except ImportError as problem:
        raise DataError("MCAP files need the extra mcap: pip install 'gelform[mcap]'.") from problem
    if not path.is_file():
        raise DataError(f"No recording {path}. Check the path.")
    schemas: dict[int, str] = {}
    topics: dict[int, str] = {}
    with path.open("rb") as file, faults_named(path):
        reader = StreamReader(_WholeReads(file), validate_crcs=True, record_size_limit=MAX_RECORD_BYTES)
        for record in reader.records:
            kind = type(record).__name__
            if kind == "Schema":
                schemas[record.id] = record.name
            elif kind == "Channel" and record.id not in topics:
                topics[record.id] = record.topic
                schema = schemas.get(record.schema_id, "")
                yield Channel(record.topic, schema, record.message_encoding)
            elif kind == "Message":
                yield Placed(topics.get(record.channel_id, ""), record)
            elif kind != "Channel":
                yield record


@contextmanager
def faults_named(path: Path) -> Iterator[None]:
    """Of a block that reads records: DataError for damage, the end for a file whose recorder was killed."""
    from mcap.exceptions import EndOfFile, McapError

    try:
        yield
    except EndOfFile:
        return  # not finished: the recorder was killed
    except (ValueError, KeyError, struct.error, MemoryError, McapError) as problem:
        raise DataError(f"{path} is no MCAP file, or a damaged one: {problem}") from problem


class _WholeReads:
    """A file that has ended where it holds fewer bytes than wanted: the library asks for records as they say they are."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    def read(self, count: int) -> bytes:
        data = self._file.read(count)
        return data if len(data) == count else b""


@dataclass(frozen=True)
class PictureTopic:
    """A topic of pictures: compressed or raw, and whether its messages count frames (in gelform's own recordings)."""

    name: str
    raw: bool = False
    numbered: bool = False


@dataclass
class _Found:
    """Facts, topics and encodings that the first records name."""

    facts: RecordingFacts | None = None
    compressed: list[str] = field(default_factory=list)
    encodings: dict[str, str] = field(default_factory=dict)  # of raw pictures; "" until a message was seen
    others: list[str] = field(default_factory=list)

    @property
    def colored(self) -> list[str]:
        return [topic for topic, encoding in self.encodings.items() if encoding in COLOR_ENCODINGS]

    @property
    def undecided(self) -> bool:
        return "" in self.encodings.values()


def picture_topic_of(path: Path) -> tuple[RecordingFacts, PictureTopic]:
    """The facts and the topic of the pictures, from the first records: one of gelform's own, else the only one.

    DataError: there is none that can be read, or several; the message names them and says what to do.
    """
    found = _Found()
    for count, record in enumerate(mcap_records(path)):
        _add(found, record, path)
        if TOPIC in found.compressed or (count > SAMPLED_RECORDS and not found.undecided):
            break
    if TOPIC in found.compressed:
        return found.facts or RecordingFacts(path.name), PictureTopic(TOPIC, numbered=found.facts is not None)
    topics = [*found.compressed, *found.colored]
    if len(topics) == 1:
        return RecordingFacts(path.name), PictureTopic(topics[0], raw=topics[0] in found.encodings)
    raise DataError(_refusal(path, found, topics))


def _add(found: _Found, record: Any, path: Path) -> None:
    if type(record).__name__ == "Metadata" and record.name == METADATA:
        found.facts = RecordingFacts.from_json(record.metadata.get("facts", ""), str(path))
    elif isinstance(record, Channel):
        readable = record.encoding == MESSAGE_ENCODING and not record.topic.endswith(DEPTH_SUFFIX)
        if readable and record.schema == SCHEMA_NAME:
            found.compressed.append(record.topic)
        elif readable and record.schema == RAW_SCHEMA_NAME:
            found.encodings[record.topic] = ""
        else:
            found.others.append(record.topic)
    elif isinstance(record, Placed) and found.encodings.get(record.topic) == "":
        try:
            found.encodings[record.topic] = raw_image_from_message(record.message.data).encoding
        except ValueError as problem:
            raise DataError(f"{path}: {record.topic} cannot be read. {problem}") from problem


def _refusal(path: Path, found: _Found, topics: list[str]) -> str:
    """Why there is no topic to read, and what to do."""
    if found.facts is not None and not topics:
        return f"{path} holds no frame yet: its recorder ended, or was killed, before the first."
    if topics:
        return (
            f"Expected one topic of pictures in {path}, got {', '.join(topics)}. Keep the sensor's alone, for example: "
            f"mcap filter {path.name} -y {topics[0]} -o one.mcap"
        )
    wrong = [f"{topic} ({encoding})" for topic, encoding in found.encodings.items() if encoding]
    if wrong:
        return (
            f"Expected pictures of encoding {' or '.join(COLOR_ENCODINGS)} in {path}, got {', '.join(wrong)}. 8UC3 does not "
            "say which channel is red: set the camera driver's encoding to rgb8 or bgr8 and record again."
        )
    beside = ", ".join([*found.encodings, *found.others])
    return (
        f"Expected a topic of {SCHEMA_NAME} (PNG, JPEG) or {RAW_SCHEMA_NAME} with messages in {path}, got none"
        + (f", beside {beside}." if beside else ".")
        + " Record the camera's image topic, not compressed depth or video."
    )


def mcap_playback(path: Path, *, paced: bool = False) -> Playback:
    """The frames of an MCAP file, their `time_s` counted from the first.

    A file whose recorder was killed is read up to its last whole chunk. Frames of other tools' files are counted as they
    come: their messages have no numbers that can be relied on.

    DataError: it is missing, no MCAP file, holds no topic of pictures that can be read (or several, none of
    gelform's), or the extra `mcap` is not installed; in a loop: its bytes are damaged.
    """
    facts, topic = picture_topic_of(path)
    return playback_of(facts, lambda: _frames(path, topic, facts), paced)


def mcap_summary(path: Path) -> RecordingSummary:
    """Read a whole recording, but decode none of its pictures."""
    facts, topic = picture_topic_of(path)
    stamps, finished = [], False
    for record in mcap_records(path):
        finished = type(record).__name__ == "Footer"
        if _is_message_of(record, topic):
            stamps.append(record.message.log_time)
    return RecordingSummary(
        facts, len(stamps), (max(stamps) - min(stamps)) / 1e9 if stamps else 0.0, finished
    )


def _frames(path: Path, topic: PictureTopic, facts: RecordingFacts) -> Iterator[Frame]:
    first_ns: int | None = None
    reduction, count = reduction_in(facts.settings), 0
    for record in mcap_records(path):
        if not _is_message_of(record, topic):
            continue
        message = record.message
        first_ns = message.log_time if first_ns is None else first_ns
        index = message.sequence if topic.numbered else count
        time_s = (message.log_time - first_ns) / 1e9
        yield frame_from_message(message.data, topic, reduction, time_s, index, f"Frame {index} of {path}")
        count += 1


def frame_from_message(
    data: bytes, topic: PictureTopic, reduction: int, time_s: float, index: int, where: str
) -> Frame:
    """The frame of a message of a topic of pictures; DataError, naming `where`, where it is damaged."""
    try:
        if topic.raw:
            raw = raw_image_from_message(data)
            return Frame(pixels_from_raw(raw), time_s, raw.wall_time_ns, index)
        content, wall_time_ns = picture_from_message(data)
    except ValueError as problem:
        raise DataError(f"{where} is damaged: {problem}") from problem
    encoded = content if content.startswith(b"\xff\xd8") else None
    return Frame(image_from_encoded(content, reduction, where), time_s, wall_time_ns, index, encoded)


def _is_message_of(record: Any, topic: PictureTopic) -> bool:
    return isinstance(record, Placed) and record.topic == topic.name
