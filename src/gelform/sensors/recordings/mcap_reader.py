"""Frames from an MCAP file: a recording of gelform's or another one of compressed pictures, finished or not."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from gelform.errors import DataError
from gelform.frames import Frame
from gelform.sensors.playback import Playback
from gelform.sensors.recordings.facts import (
    RecordingFacts,
    RecordingSummary,
    image_from_encoded,
    reduction_in,
)
from gelform.sensors.recordings.mcap_writer import METADATA, TOPIC
from gelform.sensors.recordings.messages import MESSAGE_ENCODING, SCHEMA_NAME, picture_from_message

MAX_RECORD_BYTES = 256 * 2**20
LOOKED_AT = 200  # records, for what kind of pictures a file holds


def mcap_playback(path: Path, *, paced: bool = False) -> Playback:
    """The frames of an MCAP file, their `time_s` counted from the first.

    A file whose recorder was killed is read up to its last whole chunk.

    Raises
    ------
    DataError
        It is missing, no MCAP file, holds no compressed pictures (or several channels of them, none of gelform's), or
        the extra `mcap` is not installed; in a loop: its bytes are damaged.
    """
    facts, topic = _look(path)
    return Playback(
        lambda: _frames(path, topic, facts),
        name=facts.name,
        rate_hz=facts.rate_hz,
        serial=facts.serial,
        settings=facts.settings,
        paced=paced,
    )


def mcap_summary(path: Path) -> RecordingSummary:
    """Read a whole recording, but decode none of its pictures."""
    facts, topic = _look(path)
    stamps, finished = [], False
    for record in _records(path):
        finished = type(record).__name__ == "Footer"
        if _is_message_of(record, topic):
            stamps.append(record.message.log_time)
    return RecordingSummary(
        facts, len(stamps), (max(stamps) - min(stamps)) / 1e9 if stamps else 0.0, finished
    )


@dataclass(frozen=True)
class _Placed:
    """A message with the topic that it belongs to."""

    topic: str
    message: Any


def _frames(path: Path, topic: str, facts: RecordingFacts) -> Iterator[Frame]:
    first_ns: int | None = None
    reduction = reduction_in(facts.settings)
    for record in _records(path):
        if not _is_message_of(record, topic):
            continue
        message = record.message
        first_ns = message.log_time if first_ns is None else first_ns
        where = f"Frame {message.sequence} of {path}"
        try:
            content, wall_time_ns = picture_from_message(message.data)
        except ValueError as problem:
            raise DataError(f"{where} is damaged: {problem}") from problem
        yield Frame(
            image_from_encoded(content, reduction, where),
            (message.log_time - first_ns) / 1e9,
            wall_time_ns,
            message.sequence,
            content if content.startswith(b"\xff\xd8") else None,
        )


def _is_message_of(record: Any, topic: str) -> bool:
    return isinstance(record, _Placed) and record.topic == topic


def _look(path: Path) -> tuple[RecordingFacts, str]:
    """The facts and the topic of the pictures, from the first records."""
    facts, topics, others = None, [], []
    for count, record in enumerate(_records(path)):
        kind = type(record).__name__
        if kind == "Metadata" and record.name == METADATA:
            facts = RecordingFacts.from_json(record.metadata.get("facts", ""), str(path))
        if kind == "_Pictures":
            topics.append(record.topic)
        if kind == "Channel":
            others.append(record.topic)
        if TOPIC in topics or count > LOOKED_AT:
            break
    if TOPIC in topics:
        return facts or RecordingFacts(path.name), TOPIC
    if len(topics) == 1:
        return RecordingFacts(path.name), topics[0]
    if facts is not None:
        raise DataError(f"{path} holds no frame yet: its recorder ended, or was killed, before the first.")
    raise DataError(
        f"Expected a recording with one topic of {SCHEMA_NAME}, got {', '.join(topics) or 'none'} in {path}"
        + (f", beside {', '.join(others)}." if others else ".")
    )


@dataclass(frozen=True)
class _Pictures:
    """A channel of compressed pictures."""

    topic: str


def _records(path: Path) -> Iterator[Any]:
    """The records in their order, as far as the file is whole; messages and channels of pictures with their topic."""
    stream_reader, end_of_file = _library()
    if not path.is_file():
        raise DataError(f"No recording {path}. Check the path.")
    schemas: dict[int, str] = {}
    topics: dict[int, str] = {}
    with path.open("rb") as file:
        reader = stream_reader(_WholeReads(file), validate_crcs=True, record_size_limit=MAX_RECORD_BYTES)
        try:
            for record in reader.records:
                kind = type(record).__name__
                if kind == "Schema":
                    schemas[record.id] = record.name
                elif kind == "Channel" and record.id not in topics:
                    topics[record.id] = record.topic
                    pictures = schemas.get(record.schema_id) == SCHEMA_NAME
                    yield (
                        _Pictures(record.topic)
                        if (pictures and record.message_encoding == MESSAGE_ENCODING)
                        else record
                    )
                elif kind == "Message":
                    yield _Placed(topics.get(record.channel_id, ""), record)
                else:
                    yield record
        except end_of_file:
            return  # not finished: the recorder was killed
        except (ValueError, KeyError, struct.error, MemoryError, _mcap_error()) as problem:
            raise DataError(f"{path} is no MCAP file, or a damaged one: {problem}") from problem


class _WholeReads:
    """A file that has ended where it holds fewer bytes than wanted: the library asks for records as they say they are."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    def read(self, count: int) -> bytes:
        data = self._file.read(count)
        return data if len(data) == count else b""


def _library() -> tuple[Any, Any]:
    try:
        from mcap.exceptions import EndOfFile
        from mcap.stream_reader import StreamReader
    except ImportError as problem:
        raise DataError("MCAP files need the extra mcap: pip install 'gelform[mcap]'.") from problem
    return StreamReader, EndOfFile


def _mcap_error() -> type[Exception]:
    from mcap.exceptions import McapError

    return McapError  # type: ignore[no-any-return]
