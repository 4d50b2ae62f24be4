"""Frames into an MCAP file that stays readable whenever the recorder stops, even if it is killed."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from gelform.errors import DataError, needed
from gelform.image.frame import Frame
from gelform.sensors.recordings.facts import ATTACHABLE, RecordingFacts, encoded_from_frame
from gelform.sensors.recordings.messages import (
    MESSAGE_ENCODING,
    SCHEMA_ENCODING,
    SCHEMA_NAME,
    message_from_picture,
    schema_of_picture,
)

TOPIC, METADATA = "/gelform/image/compressed", "gelform"
FLUSH_S = 0.5  # s of frames that a killed recorder loses


class McapRecording:
    """An MCAP file that is being written.

    Frames are gathered in chunks of half a second, each with its checksum and index, and handed to the system at once. A
    recorder that is killed loses the last half second. Time stamps start as UTC and advance with the monotonic clock of
    `Frame.time_s`, so that a change of the system clock does not shift them.

    Parameters
    ----------
    path : a new file
    facts : of the camera
    attached : attached files by name: `attachments_of`

    Attributes
    ----------
    frames : number of frames written; of those that can be read, once the disk has refused more

    Raises
    ------
    DataError
        The file exists or cannot be written, or the extra `mcap` is not installed.
    """

    def __init__(
        self, path: Path, facts: RecordingFacts, attached: Mapping[str, bytes] | None = None
    ) -> None:
        mcap, definition = needed("mcap.writer", "mcap", "An MCAP file"), schema_of_picture()
        self.path = path
        self.frames, self._kept, self._kept_bytes = 0, 0, 0
        self._frame_id = facts.serial or facts.name
        try:
            self._file = path.open("xb")
        except FileExistsError:
            raise DataError(f"{path} is there already. Give another name, or remove it.") from None
        except OSError as problem:
            raise DataError(f"Cannot write {path}: {problem.strerror}.") from problem
        try:
            self._begin(mcap, definition, facts, attached or {})
            self._flush()
        except DataError:
            path.unlink(missing_ok=True)
            raise

    def _begin(
        self, mcap: Any, definition: bytes, facts: RecordingFacts, attached: Mapping[str, bytes]
    ) -> None:
        """Write what stands before the first frame."""
        uncompressed = mcap.CompressionType.NONE  # pictures are already compressed
        self._writer = mcap.Writer(self._file, chunk_size=2**24, compression=uncompressed)
        with self._faults_named():
            self._writer.start(profile="ros2", library=f"gelform {facts.library_version}")
            self._writer.add_metadata(METADATA, {"facts": facts.to_json()})
            for name, content in attached.items():
                now_ns = time.time_ns()
                self._writer.add_attachment(now_ns, now_ns, name, ATTACHABLE[name], content)
            schema = self._writer.register_schema(SCHEMA_NAME, SCHEMA_ENCODING, definition)
            self._channel = self._writer.register_channel(TOPIC, MESSAGE_ENCODING, schema)
        # The library ends a chunk only by its size; the method that ends one is private (a test guards this use).
        self._end_chunk = self._writer._Writer__finalize_chunk
        self._epoch_ns: int | None = None
        self._flushed_s = time.monotonic()

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
        """Context for writing: what the disk refuses raises DataError, and the file keeps what can be read."""
        try:
            yield
        except OSError as problem:
            self._give_up()
            kept = (
                f"Its first {self.frames} frames can be read." if self.frames else "No frame of it is kept."
            )
            raise DataError(f"Cannot write {self.path} any further: {problem.strerror}. {kept}") from problem

    def _give_up(self) -> None:
        """Close the file as a killed recorder leaves it, at the end of its last whole chunk; delete it without a frame."""
        self.frames = self._kept
        with suppress(OSError):
            self._file.close()  # tries to write again
        with suppress(OSError):
            if self.frames:
                os.truncate(self.path, self._kept_bytes)
            else:
                self.path.unlink()
