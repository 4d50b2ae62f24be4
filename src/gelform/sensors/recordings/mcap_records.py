"""The records of an MCAP file in their order, as far as it is whole."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from gelform.errors import DataError

MAX_RECORD_BYTES = 256 * 2**20


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

    Raises
    ------
    DataError
        The file is missing, none of MCAP or damaged, or the extra `mcap` is not installed.
    """
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
                    schema = schemas.get(record.schema_id, "")
                    yield Channel(record.topic, schema, record.message_encoding)
                elif kind == "Message":
                    yield Placed(topics.get(record.channel_id, ""), record)
                elif kind != "Channel":
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
