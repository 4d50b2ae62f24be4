"""A recording in a thread of its own, and one file of a recording and its calibration, for sharing."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gelform import __version__
from gelform.calibration_file import Calibration
from gelform.errors import GelformError
from gelform.foundations.npz_files import check_free
from gelform.foundations.progress import Progress, no_progress
from gelform.image.frame import Frame
from gelform.sensors.grabber import Grabber
from gelform.sensors.recordings.indexed import Indexed
from gelform.sensors.recordings.mcap_writer import McapRecording
from gelform.sensors.recordings.record import RecordStats, attachments_of, new_recording, record_frames

# bytes of pictures in one recording: six minutes at 60 frames per second, 320x240 px, as PNG
MAX_BYTES = 2 * 10**9
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
    """One recording in its own thread: an MCAP file, which needs the extra `mcap`.

    `start` starts it.

    Parameters
    ----------
    grabber : running; stays open for its other consumers
    folder : parent of the recording, which gets its own name
    calibration, background : in use, or None; they are attached to the recording
    wanted : called at each frame, and four times a second; the recording ends when it returns False
    on_ended : called in the recording's thread once the recording is finished, for whatever reason
    max_bytes : size of the pictures at which the recording ends

    Attributes
    ----------
    path : of the recording
    stats : RecordStats so far
    problem : why it ended by itself; "" if it did not
    """

    def __init__(
        self,
        grabber: Grabber,
        folder: Path,
        *,
        calibration: Calibration | None = None,
        background: NDArray[np.float32] | None = None,
        wanted: Callable[[], bool] = lambda: True,
        on_ended: Callable[[Recorder], None] = lambda _: None,
        max_bytes: int = MAX_BYTES,
    ) -> None:
        self.path = new_file(folder, "recording")
        self.stats = RecordStats(0, 0, 0, 0.0)
        self.problem = ""
        self._grabber = grabber
        self._wanted, self._on_ended, self._max_bytes = wanted, on_ended, max_bytes
        self._stop = threading.Event()
        attached = attachments_of(calibration, background)
        digest = _digest_of(calibration)
        self._recording = new_recording(self.path, grabber, calibration_digest=digest, attached=attached)
        self._thread = threading.Thread(target=self._run, name="record", daemon=True)

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
    recording: Indexed,
    folder: Path,
    *,
    calibration: Calibration | None,
    background: NDArray[np.float32] | None = None,
    progress: Progress = no_progress,
) -> Path:
    """Write a new MCAP file of a recording, with its calibration attached; return its path.

    Frames are kept as the camera compressed them, or as lossless PNG. `gelform live FILE` shows the same on any machine.

    Parameters
    ----------
    recording : any
    folder : of the file, which is named by the time
    calibration : in use
    background : (H, W, 3) taken on the page, or None: the calibration's own

    Raises
    ------
    DataError
        The file cannot be written, a frame is damaged, or the extra `mcap` is missing.
    """
    facts = replace(recording.facts, calibration_digest=_digest_of(calibration), library_version=__version__)
    path = new_file(folder, "shared")
    check_free(path, overwrite=False)
    now_ns, attached = time.time_ns(), attachments_of(calibration, background)
    unfinished = path.with_name(f".{path.name}.part")  # not listed: half a recording is not offered
    try:
        with closing(McapRecording(unfinished, facts, attached)) as out:
            for number, time_s in enumerate(recording.times_s):
                progress(number, len(recording), "one file to share")
                frame = recording.frame(number)
                stamp = frame.wall_time_ns or now_ns + round(1e9 * time_s)
                out.write(Frame(frame.image, time_s, stamp, number, frame.encoded))
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)
    return path


def _digest_of(calibration: Calibration | None) -> str:
    return "" if calibration is None else calibration.digest
