"""The cameras of this system, and one by its path."""

import os
import stat
import sys

import pytest

from gelform.errors import SensorError
from gelform.sensors.cameras.camera import Camera
from gelform.sensors.cameras.there import camera_named, cameras_there
from made.sysfs import DIGIT, plug_in


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
