"""Record what a grabber reads, every frame it holds in their order, with calibration and background beside them."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from gelform import __version__
from gelform.calibration_file import Calibration, load_calibration
from gelform.errors import DataError
from gelform.foundations.pictures import picture_bytes
from gelform.frames import Frame
from gelform.sensors.grabber import Grabber
from gelform.sensors.recordings.facts import (
    ATTACHABLE,
    BACKGROUND,
    CALIBRATION,
    RecordingFacts,
    image_from_encoded,
)
from gelform.sensors.recordings.image_folder import FolderRecording, is_recorded_folder
from gelform.sensors.recordings.mcap_reader import Placed, is_bag_folder, mcap_file_in, mcap_records
from gelform.sensors.recordings.mcap_writer import McapRecording
from gelform.sensors.video_files import is_video

MAX_ATTACHMENT_BYTES = 64 * 2**20
KEPT_FRAMES = 32  # of a grabber for `record_frames`: half a second in which the disk may stand still
WAIT_S = 0.25  # for a frame, before it is asked whether to go on


def attachments_of(
    calibration: Calibration | None, background: NDArray[np.floating] | None = None
) -> dict[str, bytes]:
    """The files that `new_recording` attaches, by name.

    Parameters
    ----------
    calibration : in use, or None
    background : (H, W, 3) RGB in whole grey levels that was taken after the calibration, or None
    """
    attached = {}
    if calibration is not None:
        with tempfile.TemporaryDirectory() as folder:
            calibration.save(Path(folder) / CALIBRATION)
            attached[CALIBRATION] = (Path(folder) / CALIBRATION).read_bytes()
    if background is not None:
        attached[BACKGROUND] = picture_bytes(np.rint(background).astype(np.uint8))
    return attached


def attached_to(path: Path) -> dict[str, bytes]:
    """The attachments of a recording (MCAP file or recorded folder); of an MCAP file those before its first frame.

    Videos and plain folders of images carry none.

    DataError: the file cannot be read, or an attachment is larger than 64 MB.
    """
    if is_recorded_folder(path):
        found = {name: (path / name).read_bytes() for name in ATTACHABLE if (path / name).is_file()}
    elif path.suffix.lower() == ".mcap" or is_bag_folder(path):
        found = _in_mcap(mcap_file_in(path) if path.is_dir() else path)
    else:
        found = {}
    for name, content in found.items():
        if len(content) > MAX_ATTACHMENT_BYTES:
            raise DataError(
                f"Expected {name} in {path} of at most {MAX_ATTACHMENT_BYTES >> 20} MB, got {len(content)} bytes."
            )
    return found


def attached_calibration(path: str | Path) -> Calibration | None:
    """The calibration that a recording carries; None where it carries none.

    Raises
    ------
    DataError
        The recording cannot be read.
    CalibrationError
        The calibration is damaged, or of a newer format.
    """
    content = attached_to(Path(path)).get(CALIBRATION)
    if content is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        written = Path(folder) / CALIBRATION
        written.write_bytes(content)
        return load_calibration(written)


def attached_background(path: str | Path) -> NDArray[np.float32] | None:
    """The background (H, W, 3), RGB, that a recording carries; None where it carries none."""
    content = attached_to(Path(path)).get(BACKGROUND)
    if content is None:
        return None
    return image_from_encoded(content, 1, f"{BACKGROUND} in {path}").astype(np.float32)


def _in_mcap(path: Path) -> dict[str, bytes]:
    found: dict[str, bytes] = {}
    for record in mcap_records(path):
        if isinstance(record, Placed):
            break
        if type(record).__name__ == "Attachment" and record.name in ATTACHABLE:
            found[record.name] = record.data
    return found


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
    """Figures of a recording: frames written and missing between them, bytes, seconds from first to last."""

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
    going_on : called after each frame, and four times a second while none comes
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
