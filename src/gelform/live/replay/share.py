"""One file of a recording that holds all that is needed to see the same: frames, times, calibration, background."""

from __future__ import annotations

import os
import time
from contextlib import closing
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gelform import __version__
from gelform.calibration_file import Calibration
from gelform.frames import Frame
from gelform.live.replay.indexed import Indexed
from gelform.npz_files import check_free
from gelform.progress import Progress, no_progress
from gelform.sensors.recordings.facts import RecordingFacts
from gelform.sensors.recordings.mcap_writer import McapRecording
from gelform.sensors.recordings.record import attachments_of


def share(
    recording: Indexed,
    path: Path,
    *,
    calibration: Calibration | None,
    background: NDArray[np.float32] | None = None,
    progress: Progress = no_progress,
) -> Path:
    """Write an MCAP file of a recording, with its calibration attached.

    Frames are kept as the camera compressed them, or as PNG without loss: `gelform live FILE` anywhere shows what is
    shown here.

    Parameters
    ----------
    recording : any
    path : a new file, *.mcap
    calibration : in use
    background : (H, W, 3) that was taken on the page, or None: the calibration's own

    Raises
    ------
    DataError
        The file is there already or cannot be written, a frame is damaged, or the extra `mcap` is missing.
    """
    digest = "" if calibration is None else calibration.digest
    facts = RecordingFacts(
        recording.name, recording.serial, recording.settings, recording.rate_hz, digest, __version__
    )
    check_free(path, overwrite=False)
    now_ns, attached = time.time_ns(), attachments_of(calibration, background)
    unfinished = path.with_name(f".{path.name}.part")  # no name of the list: half a recording is not offered
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
