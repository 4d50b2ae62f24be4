"""A USB camera: calls of OpenCV and their results, and the reason if it cannot be opened."""

import os
import subprocess
import sys
import time

import cv2
import numpy as np
import pytest

from gelform.errors import SensorError, SourceLostError
from gelform.sensors.cameras import usb
from gelform.sensors.cameras.camera import Camera
from gelform.sensors.cameras.usb import check_access, in_use, programs_that_hold, udev_rule
from made.capture import Capture, large_jpeg

BGR = np.full((240, 320, 3), (10, 30, 200), np.uint8)


@pytest.fixture
def camera(tmp_path):
    def made(capture, monkeypatch, settings=None, kind=None):
        (tmp_path / "video0").write_text("")
        monkeypatch.setattr(usb, "_opened", lambda _: capture)
        return usb.UsbCamera(Camera("DIGIT", str(tmp_path / "video0"), "D1", kind=kind), settings)

    return made


def test_frames_are_rgb_and_counted(camera, monkeypatch):
    source = camera(Capture([BGR, BGR]), monkeypatch)
    reader = iter(source)
    first, second = next(reader), next(reader)
    np.testing.assert_array_equal(first.image[0, 0], (200, 30, 10))
    assert (first.index, second.index) == (0, 1)
    assert 0 <= time.monotonic() - first.time_s < 5
    assert (source.name, source.serial, source.rate_hz) == ("DIGIT", "D1", 30.0)
    assert source.settings["width"] == 320
    assert source.settings["fourcc"] == "YUYV"
    with pytest.raises(SourceLostError, match="unplugged"):
        next(reader)


def test_the_drivers_time_stamp_is_taken_where_it_is_of_our_clock(camera, monkeypatch):
    taken = time.monotonic() - 0.02
    stamped = next(iter(camera(Capture([BGR], pos_msec=1000 * taken), monkeypatch)))
    assert stamped.time_s == pytest.approx(taken)
    foreign = next(iter(camera(Capture([BGR], pos_msec=1e9), monkeypatch)))
    assert foreign.time_s == pytest.approx(time.monotonic(), abs=1)


def test_large_jpegs_come_undecoded_and_are_reduced(camera, monkeypatch):
    fourcc = float(cv2.VideoWriter.fourcc(*"MJPG"))
    pictures = [large_jpeg(), large_jpeg()[:5000], None, large_jpeg()]
    capture = Capture(pictures, fourcc=fourcc, frame_width=1280.0, frame_height=960.0)
    source = camera(capture, monkeypatch)
    assert source.settings["reduced"] == 2
    reader = iter(source)
    first, fourth = next(reader), next(reader)
    assert first.image.shape == (480, 640, 3)
    np.testing.assert_allclose(first.image[10, 10], (200, 30, 10), atol=3)
    assert first.encoded == large_jpeg()
    assert (first.index, fourth.index) == (0, 3)


def test_a_known_camera_gets_its_usual_mode(camera, monkeypatch):
    source = camera(Capture([], zoom=0.0), monkeypatch, kind="digit")
    found = [source.settings[name] for name in ("height", "fps", "fourcc", "led_level")]
    assert found == [240, 60.0, "YUYV", 0.0]
    assert camera(Capture([]), monkeypatch).settings["fps"] == 30.0


def test_a_wish_that_is_not_met_is_an_error_and_gives_the_camera_back(camera, monkeypatch):
    capture = Capture([], limits={cv2.CAP_PROP_FRAME_HEIGHT: (0, 480)})
    with pytest.raises(SensorError, match="expected height 960, but it has 480"):
        camera(capture, monkeypatch, {"width": 1280, "height": 960})
    assert capture.released == 1
    stubborn = Capture([], limits={cv2.CAP_PROP_FOURCC: (cv2.VideoWriter.fourcc(*"YUYV"),) * 2})
    with pytest.raises(SensorError, match="expected fourcc MJPG, but it has YUYV afterwards"):
        camera(stubborn, monkeypatch, {"fourcc": "MJPG"})
    with pytest.raises(SensorError, match="expected fourcc mjpg, but it has YUYV afterwards"):
        camera(stubborn, monkeypatch, {"fourcc": "mjpg"})
    assert camera(stubborn, monkeypatch, {"fourcc": "YUYV"}).settings["fourcc"] == "YUYV"
    for wrong in ("MJ", "MJPEG", "MJP\u00c9"):
        with pytest.raises(ValueError, match="fourcc as four letters"):
            camera(Capture([]), monkeypatch, {"fourcc": wrong})
    with pytest.raises(SensorError, match="gain"):
        camera(capture, monkeypatch, {"gain": 3})


def test_a_loop_ends_when_closed_or_with_nothing_but_torn_pictures(camera, monkeypatch):
    with camera(Capture([BGR] * 5), monkeypatch) as source:
        reader = iter(source)
        next(reader)
    assert list(reader) == []
    with pytest.raises(SourceLostError, match="torn"):
        list(camera(Capture([None] * 20), monkeypatch))
    assert usb.fourcc_text(cv2.VideoWriter.fourcc(*"MJPG")) == "MJPG"
    assert (usb.fourcc_text(0), usb.fourcc_text(-1)) == ("", "")


def test_controls_are_set_between_frames_and_read_back(camera, monkeypatch):
    capture = Capture([BGR], limits={cv2.CAP_PROP_GAIN: (0, 10)}, exposure=50.0, gain=1.0, auto_exposure=3.0)
    source = camera(capture, monkeypatch)
    assert source.set_controls({"exposure": 70})["exposure"] == 70
    assert source.settings["auto_exposure"] == 1.0
    with pytest.raises(SensorError, match="10 afterwards"):
        source.set_controls({"gain": 20})
    assert source.settings["gain"] == 10  # what it has now, although it was refused
    source.close()
    with pytest.raises(SensorError, match="closed"):
        source.set_controls({"exposure": 60})


linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs Linux's files")


def camera_at(path, usb_id="2833:0209"):
    return Camera("DIGIT", str(path), "D1", usb_id)


def test_the_rule_names_the_device():
    assert udev_rule("2833:0209") == (
        'SUBSYSTEM=="video4linux", ATTRS{idVendor}=="2833", ATTRS{idProduct}=="0209", MODE="0660", GROUP="video", '
        'TAG+="uaccess"'
    )
    assert udev_rule(None).startswith('SUBSYSTEM=="video4linux", MODE')


def test_an_unplugged_camera_says_so(tmp_path):
    with pytest.raises(SensorError, match=r"DIGIT \(serial D1.*was unplugged"):
        check_access(camera_at(tmp_path / "video0"))
    with pytest.raises(SensorError, match="not there any more"):
        usb.UsbCamera(camera_at(tmp_path / "video7"))


@linux
def test_a_forbidden_one_gives_the_rule(tmp_path):
    """In a child without root's rights: root may open everything."""
    forbidden = tmp_path / "video0"
    forbidden.write_text("")
    forbidden.chmod(0)
    for folder in (tmp_path, *tmp_path.parents[:2]):
        folder.chmod(0o755)
    ours, theirs = os.pipe()
    child = os.fork()
    if child == 0:
        if os.getuid() == 0:
            os.setuid(65534)
        try:
            check_access(camera_at(forbidden))
            said = "opened"
        except SensorError as problem:
            said = str(problem)
        os.write(theirs, said.encode())
        os._exit(0)
    os.waitpid(child, 0)
    said = os.read(ours, 4096).decode()
    os.close(ours)
    os.close(theirs)
    assert "permission denied" in said
    assert udev_rule("2833:0209") in said
    assert "udevadm" in said


@linux
def test_who_holds_a_camera_is_named(tmp_path):
    held = tmp_path / "video0"
    held.write_text("")
    with subprocess.Popen(["sleep", "30"], stdin=held.open("rb")) as holder:
        try:
            assert programs_that_hold(str(held)) == [f"sleep (process {holder.pid})"]
            assert f"in use by sleep (process {holder.pid})" in str(in_use(camera_at(held)))
        finally:
            holder.kill()
    assert programs_that_hold(str(held)) == []
    assert "another program" in str(in_use(camera_at(held)))
