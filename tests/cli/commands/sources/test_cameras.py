"""gelform cameras: what is plugged in, and what to do where nothing is."""

import numpy as np
import pytest

from gelform.sensors.cameras import camera, usb
from gelform.sensors.cameras import survey as surveyed
from gelform.sensors.cameras.camera import Camera
from gelform.sensors.cameras.survey import Mode
from made.capture import Capture

IMAGE = np.zeros((240, 320, 3), np.uint8)


@pytest.fixture
def plugged_in(monkeypatch, tmp_path):
    def plug(*cameras):
        monkeypatch.setattr(camera, "cameras_there", lambda: list(cameras))

    return plug


def test_nothing_there_says_what_to_do(run, run_json, plugged_in):
    plugged_in()
    code, out, err = run("cameras")
    assert (code, out) == (0, "")
    assert "Plug one in" in err
    assert "simulated" in err
    assert run_json("cameras") == {"cameras": []}


def test_a_camera_with_its_modes_and_measured_rate(run, run_json, plugged_in, monkeypatch, tmp_path):
    path = tmp_path / "video0"
    path.write_text("")
    plugged_in(Camera("DIGIT", str(path), "D1", "2833:0209", "/dev/v4l/by-path/p4", "digit"))
    monkeypatch.setattr(usb, "_opened", lambda _: Capture([IMAGE] * 1000))
    monkeypatch.setattr(surveyed, "MEASURED_S", 0.02)
    monkeypatch.setattr(surveyed, "modes_of", lambda _: [Mode("YUYV", (240, 320), 60.0)] * 6)
    (found,) = run_json("cameras")["cameras"]
    assert (found["serial"], found["sensor"], found["problem"]) == ("D1", "digit", None)
    assert found["modes"][0] == {"fourcc": "YUYV", "size_px": [240, 320], "rate_hz": 60.0}
    assert found["rate_hz"] > 0
    assert found["settings"]["fps"] == 60.0
    out = run("cameras")[1]
    for said in ("DIGIT", "D1", str(path), "YUYV 240x320 at 60 Hz", "and 2 more"):
        assert said in out


def test_what_cannot_be_opened_says_why_and_the_others_are_listed(run, run_json, plugged_in, tmp_path):
    gone = Camera("DIGIT", str(tmp_path / "video0"), "D1")
    plugged_in(gone, Camera("GelSight", str(tmp_path / "video2"), "S1"))
    code, out, err = run("cameras")
    assert code == 0
    assert "GelSight" in out
    assert err.count("unplugged") == 2
    assert run_json("cameras", "--no-measure")["cameras"][0]["problem"] is None
