"""Record every frame that a grabber holds, in a thread or not, with calibration and background; and share it."""

from __future__ import annotations

import math
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path

import numpy as np

from gelform import Calibration, DataError, Frame, GelformError, Grabber, __version__, load_calibration
from gelform.arrays import MIB, Map
from gelform.errors import Progress, cannot, no_progress
from gelform.foundations.files import check_free, named_file, picture_bytes
from gelform.sensors.mcap import McapRecording, is_bag_folder, mcap_file_in, mcap_records
from gelform.sensors.playback import (
    ATTACHABLE,
    BACKGROUND,
    CALIBRATION,
    Film,
    RecordingFacts,
    image_from_encoded,
)

MAX_ATTACHMENT_BYTES = 64 * MIB  # of one file beside the frames, such as a calibration
KEPT_FRAMES = 32  # held by the grabber for `record_frames`: bridges half a second in which the disk stalls


def attachments_of(calibration: Calibration | None, background: Map | None = None) -> dict[str, bytes]:
    """The files that `new_recording` attaches, by name.

    `background` (H, W, 3) is RGB in whole gray levels, taken after the calibration.
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
    found: dict[str, bytes] = {}
    for *_, record in mcap_records(mcap_file_in(path)):
        kind = type(record).__name__
        if kind == "Message":
            break
        if kind == "Attachment" and record.name in ATTACHABLE:
            found[record.name] = record.data
    for name, content in found.items():
        if len(content) > MAX_ATTACHMENT_BYTES:
            raise DataError(
                f"Expected {name} in {path} of at most {MAX_ATTACHMENT_BYTES // MIB} MB, got {len(content)} bytes."
            )
    return found


def attached_calibration(path: str | Path) -> Calibration | None:
    """The calibration attached to a recording; None if there is none.

    DataError: the recording cannot be read. CalibrationError: the calibration is damaged, or of a newer format.
    """
    content = attached_to(Path(path)).get(CALIBRATION)
    if content is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        written = Path(folder) / CALIBRATION
        written.write_bytes(content)
        return load_calibration(written)


def attached_background(path: str | Path) -> Map | None:
    """The background (H, W, 3), RGB, attached to a recording; None if there is none."""
    content = attached_to(Path(path)).get(BACKGROUND)
    if content is None:
        return None
    return image_from_encoded(content, 1, f"{BACKGROUND} in {path}").astype(np.float32)


@dataclass(frozen=True)
class RecordStats:
    """Figures of a recording."""

    frames: int = 0  # written
    missing: int = 0  # frames between them
    written_bytes: int = 0
    duration_s: float = 0.0  # from first to last

    @property
    def has_gaps(self) -> bool:
        """Whether over 5 % of the frames are missing, which is worth a warning."""
        return self.missing > 0.05 * (self.frames + self.missing)


def why_missing(stats: RecordStats, drops: int) -> str:
    """Why frames of a recording are missing, of which the source lost some (`drops`), and the rate that was kept."""
    all_of, rate_hz = stats.frames + stats.missing, (stats.frames - 1) / max(stats.duration_s, 1e-9)
    lost = min(drops, stats.missing)
    reasons = {
        "lost before gelform got them (cable, hub, or a machine that is slower than the source)": lost,
        "not written, because this machine or its disk was too slow": stats.missing - lost,
    }
    said = " and ".join(f"{count} {why}" for why, count in reasons.items() if count)
    return (
        f"{stats.missing} of {all_of} frames ({100 * stats.missing / all_of:.2g} %) are missing: {said}. {rate_hz:.3g} "
        "frames a second were kept; a lower rate or a smaller picture loses fewer (--set fps=...; USB "
        "cameras: --set width=...)."
    )


def new_recording(
    path: Path, grabber: Grabber, *, calibration_digest: str = "", attached: Mapping[str, bytes] | None = None
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
    name, serial, settings, rate_hz = grabber.name, grabber.serial, grabber.settings, grabber.source.rate_hz
    facts = RecordingFacts(name, serial, settings, rate_hz, calibration_digest, __version__)
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
    stats, after, first_s, began_s = RecordStats(), -1, 0.0, time.monotonic()
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


_naming, _named = threading.Lock(), set[Path]()  # paths of this process, some of which are not written yet


def named_by_time(kind: str) -> str:
    """A name for a new file: its kind and the time in UTC, to the second."""
    return f"{kind}-{time.strftime('%Y%m%d-%H%M%S', time.gmtime())}"


def new_file(folder: Path, kind: str) -> Path:
    """A path for a new MCAP file, named by the time, which no file and no other call in this process has."""
    name = named_by_time(kind)
    with _naming:
        for number in count(1):
            path = folder / f"{name}{'' if number == 1 else f'-{number}'}.mcap"
            if path not in _named and not path.exists():
                break
        _named.add(path)
    return path


class Recorder:
    """One recording in its own thread, which `start` starts: an MCAP file, which needs the extra `mcap`.

    It has a name of its own in the folder, and carries the calibration and the background in use. The running grabber stays
    open for its other consumers. It ends when `wanted()`, called at each frame and four times a second, is False, or at
    `max_bytes` of pictures: 2 GB are six minutes at 60 frames a second, 320x240 px, as PNG. `on_ended` is then called in
    its thread, whatever the reason.
    """

    def __init__(
        self,
        grabber: Grabber,
        folder: Path,
        *,
        calibration: Calibration | None = None,
        background: Map | None = None,
        wanted: Callable[[], bool] = lambda: True,
        on_ended: Callable[[Recorder], None] = lambda _: None,
        max_bytes: int = 2_000_000_000,
    ) -> None:
        self.path = new_file(folder, "recording")
        self.stats = RecordStats()  # so far
        self.problem = ""  # why it ended by itself
        self._grabber, self._drops_before = grabber, grabber.stats.drops
        self._wanted, self._on_ended, self._max_bytes = wanted, on_ended, max_bytes
        self._stop = threading.Event()
        attached = attachments_of(calibration, background)
        digest = _digest_of(calibration)
        self._recording = new_recording(self.path, grabber, calibration_digest=digest, attached=attached)
        self._thread = threading.Thread(target=self._run, name="record", daemon=True)

    @property
    def gaps(self) -> str:
        """Why frames are missing, if so many are that it is worth a warning; else ""."""
        return (
            why_missing(self.stats, self._grabber.stats.drops - self._drops_before)
            if self.stats.has_gaps
            else ""
        )

    def start(self) -> None:
        """Start recording."""
        self._thread.start()

    def close(self) -> None:
        """Finish the file."""
        self._stop.set()
        self._thread.join(5.0)

    def _run(self) -> None:
        try:
            with closing(self._recording):
                self.stats = record_frames(self._grabber, self._recording, going_on=self._going_on)
        except GelformError as problem:
            self.problem = str(problem)
            self.stats = replace(self.stats, frames=self._recording.frames)
        except Exception as problem:
            self.problem = (
                f"The recording has ended by a mistake in gelform: {type(problem).__name__}: {problem}."
            )
            raise
        finally:
            self._on_ended(self)

    def _going_on(self, stats: RecordStats) -> bool:
        self.stats = stats
        if self._stop.is_set():
            return False
        if stats.written_bytes >= self._max_bytes:
            self.problem = (
                f"The recording has ended, because it has reached its limit of {self._max_bytes / 1e9:g} GB."
            )
        elif not self._wanted():
            self.problem = "The recording has ended, because the page that began it was closed."
        return not self.problem


def share(
    recording: Film,
    folder: Path,
    *,
    calibration: Calibration | None,
    background: Map | None = None,
    progress: Progress = no_progress,
) -> Path:
    """Write a new MCAP file of a recording, with its calibration attached; return its path.

    Frames are kept as the camera compressed them, or as lossless PNG. `gelform live FILE` shows the same on any machine.
    `background` (H, W, 3) was taken on the page; None: the calibration's own. The file in `folder` is named by the time.

    DataError: the file cannot be written, a frame is damaged, or the extra `mcap` is missing.
    """
    facts = replace(recording.camera, calibration_digest=_digest_of(calibration), library_version=__version__)
    path = new_file(folder, "shared")
    check_free(path, overwrite=False)
    now_ns, attached = time.time_ns(), attachments_of(calibration, background)
    unfinished = path.with_name(f".{path.name}.part")  # not listed: half a recording is not offered
    try:
        with closing(McapRecording(unfinished, facts, attached)) as out:
            for number, time_s in enumerate(recording.times_s):
                progress(number, len(recording.times_s), "one file to share")
                frame = recording[number]
                stamp = frame.wall_time_ns or now_ns + round(1e9 * time_s)
                out.write(Frame(frame.image, time_s, stamp, number, frame.encoded))
        with cannot(f"write {path}"):
            named_file(unfinished, path, overwrite=False)
    finally:
        unfinished.unlink(missing_ok=True)
    return path


def _digest_of(calibration: Calibration | None) -> str:
    return "" if calibration is None else calibration.digest
