"""The modes that a driver lists, and the measured rate."""

import struct

import pytest

from gelform.sensors.cameras import survey as surveyed
from gelform.sensors.cameras.camera import Camera
from gelform.sensors.cameras.survey import (
    FORMATS,
    INTERVALS,
    SIZES,
    Mode,
    modes_from_answers,
    modes_of,
    survey_of,
)
from made.recorded import camera as frames_of

YUYV, MJPG = (int.from_bytes(code, "little") for code in (b"YUYV", b"MJPG"))
OFFERED = {YUYV: {(320, 240): [60, 30], (640, 480): [30, 15]}, MJPG: {(3280, 2464): [25]}}


def driver(request, buffer):
    """VIDIOC_ENUM_FMT, VIDIOC_ENUM_FRAMESIZES, VIDIOC_ENUM_FRAMEINTERVALS."""
    index = struct.unpack_from("<I", buffer)[0]
    try:
        if request == FORMATS[0]:
            assert struct.unpack_from("<I", buffer, 4)[0] == 1  # V4L2_BUF_TYPE_VIDEO_CAPTURE
            struct.pack_into("<I", buffer, 44, list(OFFERED)[index])
        elif request == SIZES[0]:
            sizes = list(OFFERED[struct.unpack_from("<I", buffer, 4)[0]])
            struct.pack_into("<III", buffer, 8, 1, *sizes[index])
        else:
            assert request == INTERVALS[0]
            code, width, height = struct.unpack_from("<III", buffer, 4)
            struct.pack_into("<III", buffer, 16, 1, 1, OFFERED[code][width, height][index])
    except IndexError:
        raise OSError(22, "Invalid argument") from None


def test_every_format_size_and_rate_is_listed():
    assert list(modes_from_answers(driver)) == [
        Mode("YUYV", (240, 320), 60.0),
        Mode("YUYV", (240, 320), 30.0),
        Mode("YUYV", (480, 640), 30.0),
        Mode("YUYV", (480, 640), 15.0),
        Mode("MJPG", (2464, 3280), 25.0),
    ]


def test_the_requests_are_those_of_the_kernel():
    """_IOWR('V', number, size), asm-generic/ioctl.h."""
    for (request, size), number in ((FORMATS, 2), (SIZES, 74), (INTERVALS, 75)):
        assert request == (3 << 30) | (size << 16) | (ord("V") << 8) | number


def test_a_driver_that_never_ends_is_not_asked_for_ever():
    def endless(request, buffer):
        driver(request, buffer) if request != FORMATS[0] else struct.pack_into("<I", buffer, 44, YUYV)

    assert 0 < len(list(modes_from_answers(endless))) <= 64 * 4


def test_what_is_no_camera_has_no_modes(tmp_path):
    (tmp_path / "file").write_text("")
    assert modes_of(str(tmp_path / "file")) == []
    assert modes_of(str(tmp_path / "none")) == []
    assert str(Mode("YUYV", (240, 320), 60.0)) == "YUYV 240x320 at 60 Hz"


CAMERA = Camera("a camera", "/dev/none", "S1")


def test_the_rate_is_measured(monkeypatch):
    monkeypatch.setattr(surveyed, "UsbCamera", lambda _: frames_of(200)())
    monkeypatch.setattr(surveyed, "MEASURED_S", 0.2)
    found = survey_of(CAMERA)
    assert 20 < found.rate_hz < 60  # 50, less where the machine has no time
    assert (found.settings, found.problem) == ({"gain": 3.0}, "")
    monkeypatch.setattr(surveyed, "UsbCamera", lambda _: pytest.fail("opened"))
    found = survey_of(CAMERA, measure=False)
    assert (found.rate_hz, found.problem) == (None, "")


def test_why_it_does_not_open_or_gives_nothing(monkeypatch):
    assert "not there any more" in survey_of(CAMERA).problem
    monkeypatch.setattr(surveyed, "FIRST_S", 0.05)
    monkeypatch.setattr(surveyed, "UsbCamera", lambda _: frames_of(0)())
    assert "no frame" in survey_of(CAMERA).problem
