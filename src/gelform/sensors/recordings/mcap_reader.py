"""Frames from an MCAP file: a recording of gelform's, another one of pictures, a bag of ROS 2; finished or not."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gelform.errors import DataError
from gelform.frames import Frame
from gelform.sensors.playback import Playback
from gelform.sensors.recordings.facts import (
    RecordingFacts,
    RecordingSummary,
    image_from_encoded,
    reduction_in,
)
from gelform.sensors.recordings.mcap_records import Placed, mcap_records
from gelform.sensors.recordings.messages import (
    picture_from_message,
    pixels_from_raw,
    raw_image_from_message,
)
from gelform.sensors.recordings.picture_topic import PictureTopic, picture_topic_of


def mcap_playback(path: Path, *, paced: bool = False) -> Playback:
    """The frames of an MCAP file, their `time_s` counted from the first.

    A file whose recorder was killed is read up to its last whole chunk. Frames of other tools' files are counted as they
    come: their messages have no numbers that can be relied on.

    Raises
    ------
    DataError
        It is missing, no MCAP file, holds no topic of pictures that can be read (or several, none of gelform's), or
        the extra `mcap` is not installed; in a loop: its bytes are damaged.
    """
    facts, topic = picture_topic_of(path)
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
