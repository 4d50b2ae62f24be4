"""Record what a grabber reads: every frame it holds, in their order."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from gelform import __version__
from gelform.errors import DataError
from gelform.frames import Frame
from gelform.sensors.grabber import Grabber
from gelform.sensors.recordings.facts import RecordingFacts
from gelform.sensors.recordings.image_folder import FolderRecording
from gelform.sensors.recordings.mcap_writer import McapRecording
from gelform.sensors.video_files import is_video

KEPT_FRAMES = 32  # of a grabber for `record_frames`: half a second in which the disk may stand still
WAIT_S = 0.25


class Recording(Protocol):
    """A file or folder that takes frames."""

    path: Path

    def write(self, frame: Frame) -> int:
        """Add a frame; the bytes that it takes."""

    def flush_if_due(self) -> None:
        """Give what was gathered to the system, where it is time."""

    def close(self) -> None:
        """Finish it."""


@dataclass(frozen=True)
class RecordStats:
    """Of a recording: frames written, frames that are missing between them, bytes, seconds from first to last."""

    frames: int
    missing: int
    written_bytes: int
    duration_s: float


def new_recording(
    path: Path,
    grabber: Grabber,
    *,
    calibration_digest: str = "",
    attached: Mapping[str, bytes] | None = None,
) -> Recording:
    """A recording of what a grabber reads: an MCAP file where the name ends so, else a folder of images.

    Parameters
    ----------
    path : a new file (*.mcap) or folder
    grabber : entered
    calibration_digest : of the calibration in use
    attached : files that it carries, by name: `attachments_of`

    Raises
    ------
    DataError
        The name is that of a video, the file is there already, or it cannot be written.
    """
    if is_video(path):
        raise DataError(
            f"Expected *.mcap or a folder, got the name of a video: {path}. Videos lose what compression takes away."
        )
    rate = grabber.source.rate_hz
    facts = RecordingFacts(
        grabber.name, grabber.serial, grabber.settings, rate, calibration_digest, __version__
    )
    return (McapRecording if path.suffix.lower() == ".mcap" else FolderRecording)(path, facts, attached)


def record_frames(
    grabber: Grabber,
    recording: Recording,
    *,
    seconds: float | None = None,
    frames: int | None = None,
    going_on: Callable[[RecordStats], bool] = lambda _: True,
) -> RecordStats:
    """Write frames until enough are there, the source ends, or `going_on` says False.

    Parameters
    ----------
    grabber : entered; one with `keep=KEPT_FRAMES` loses nothing while the disk is busy
    recording : is not closed
    seconds, frames : how long, by the frames' times, or how many; without end where both are None
    going_on : is told after each frame, and four times a second while none comes
    """
    stats, after, first_s, began_s = RecordStats(0, 0, 0, 0.0), -1, 0.0, time.monotonic()
    limit_s = math.inf if seconds is None else seconds
    while going_on(stats) and (frames is None or stats.frames < frames):
        frame = grabber.following(after, WAIT_S)
        if frame is None:
            if grabber.state == "ended" or time.monotonic() - began_s > limit_s:
                break
            recording.flush_if_due()
            continue
        if stats.frames == 0:
            first_s, began_s, after = frame.time_s, time.monotonic(), frame.index - 1
        if frame.time_s - first_s > limit_s:
            break
        written = recording.write(frame)
        stats = RecordStats(
            stats.frames + 1,
            stats.missing + frame.index - after - 1,
            stats.written_bytes + written,
            frame.time_s - first_s,
        )
        after = frame.index
    return stats
