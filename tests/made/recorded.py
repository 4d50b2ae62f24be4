"""Frames to record, and a camera that gives them to a grabber."""

import numpy as np

from gelform.image.frame import Frame
from gelform.sensors.playback import Playback
from gelform.sensors.recordings.facts import RecordingFacts
from gelform.sensors.recordings.mcap_writer import McapRecording
from made.mjpeg_server import jpeg

START_NS = 1_700_000_000_000_000_000
FACTS = RecordingFacts("a camera", "S1", {"gain": 3.0}, 50.0, "abc")


def frames(count=6, shape=(48, 64), encoded=False, rate_hz=50.0):
    """Frames of noise (of one color where encoded), unevenly spaced, with one index left out."""
    rng = np.random.default_rng(0)
    made = []
    for k in range(count):
        index = k + (k > 2)
        time_s = 1000.0 + index / rate_hz + (0.003 if k == 1 else 0)
        content = jpeg(shape, (200, 10 * k, 5)) if encoded else None
        image = rng.integers(0, 256, (*shape, 3), dtype=np.uint8)
        made.append(Frame(image, time_s, START_NS + round(index / rate_hz * 1e9), index, content))
    return made


def recorded(path, given, facts=None, attached=None):
    """The path, after the frames were written to a recording there."""
    recording = McapRecording(path, facts or FACTS, attached)
    for frame in given:
        recording.write(frame)
    recording.close()
    return path


def camera(count=6, **how):
    """A function that opens a source of those frames, at their pace."""
    return lambda: Playback(lambda: frames(count, **how), FACTS, paced=True)
