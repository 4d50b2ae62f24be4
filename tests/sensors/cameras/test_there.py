"""The cameras of this system, and one by its path."""

import sys

import pytest

from gelform.sensors.cameras.camera import Camera
from gelform.sensors.cameras.there import camera_named, cameras_there
from made.sysfs import DIGIT, plug_in


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads Linux's sysfs")
def test_linux_lists_its_cameras(tmp_path):
    plug_in(tmp_path, 0, "DIGIT", DIGIT, "D1")
    assert [camera.serial for camera in cameras_there(tmp_path)] == ["D1"]
    assert cameras_there(tmp_path / "none") == []


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="has /dev")
def test_a_device_that_is_not_listed_opens_by_its_path():
    listed = Camera("a", "/dev/null", "S")
    assert camera_named("/dev/null", [listed]) is listed
    assert camera_named("/dev/null", []).path == "/dev/null"
    assert camera_named("S", [listed]) is listed
