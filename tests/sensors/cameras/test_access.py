"""Why a camera cannot be opened, each a sentence that says what to do."""

import os
import subprocess
import sys

import pytest

from gelform.errors import SensorError
from gelform.sensors.cameras.access import check_access, in_use, programs_that_hold, udev_rule
from gelform.sensors.cameras.camera import Camera

linux = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs Linux's files")


def camera(path, usb_id="2833:0209"):
    return Camera("DIGIT", str(path), "D1", usb_id)


def test_the_rule_names_the_device():
    assert udev_rule("2833:0209") == (
        'SUBSYSTEM=="video4linux", ATTRS{idVendor}=="2833", ATTRS{idProduct}=="0209", MODE="0660", GROUP="video", '
        'TAG+="uaccess"'
    )
    assert udev_rule(None).startswith('SUBSYSTEM=="video4linux", MODE')


def test_an_unplugged_camera_says_so(tmp_path):
    with pytest.raises(SensorError, match=r"DIGIT \(serial D1.*was unplugged"):
        check_access(camera(tmp_path / "video0"))


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
            check_access(camera(forbidden))
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
            assert f"in use by sleep (process {holder.pid})" in str(in_use(camera(held)))
        finally:
            holder.kill()
    assert programs_that_hold(str(held)) == []
    assert "another program" in str(in_use(camera(held)))
