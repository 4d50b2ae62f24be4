"""One short sequence in every form in which it can be recorded."""

import time

import cv2
import numpy as np
import pytest

from gelform.frames import Frame
from gelform.sensors.recordings.facts import RecordingFacts
from gelform.sensors.recordings.image_folder import FolderRecording
from gelform.sensors.recordings.mcap_writer import McapRecording

COUNT, RATE_HZ = 7, 20.0
FORMS = ("mcap", "recorded", "images", "video")


@pytest.fixture(scope="session")
def frames(simulated):
    """Presses, one after the other."""
    start_ns = time.time_ns()
    return [
        Frame(press.image, 5.0 + k / RATE_HZ, start_ns + round(1e9 * k / RATE_HZ), k)
        for k, press in enumerate(simulated.presses[:COUNT])
    ]


@pytest.fixture(scope="session")
def forms(frames, tmp_path_factory):
    """Path by form; the video is without loss (FFV1)."""
    base = tmp_path_factory.mktemp("forms")
    facts = RecordingFacts("ring", "S7", {"exposure": 50.0}, RATE_HZ)
    written = {"mcap": McapRecording(base / "a.mcap", facts), "recorded": FolderRecording(base / "b", facts)}
    height, width = frames[0].image.shape[:2]
    video = cv2.VideoWriter(str(base / "c.avi"), cv2.VideoWriter.fourcc(*"FFV1"), RATE_HZ, (width, height))
    (base / "d").mkdir()
    for frame in frames:
        for one in written.values():
            one.write(frame)
        video.write(np.ascontiguousarray(frame.image[..., ::-1]))
        cv2.imwrite(str(base / "d" / f"{frame.index:03d}.png"), frame.image[..., ::-1])
    for one in written.values():
        one.close()
    video.release()
    return {"mcap": base / "a.mcap", "recorded": base / "b", "video": base / "c.avi", "images": base / "d"}
