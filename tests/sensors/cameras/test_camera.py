"""Cameras as Linux lists them, and which of several is meant."""

import os
import shutil
import stat
import sys

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
from made.sysfs import DIGIT, MINI, plug_in

MINI_CAMERA = Camera(
    "GelSight Mini R0B 2871", "/dev/video0", "S1", "0c45:636d", "/dev/v4l/by-path/p2", "gelsight-mini"
)
DIGIT_CAMERA = Camera("DIGIT", "/dev/video2", "D20123", "2833:0209", "/dev/v4l/by-path/p4", "digit")
OTHER = Camera("D20123", "/dev/video4", "X9")  # named as another's serial
PLUGGED_IN = [MINI_CAMERA, DIGIT_CAMERA, OTHER]


def test_by_serial_first_name_second_path_last():
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


def test_the_only_one_needs_no_name():
    assert chosen_camera("", [DIGIT_CAMERA]) is DIGIT_CAMERA
    with pytest.raises(
        SensorError, match=r"Several cameras are plugged in: name one by its serial.*S1.*D20123.*X9"
    ):
        chosen_camera("", PLUGGED_IN)


def test_an_unknown_one_lists_what_is_there():
    with pytest.raises(SensorError, match=r"No camera 'D9'.*DIGIT \(serial D20123, /dev/video2"):
        chosen_camera("D9", PLUGGED_IN)


def test_where_nothing_is_plugged_in_it_says_what_needs_nothing():
    for spec in ("", "D9"):
        with pytest.raises(SensorError, match=r"No camera is plugged in.*simulated"):
            chosen_camera(spec, [])


def test_shared_serials_are_told_apart_by_the_socket():
    twins = [
        Camera("cam", "/dev/video0", "200901010001", by_path="/dev/v4l/by-path/p2"),
        Camera("cam", "/dev/video2", "200901010001", by_path="/dev/v4l/by-path/p4"),
    ]
    with pytest.raises(SensorError, match=r"name one by its path.*by-path/p2.*by-path/p4"):
        chosen_camera("200901010001", twins)
    assert chosen_camera("/dev/v4l/by-path/p4", twins) is twins[1]


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
    webcam, laptop = cameras_in_sysfs(tmp_path)
    assert (webcam.serial, webcam.kind, webcam.name) == (None, None, "Webcam")
    assert (laptop.usb_id, laptop.serial) == (None, None)
    assert laptop.name == "Laptop: Laptop"


def test_an_empty_serial_is_none(tmp_path):
    plug_in(tmp_path, 0, "Webcam", "046d:0825", "", "1-1")
    assert cameras_in_sysfs(tmp_path)[0].serial is None


def test_a_device_that_goes_away_meanwhile_leaves_no_traceback(tmp_path):
    device = plug_in(tmp_path, 0, "DIGIT", DIGIT, "D1", "1-4")
    shutil.rmtree(device)
    assert all(camera.serial is None for camera in cameras_in_sysfs(tmp_path))
    shutil.rmtree(tmp_path / "sys")
    assert cameras_in_sysfs(tmp_path) == []


def test_only_known_ids_have_a_kind():
    assert (kind_of(DIGIT), kind_of("1:2"), kind_of(None)) == ("digit", None, None)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads Linux's sysfs")
def test_linux_lists_its_cameras(tmp_path):
    plug_in(tmp_path, 0, "DIGIT", DIGIT, "D1")
    assert [camera.serial for camera in cameras_there(tmp_path)] == ["D1"]
    assert cameras_there(tmp_path / "none") == []


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="has /dev")
def test_a_device_by_its_path():
    listed = Camera("a", "/dev/null", "S")
    assert camera_named("/dev/null", [listed]) is listed
    assert camera_named("S", [listed]) is listed


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="has /dev")
def test_a_device_that_is_no_camera_is_refused():
    with pytest.raises(SensorError, match=r"/dev/null is no camera. Plugged in: none"):
        camera_named("/dev/null", [])
    with pytest.raises(SensorError, match=r"Plugged in: a \(serial S"):
        camera_named("/dev/zero", [Camera("a", "/dev/video0", "S")])


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="has /dev")
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
