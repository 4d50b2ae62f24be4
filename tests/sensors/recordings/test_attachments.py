"""What a recording carries: the same bytes in a file and in a folder, read back and checked."""

import numpy as np
import pytest

from gelform.errors import CalibrationError, DataError
from gelform.frames import Frame
from gelform.sensors.recordings.attachments import (
    attached_background,
    attached_calibration,
    attached_to,
    attachments_of,
)
from gelform.sensors.recordings.facts import RecordingFacts
from gelform.sensors.recordings.image_folder import FolderRecording
from gelform.sensors.recordings.mcap_writer import McapRecording

KINDS = [(McapRecording, "a.mcap"), (FolderRecording, "a")]


def written(kind, path, attached):
    recording = kind(path, RecordingFacts("ring"), attached)
    recording.write(Frame(np.zeros((8, 8, 3), np.uint8), 0.0, 10**18, 0))
    recording.close()
    return path


@pytest.mark.parametrize(("kind", "name"), KINDS)
def test_calibration_and_background_come_back(kind, name, tmp_path, calibration):
    background = np.rint(calibration.background)
    path = written(kind, tmp_path / name, attachments_of(calibration, background))
    assert attached_calibration(path).digest == calibration.digest
    np.testing.assert_array_equal(attached_background(path), background)


@pytest.mark.parametrize(("kind", "name"), KINDS)
def test_a_recording_may_carry_nothing(kind, name, tmp_path):
    path = written(kind, tmp_path / name, {})
    assert attached_to(path) == {}
    assert attached_calibration(path) is None
    assert attached_background(path) is None


@pytest.mark.parametrize(("kind", "name"), KINDS)
def test_a_damaged_attachment_is_said(kind, name, tmp_path, calibration):
    content = bytearray(attachments_of(calibration)["calibration.npz"])
    content[len(content) // 2] ^= 0xFF
    damaged = {"calibration.npz": bytes(content), "background.png": b"\x89PNG torn"}
    path = written(kind, tmp_path / name, damaged)
    with pytest.raises(CalibrationError):
        attached_calibration(path)
    with pytest.raises(DataError, match=r"background\.png"):
        attached_background(path)


def test_images_beside_a_plain_folder_are_not_attachments(tmp_path):
    (tmp_path / "background.png").write_bytes(b"x")
    assert attached_to(tmp_path) == {}


def test_an_attachment_of_no_size_is_refused(tmp_path, monkeypatch):
    path = written(McapRecording, tmp_path / "a.mcap", {"calibration.npz": bytes(2000)})
    monkeypatch.setattr("gelform.sensors.recordings.attachments.MAX_BYTES", 1000)
    with pytest.raises(DataError, match="at most"):
        attached_to(path)
