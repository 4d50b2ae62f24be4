"""Cameras as Linux lists them: the parser on a tree of files as the kernel makes it."""

import shutil

from gelform.sensors.cameras.sysfs import cameras_in_sysfs, kind_of
from made.sysfs import DIGIT, MINI, plug_in


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
