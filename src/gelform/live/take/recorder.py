"""Records a station's frames as the camera gave them, from a button to the next."""

from __future__ import annotations

import importlib.util
import threading
import time
from pathlib import Path

from gelform.errors import GelformError
from gelform.live.setup import Setup
from gelform.sensors.grabber import Grabber
from gelform.sensors.recordings.record import RecordStats, attachments_of, new_recording, record_frames


def named_by_time(kind: str) -> str:
    """The name of what the page makes: its kind and the time in UTC, to the second."""
    return f"{kind}-{time.strftime('%Y%m%d-%H%M%S', time.gmtime())}"


class Recorder:
    """One recording, in a thread of its own; a file where the extra `mcap` is installed, else a folder of images.

    Parameters
    ----------
    grabber : running; it goes on for its other consumers
    folder : where the recording is made, under a name of its own
    setup : whose calibration and background the recording carries

    Attributes
    ----------
    path : of the recording
    stats : RecordStats so far
    problem : why it ended early; "" where it did not
    """

    def __init__(self, grabber: Grabber, folder: Path, setup: Setup | None = None) -> None:
        suffix = ".mcap" if importlib.util.find_spec("mcap") else ""
        self.path = folder / f"{named_by_time('recording')}{suffix}"
        self.stats = RecordStats(0, 0, 0, 0.0)
        self.problem = ""
        self._grabber = grabber
        self._stop = threading.Event()
        calibration = None if setup is None else setup.calibration
        self._recording = new_recording(
            self.path,
            grabber,
            calibration_digest="" if calibration is None else calibration.digest,
            attached=attachments_of(calibration, None if setup is None else setup.background),
        )
        self._thread = threading.Thread(target=self._run, name="record", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Finish the file."""
        self._stop.set()
        self._thread.join(5.0)

    def _run(self) -> None:
        try:
            self.stats = record_frames(self._grabber, self._recording, going_on=self._going_on)
        except GelformError as problem:
            self.problem = str(problem)
        finally:
            self._recording.close()

    def _going_on(self, stats: RecordStats) -> bool:
        self.stats = stats
        return not self._stop.is_set()
