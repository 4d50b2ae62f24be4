"""Cameras as Linux lists them, the choice among several, their settings.

A USB camera: calls of OpenCV and their results, and the reason if it cannot be opened.
"""

import errno
import os
import re
import shutil
import stat
import subprocess
import sys
import time

import cv2
import numpy as np
import pytest

from gelform.errors import SensorError, SourceLostError
from gelform.sensors import cameras
from gelform.sensors.cameras import (
    Camera,
    calibrated_settings,
    camera_named,
    cameras_in_sysfs,
    cameras_there,
    check_access,
    check_settings,
    chosen_camera,
    controls_of,
    in_use,
    kind_of,
    programs_that_hold,
    set_controls,
    settings_mismatch,
    udev_rule,
)
from made.sources import DIGIT, MINI, Capture, large_jpeg, plug_in

linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs Linux's files")
MINI_CAMERA = Camera(
    "GelSight Mini R0B 2871", "/dev/video0", "S1", "0c45:636d", "/dev/v4l/by-path/p2", "gelsight-mini"
)
DIGIT_CAMERA = Camera("DIGIT", "/dev/video2", "D20123", "2833:0209", "/dev/v4l/by-path/p4", "digit")
OTHER = Camera("D20123", "/dev/video4", "X9")  # named as another's serial
PLUGGED_IN = [MINI_CAMERA, DIGIT_CAMERA, OTHER]


TWINS = [
    Camera("cam", f"/dev/video{number}", "200901010001", by_path=f"/dev/v4l/by-path/p{number + 2}")
    for number in (0, 2)
]
LIKE = [Camera("cam", "/dev/video0", serial=serial) for serial in ("D20123", "Pru\u0308fling")]


def test_by_serial_first_name_second_path_last_and_the_only_one_needs_no_name():
    for spec, camera in {
        "S1": MINI_CAMERA,
        "D20123": DIGIT_CAMERA,  # the serial goes before the name
        "DIGIT": DIGIT_CAMERA,
        "digit": DIGIT_CAMERA,
        "gelsight-mini": MINI_CAMERA,
        "gelsight": MINI_CAMERA,
        "/dev/video4": OTHER,
        "2": DIGIT_CAMERA,  # the name of the first has a 2
        "02": DIGIT_CAMERA,
        "/dev/v4l/by-path/p2": MINI_CAMERA,
    }.items():
        assert chosen_camera(spec, PLUGGED_IN) is camera
    assert chosen_camera("/dev/v4l/by-path/p4", TWINS) is TWINS[1]
    assert chosen_camera("", [DIGIT_CAMERA]) is DIGIT_CAMERA


@pytest.mark.parametrize(
    ("spec", "there", "said"),
    [
        ("200901010001", TWINS, r"name one by its path.*by-path/p2.*by-path/p4"),
        ("", PLUGGED_IN, r"Several cameras are plugged in: name one by its serial.*S1.*D20123.*X9"),
        *(
            (spec, PLUGGED_IN, f"No camera '{spec}'.*Plugged in: GelSight")
            for spec in ("1", "28", "R0", "di")
        ),
        ("D9", PLUGGED_IN, r"No camera 'D9'.*DIGIT \(serial D20123, /dev/video2"),
        *((spec, [], r"No camera is plugged in.*simulated") for spec in ("", "D9")),
        ("d20123", LIKE, "'D20123' differs from 'd20123'.*compared letter by letter"),
        ("Pr\u00fcfling", LIKE, r"'Pru.u0308fling' differs.*compared letter by letter"),
        ("D20124", LIKE, r"No camera 'D20124', and no file or folder of that name\. Plugged in"),
    ],
)
def test_several_none_and_serials_that_only_look_alike_are_named(spec, there, said):
    with pytest.raises(SensorError, match=said):
        chosen_camera(spec, there)


def test_names_serials_and_paths_are_those_of_the_usb_device(tmp_path):
    plug_in(tmp_path, 0, "GelSight Mini R0B 2871-46HU", MINI, "2871-46HU", "1-2")
    plug_in(tmp_path, 2, "DIGIT", DIGIT, "D20123", "1-4")
    mini, digit = cameras_in_sysfs(tmp_path)
    if sys.platform.startswith("linux"):
        assert cameras_there(tmp_path) == [mini, digit]
    assert (mini.name, mini.serial, mini.path) == ("GelSight Mini R0B 2871-46HU", "2871-46HU", "/dev/video0")
    assert (mini.usb_id, mini.kind) == (MINI, "gelsight-mini")
    assert mini.by_path == "/dev/v4l/by-path/pci-0000:00:14.0-usb-0:2:1.0-video-index0"
    assert (digit.serial, digit.kind, digit.path) == ("D20123", "digit", "/dev/video2")


def test_metadata_nodes_are_skipped_numbers_sort_and_a_device_that_goes_away_leaves_no_traceback(tmp_path):
    plug_in(tmp_path, 10, "b", "1:2", "B", "1-3", nodes=4)
    device = plug_in(tmp_path, 2, "a", "1:2", "A", "1-2")
    assert [camera.path for camera in cameras_in_sysfs(tmp_path)] == ["/dev/video2", "/dev/video10"]
    shutil.rmtree(device)
    assert {camera.serial for camera in cameras_in_sysfs(tmp_path)} == {"B", None}
    shutil.rmtree(tmp_path / "sys")
    assert cameras_in_sysfs(tmp_path) == []


def test_a_camera_without_serial_or_not_on_usb(tmp_path):
    plug_in(tmp_path, 0, "Webcam", "046d:0825", None, "1-1")
    plug_in(tmp_path, 2, "Laptop", None, None, "1-5")
    plug_in(tmp_path, 4, "Webcam", "046d:0825", "", "1-6")
    webcam, laptop, empty = cameras_in_sysfs(tmp_path)
    assert (webcam.serial, webcam.kind, webcam.name) == (None, None, "Webcam")
    assert (laptop.usb_id, laptop.serial, laptop.name) == (None, None, "Laptop: Laptop")
    assert empty.serial is None
    assert (kind_of(DIGIT), kind_of("1:2"), kind_of(None)) == ("digit", None, None)


@linux
def test_a_device_by_its_path_and_one_that_is_no_camera():
    listed = Camera("a", "/dev/null", "S")
    assert camera_named("/dev/null", [listed]) is listed
    assert camera_named("S", [listed]) is listed
    with pytest.raises(SensorError, match=r"/dev/null is no camera. Plugged in: none"):
        camera_named("/dev/null", [])
    with pytest.raises(SensorError, match=r"Plugged in: a \(serial S"):
        camera_named("/dev/zero", [listed])


@linux
def test_a_camera_that_is_not_listed_opens_by_its_path():
    """A container may have the device and no sysfs."""
    path = f"/dev/gelform-test-{os.getpid()}"
    try:
        os.mknod(path, stat.S_IFCHR | 0o600, os.makedev(81, 250))
    except OSError:
        pytest.skip("may not make a device file here")
    try:
        assert camera_named(path, []).path == path
    finally:
        os.unlink(path)


def test_what_is_set_is_read_back_automatics_go_off_and_the_rest_stays():
    automatic = {"auto_exposure": 3.0, "wb_temperature": 4000.0, "auto_wb": 1.0}
    capture = Capture(exposure=100.0, gain=0.0, zoom=0.0, **automatic)
    set_controls(capture, {"exposure": 50, "gain": 7, "white_balance": 5000, "led_level": 15}, 15, "DIGIT")
    by_hand = {"auto_exposure": 1.0, "auto_white_balance": 0.0}
    wanted = {"exposure": 50.0, "gain": 7.0, "white_balance": 5000.0, "led_level": 15.0, **by_hand}
    assert controls_of(capture, 15) == wanted
    assert capture.get(cv2.CAP_PROP_ZOOM) == 0xFFF
    capture = Capture(exposure=100.0, auto_exposure=3.0)
    set_controls(capture, {}, 0, "x")
    assert controls_of(capture, 0) == {"exposure": 100.0, "auto_exposure": 3.0}


def test_a_control_that_is_missing_clipped_or_unknown_is_an_error():
    clipped = Capture(gain=0.0, limits={cv2.CAP_PROP_GAIN: (0, 64)})
    for capture, setting, levels, said in (
        (Capture(), {"gain": 5}, 15, "DIGIT: expected to set gain to 5, but it lacks"),
        (clipped, {"gain": 500}, 15, "to 500, but it has 64"),
        *((Capture(zoom=0.0), {"led_level": level}, 15, "led_level") for level in (16, -1, 2.5)),
        (Capture(zoom=0.0), {"led_level": 3}, 0, "led_level"),  # of a camera that has none
    ):
        with pytest.raises(SensorError, match=said):
            set_controls(capture, setting, levels, "DIGIT")
    for setting, said in (
        ({"exposur": 3}, "got exposur"),
        (
            {"gain": np.inf},
            "gain as a finite number, got inf",
        ),  # any value differs from it by less than 0.1 % of it
        ({"led_level": np.nan}, "led_level as a finite number"),
    ):
        with pytest.raises(ValueError, match=said):
            check_settings(setting)
    assert check_settings({"fps": 30, "fourcc": "MJPG"}) == {"fps": 30.0, "fourcc": "MJPG"}


def test_a_mismatch_names_both_values():
    calibrated = {"exposure": 100.0, "gain": 3.0, "fps": 30.0, "fourcc": "YUYV", "led_level": 15.0}
    assert settings_mismatch(calibrated, calibrated) == {}
    used = {"exposure": 80.0, "gain": 3.001, "fps": 60.0, "fourcc": "MJPG"}
    assert settings_mismatch(calibrated, used) == {"exposure": (100.0, 80.0), "fourcc": ("YUYV", "MJPG")}
    assert settings_mismatch({}, used) == {}


def test_a_calibrations_settings_can_be_asked_for_again():
    kept = {"width": 320, "height": 240, "fourcc": "YUYV", "fps": 59.94, "reduced": 1, "gain": 3.0}
    by_hand = {"exposure": 50.0, "auto_exposure": 1.0, "white_balance": 4600.0, "auto_white_balance": 0.0}
    asked = calibrated_settings({**kept, **by_hand, "led_level": 15.0})
    assert check_settings(asked) == {
        "width": 320, "height": 240, "fourcc": "YUYV", "gain": 3.0,
        "exposure": 50.0, "white_balance": 4600.0, "led_level": 15.0,
    }  # fmt: skip
    automatic = calibrated_settings({**by_hand, "auto_exposure": 3.0, "auto_white_balance": 1.0})
    assert automatic == {}


BGR = np.full((240, 320, 3), (10, 30, 200), np.uint8)


@pytest.fixture
def camera(tmp_path):
    def made(capture, monkeypatch, settings=None, kind=None):
        (tmp_path / "video0").write_text("")
        monkeypatch.setattr(cameras, "_opened", lambda _: capture)
        return cameras.UsbCamera(Camera("DIGIT", str(tmp_path / "video0"), "D1", kind=kind), settings)

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
    assert cameras.fourcc_text(cv2.VideoWriter.fourcc(*"MJPG")) == "MJPG"
    assert (cameras.fourcc_text(0), cameras.fourcc_text(-1)) == ("", "")


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


def camera_at(path, usb_id="2833:0209"):
    return Camera("DIGIT", str(path), "D1", usb_id)


def test_the_rule_names_the_device_and_an_unplugged_camera_says_so(tmp_path):
    assert udev_rule("2833:0209") == (
        'SUBSYSTEM=="video4linux", ATTRS{idVendor}=="2833", ATTRS{idProduct}=="0209", MODE="0660", GROUP="video", '
        'TAG+="uaccess"'
    )
    assert udev_rule(None).startswith('SUBSYSTEM=="video4linux", MODE')
    with pytest.raises(SensorError, match=r"DIGIT \(serial D1.*was unplugged"):
        check_access(camera_at(tmp_path / "video0"))
    with pytest.raises(SensorError, match="not there any more"):
        cameras.UsbCamera(camera_at(tmp_path / "video7"))


@pytest.mark.parametrize(
    ("refusal", "said"),
    [
        (errno.EBUSY, r"DIGIT \(serial D1.*\) is in use by another program"),
        (errno.EACCES, "permission denied.*" + re.escape(udev_rule("2833:0209")) + ".*udevadm"),
        (errno.EPERM, "permission denied"),
        (errno.ENODEV, "not there any more"),
        (errno.EIO, "cannot be opened: Input/output error"),
    ],
)
def test_what_the_system_refuses_is_said(tmp_path, monkeypatch, refusal, said):
    def refused(*_):
        raise OSError(refusal, os.strerror(refusal))

    monkeypatch.setattr(cameras.os, "open", refused)
    with pytest.raises(SensorError, match=said):
        check_access(camera_at(tmp_path / "video0"))


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
