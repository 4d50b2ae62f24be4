"""Which topic of an MCAP file holds the camera's pictures."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from gelform.errors import DataError
from gelform.sensors.recordings.facts import RecordingFacts
from gelform.sensors.recordings.mcap_records import Channel, Placed, mcap_records
from gelform.sensors.recordings.mcap_writer import METADATA, TOPIC
from gelform.sensors.recordings.messages import (
    COLOR_ENCODINGS,
    MESSAGE_ENCODING,
    RAW_SCHEMA_NAME,
    SCHEMA_NAME,
    raw_image_from_message,
)

LOOKED_AT = 200  # records, for what kind of pictures a file holds
DEPTH_SUFFIX = "/compressedDepth"  # of image_transport: the message is that of a picture, its content is none


@dataclass(frozen=True)
class PictureTopic:
    """A topic of pictures: compressed or raw, and whether its messages count frames (in gelform's own recordings)."""

    name: str
    raw: bool = False
    numbered: bool = False


@dataclass
class _Found:
    """What the first records say."""

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

    Raises
    ------
    DataError
        There is none that can be read, or several; the message names them and says what to do.
    """
    found = _Found()
    for count, record in enumerate(mcap_records(path)):
        _add(found, record, path)
        if TOPIC in found.compressed or (count > LOOKED_AT and not found.undecided):
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
