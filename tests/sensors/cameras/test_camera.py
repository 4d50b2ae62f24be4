"""Cameras as Linux lists them, the choice among several, their settings."""

import os
import shutil
import stat
import sys

import cv2
import pytest

from gelform.errors import SensorError
from gelform.sensors.cameras.camera import (
    Camera,
    camera_named,
    cameras_in_sysfs,
    cameras_there,
    chosen_camera,
    kind_of,
)
from gelform.sensors.cameras.settings import (
    calibrated_settings,
    check_settings,
    controls_of,
    set_controls,
    settings_mismatch,
)
from made.capture import Capture
from made.sysfs import DIGIT, MINI, plug_in

linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs Linux's files")
MINI_CAMERA = Camera(
    "GelSight Mini R0B 2871", "/dev/video0", "S1", "0c45:636d", "/dev/v4l/by-path/p2", "gelsight-mini"
)
DIGIT_CAMERA = Camera("DIGIT", "/dev/video2", "D20123", "2833:0209", "/dev/v4l/by-path/p4", "digit")
OTHER = Camera("D20123", "/dev/video4", "X9")  # named as another's serial
PLUGGED_IN = [MINI_CAMERA, DIGIT_CAMERA, OTHER]


def test_by_serial_first_name_second_path_last_shared_serials_by_the_socket():
    for spec, camera in {
        "S1": MINI_CAMERA,
        "D20123": DIGIT_CAMERA,  # the serial goes before the name
        "DIGIT": DIGIT_CAMERA,
        "digit": DIGIT_CAMERA,
        "gelsight-mini": MINI_CAMERA,
        "gelsight": MINI_CAMERA,
        "/dev/video4": OTHER,
        "/dev/v4l/by-path/p2": MINI_CAMERA,
    }.items():
        assert chosen_camera(spec, PLUGGED_IN) is camera
    twins = [
        Camera("cam", "/dev/video0", "200901010001", by_path="/dev/v4l/by-path/p2"),
        Camera("cam", "/dev/video2", "200901010001", by_path="/dev/v4l/by-path/p4"),
    ]
    with pytest.raises(SensorError, match=r"name one by its path.*by-path/p2.*by-path/p4"):
        chosen_camera("200901010001", twins)
    assert chosen_camera("/dev/v4l/by-path/p4", twins) is twins[1]


def test_a_serial_that_only_looks_alike_is_named():
    cameras = [Camera("cam", "/dev/video0", serial=serial) for serial in ("D20123", "Pru\u0308fling")]
    for word, said in (
        ("d20123", "'D20123' differs from 'd20123'"),
        ("Pr\u00fcfling", r"'Pru\u0308fling' differs"),
    ):
        with pytest.raises(SensorError) as problem:
            chosen_camera(word, cameras)
        assert said in str(problem.value)
        assert "compared letter by letter" in str(problem.value)
    with pytest.raises(SensorError) as problem:
        chosen_camera("D20124", cameras)
    assert "letter by letter" not in str(problem.value)


def test_the_only_one_needs_no_name_and_others_are_listed():
    assert chosen_camera("", [DIGIT_CAMERA]) is DIGIT_CAMERA
    nothing = r"No camera is plugged in.*simulated"
    for spec, there, said in (
        ("", PLUGGED_IN, r"Several cameras are plugged in: name one by its serial.*S1.*D20123.*X9"),
        ("D9", PLUGGED_IN, r"No camera 'D9'.*DIGIT \(serial D20123, /dev/video2"),
        ("", [], nothing),
        ("D9", [], nothing),
    ):
        with pytest.raises(SensorError, match=said):
            chosen_camera(spec, there)


def test_names_serials_and_paths_are_those_of_the_usb_device(tmp_path):
    plug_in(tmp_path, 0, "GelSight Mini R0B 2871-46HU", MINI, "2871-46HU", "1-2")
    plug_in(tmp_path, 2, "DIGIT", DIGIT, "D20123", "1-4")
    mini, digit = cameras_in_sysfs(tmp_path)
    assert (mini.name, mini.serial, mini.path) == ("GelSight Mini R0B 2871-46HU", "2871-46HU", "/dev/video0")
    assert (mini.usb_id, mini.kind) == (MINI, "gelsight-mini")
    assert mini.by_path == "/dev/v4l/by-path/pci-0000:00:14.0-usb-0:2:1.0-video-index0"
    assert (digit.serial, digit.kind, digit.path) == ("D20123", "digit", "/dev/video2")


def test_metadata_nodes_are_skipped_and_numbers_sort_as_numbers(tmp_path):
    plug_in(tmp_path, 10, "b", "1:2", "B", "1-3", nodes=4)
    plug_in(tmp_path, 2, "a", "1:2", "A", "1-2")
    assert [camera.path for camera in cameras_in_sysfs(tmp_path)] == ["/dev/video2", "/dev/video10"]


def test_a_camera_without_serial_or_not_on_usb(tmp_path):
    plug_in(tmp_path, 0, "Webcam", "046d:0825", None, "1-1")
    plug_in(tmp_path, 2, "Laptop", None, None, "1-5")
    plug_in(tmp_path, 4, "Webcam", "046d:0825", "", "1-6")
    webcam, laptop, empty = cameras_in_sysfs(tmp_path)
    assert (webcam.serial, webcam.kind, webcam.name) == (None, None, "Webcam")
    assert (laptop.usb_id, laptop.serial, laptop.name) == (None, None, "Laptop: Laptop")
    assert empty.serial is None
    assert (kind_of(DIGIT), kind_of("1:2"), kind_of(None)) == ("digit", None, None)


def test_a_device_that_goes_away_meanwhile_leaves_no_traceback(tmp_path):
    device = plug_in(tmp_path, 0, "DIGIT", DIGIT, "D1", "1-4")
    shutil.rmtree(device)
    assert all(camera.serial is None for camera in cameras_in_sysfs(tmp_path))
    shutil.rmtree(tmp_path / "sys")
    assert cameras_in_sysfs(tmp_path) == []


@linux
def test_linux_lists_its_cameras(tmp_path):
    plug_in(tmp_path, 0, "DIGIT", DIGIT, "D1")
    assert [camera.serial for camera in cameras_there(tmp_path)] == ["D1"]
    assert cameras_there(tmp_path / "none") == []


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
    with pytest.raises(ValueError, match="got exposur"):
        check_settings({"exposur": 3})
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
