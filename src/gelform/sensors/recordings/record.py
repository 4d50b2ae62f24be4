"""Record every frame that a grabber holds, in order, with calibration and background."""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gelform import __version__
from gelform.calibration_file import Calibration, load_calibration
from gelform.errors import DataError
from gelform.foundations.pictures import picture_bytes
from gelform.sensors.grabber import Grabber
from gelform.sensors.recordings.facts import (
    ATTACHABLE,
    BACKGROUND,
    CALIBRATION,
    RecordingFacts,
    image_from_encoded,
)
from gelform.sensors.recordings.mcap_reader import PlacedMessage, is_bag_folder, mcap_file_in, mcap_records
from gelform.sensors.recordings.mcap_writer import McapRecording

MAX_ATTACHMENT_BYTES = 64 * 2**20
KEPT_FRAMES = 32  # held by the grabber for `record_frames`: bridges half a second in which the disk stalls


def attachments_of(
    calibration: Calibration | None, background: NDArray[np.floating] | None = None
) -> dict[str, bytes]:
    """The files that `new_recording` attaches, by name.

    Parameters
    ----------
    calibration : the one in use, or None
    background : (H, W, 3) RGB in whole gray levels, taken after the calibration, or None
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
    """The attachments of a recording that stand before its first frame.

    Videos and plain folders of images have none.

    DataError: the file cannot be read, or an attachment is larger than 64 MB.
    """
    if path.suffix.lower() != ".mcap" and not is_bag_folder(path):
        return {}
    found = _in_mcap(mcap_file_in(path) if path.is_dir() else path)
    for name, content in found.items():
        if len(content) > MAX_ATTACHMENT_BYTES:
            raise DataError(
                f"Expected {name} in {path} of at most {MAX_ATTACHMENT_BYTES >> 20} MB, got {len(content)} bytes."
            )
    return found


def attached_calibration(path: str | Path) -> Calibration | None:
    """The calibration attached to a recording; None if there is none.

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
    """The background (H, W, 3), RGB, attached to a recording; None if there is none."""
    content = attached_to(Path(path)).get(BACKGROUND)
    if content is None:
        return None
    return image_from_encoded(content, 1, f"{BACKGROUND} in {path}").astype(np.float32)


def _in_mcap(path: Path) -> dict[str, bytes]:
    found: dict[str, bytes] = {}
    for record in mcap_records(path):
        if isinstance(record, PlacedMessage):
            break
        if type(record).__name__ == "Attachment" and record.name in ATTACHABLE:
            found[record.name] = record.data
    return found


@dataclass(frozen=True)
class RecordStats:
    """Figures of a recording: frames written, frames missing between them, bytes, seconds from first to last."""

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
) -> McapRecording:
    """A new recording for a grabber.

    Parameters
    ----------
    path : a new file, *.mcap
    grabber : already entered
    calibration_digest : digest of the calibration in use
    attached : attached files by name: `attachments_of`

    Raises
    ------
    DataError
        The name does not end so, the file exists or cannot be written, or the extra `mcap` is not installed.
    """
    if path.suffix.lower() != ".mcap":
        raise DataError(f"Expected a new file *.mcap, got {path}. A recording is written as MCAP.")
    rate = grabber.source.rate_hz
    facts = RecordingFacts(
        grabber.name, grabber.serial, grabber.settings, rate, calibration_digest, __version__
    )
    return McapRecording(path, facts, attached)


def record_frames(
    grabber: Grabber,
    recording: McapRecording,
    *,
    seconds: float | None = None,
    frames: int | None = None,
    going_on: Callable[[RecordStats], bool] = lambda _: True,
) -> RecordStats:
    """Write frames until the limit is reached, the source ends, or `going_on` returns False.

    Parameters
    ----------
    grabber : already entered; with `keep=KEPT_FRAMES` no frame is lost while the disk is busy
    recording : stays open
    seconds, frames : limit of duration by the frames' times, or of their number; None: no limit
    going_on : called after each frame, and four times a second while none arrives
    """
    stats, after, first_s, began_s = RecordStats(0, 0, 0, 0.0), -1, 0.0, time.monotonic()
    limit_s = math.inf if seconds is None else seconds
    while going_on(stats) and (frames is None or stats.frames < frames):
        frame = grabber.following(after, timeout_s=0.25)
        if frame is None:
            late = grabber.source.live and time.monotonic() - began_s > limit_s
            if grabber.state == "ended" or late:
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
