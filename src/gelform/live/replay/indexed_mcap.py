"""Where each frame of an MCAP file lies: its chunk, and its place in the chunk."""

from __future__ import annotations

import struct
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gelform.errors import DataError
from gelform.frames import Frame
from gelform.sensors.recordings.facts import reduction_in
from gelform.sensors.recordings.mcap_reader import MAX_RECORD_BYTES, frame_from_message, picture_topic_of

MAGIC_BYTES = 8
KEPT_CHUNKS = 2


@dataclass(frozen=True)
class Place:
    """A message: where its record (a chunk, or itself) begins in the file, and which message of it that is."""

    offset: int
    nth: int
    log_time: int
    sequence: int


class McapIndex:
    """The frames of an MCAP file by number.

    Reads the file once; what it keeps is 32 bytes a frame and the two chunks that were last looked at. A file whose recorder
    was killed has the frames up to its last whole chunk.

    Parameters
    ----------
    path : of the file

    Attributes
    ----------
    facts : RecordingFacts
    times_s : of each frame, from the first

    Raises
    ------
    DataError
        It is missing, no MCAP file or damaged, holds no topic of pictures that can be read, or the extra `mcap` is missing.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.facts, self._topic = picture_topic_of(path)
        self._channels: set[int] = set()
        self._places = sorted(self._placed(), key=lambda place: place.log_time)
        first = self._places[0].log_time if self._places else 0
        self.times_s = tuple((place.log_time - first) / 1e9 for place in self._places)
        self._chunks: OrderedDict[int, list[Any]] = OrderedDict()

    def frame(self, number: int) -> Frame:
        """A frame; DataError where it is damaged or the file has changed."""
        place = self._places[number]
        messages = self._messages_at(place.offset)
        if place.nth >= len(messages) or messages[place.nth].log_time != place.log_time:
            raise DataError(f"{self._path} was changed while it was open. Open it again.")
        index = place.sequence if self._topic.numbered else number
        return frame_from_message(
            messages[place.nth].data,
            self._topic,
            reduction_in(self.facts.settings),
            self.times_s[number],
            index,
            f"Frame {index} of {self._path}",
        )

    def _placed(self) -> Iterator[Place]:
        """Every message of the topic, in the order of the file."""
        for offset, inside in _records(self._path, 0):
            for nth, message in enumerate(self._wanted(inside)):
                yield Place(offset, nth, message.log_time, message.sequence)

    def _messages_at(self, offset: int) -> list[Any]:
        if offset not in self._chunks:
            self._chunks[offset] = list(self._wanted(next(_records(self._path, offset))[1]))
            while len(self._chunks) > KEPT_CHUNKS:
                self._chunks.popitem(last=False)
        self._chunks.move_to_end(offset)
        return self._chunks[offset]

    def _wanted(self, inside: list[Any]) -> Iterator[Any]:
        """The messages of the topic among records; learns the numbers of its channels."""
        for one in inside:
            kind = type(one).__name__
            if kind == "Channel" and one.topic == self._topic.name:
                self._channels.add(one.id)
            elif kind == "Message" and one.channel_id in self._channels:
                yield one


def _records(path: Path, offset: int) -> Iterator[tuple[int, list[Any]]]:
    """(where it begins, what is inside: itself, or a chunk's records) from an offset on: 0, or one given before."""
    from mcap.exceptions import EndOfFile, McapError
    from mcap.stream_reader import StreamReader, breakup_chunk

    with path.open("rb") as file:
        file.seek(offset)
        reader = StreamReader(
            file, skip_magic=offset > 0, emit_chunks=True, record_size_limit=MAX_RECORD_BYTES
        )
        begins = offset or MAGIC_BYTES
        try:
            for record in reader.records:
                is_chunk = type(record).__name__ == "Chunk"
                yield begins, breakup_chunk(record, validate_crc=True) if is_chunk else [record]
                begins = file.tell()
        except EndOfFile:
            return  # not finished: the recorder was killed
        except (ValueError, KeyError, struct.error, MemoryError, McapError) as problem:
            raise DataError(f"{path} is no MCAP file, or a damaged one: {problem}") from problem
