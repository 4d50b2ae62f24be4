"""One door to every source of frames."""

import cv2
import numpy as np
import pytest

import gelform
from gelform.errors import DataError, SensorError
from gelform.sensors.source import open_source


def test_simulated_comes_at_its_rate_and_counts():
    with gelform.open_source("simulated", rate_hz=100.0) as source:
        assert source.live
        frames = [frame for _, frame in zip(range(4), source)]
    assert [frame.index for frame in frames] == sorted({frame.index for frame in frames})
    assert source.settings == {"width": 320, "height": 240, "fps": 100.0}
    assert frames[0].image.shape == (240, 320, 3)


def test_an_unknown_simulated_sensor_lists_those_there_are():
    with pytest.raises(SensorError, match=r"three-edges.*gelsight-mini"):
        open_source("simulated:gelsigt")


def test_a_folder_and_a_video(tmp_path):
    cv2.imwrite(str(tmp_path / "0.png"), np.zeros((4, 4, 3), np.uint8))
    assert [frame.index for frame in open_source(tmp_path)] == [0]
    assert open_source(str(tmp_path), paced=True).live
    with pytest.raises(DataError, match="No video file"):
        open_source(tmp_path / "none.mp4")


def test_what_is_no_source_says_what_is(tmp_path):
    (tmp_path / "notes.txt").write_text("x")
    with pytest.raises(DataError, match=r"is no video, no folder of images and no recording"):
        open_source(tmp_path / "notes.txt")
    with pytest.raises(DataError, match="Check the path"):
        open_source(tmp_path / "none")
    with pytest.raises(TypeError, match="text or a path"):
        open_source(3)


def test_a_name_is_a_cameras(monkeypatch):
    monkeypatch.setattr("gelform.sensors.cameras.camera.cameras_there", lambda: [])
    for spec in ("D20123", "", "/dev/video77"):
        with pytest.raises(SensorError, match=r"No camera.*plugged in"):
            open_source(spec)


def test_what_cannot_be_set_refuses_settings(tmp_path):
    cv2.imwrite(str(tmp_path / "0.png"), np.zeros((4, 4, 3), np.uint8))
    for spec in ("simulated", tmp_path):
        with pytest.raises(SensorError, match="is no USB camera: exposure cannot be set"):
            open_source(spec, settings={"exposure": 5})
        open_source(spec, settings={}).close()
