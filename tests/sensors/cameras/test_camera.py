"""Which camera is meant, and what is said where that is not clear."""

import pytest

from gelform.errors import SensorError
from gelform.sensors.cameras.camera import Camera, chosen_camera

MINI = Camera(
    "GelSight Mini R0B 2871", "/dev/video0", "S1", "0c45:636d", "/dev/v4l/by-path/p2", "gelsight-mini"
)
DIGIT = Camera("DIGIT", "/dev/video2", "D20123", "2833:0209", "/dev/v4l/by-path/p4", "digit")
OTHER = Camera("D20123", "/dev/video4", "X9")  # named as another's serial
PLUGGED_IN = [MINI, DIGIT, OTHER]


@pytest.mark.parametrize(
    ("spec", "camera"),
    [
        ("S1", MINI),
        ("D20123", DIGIT),  # the serial goes before the name
        ("DIGIT", DIGIT),
        ("digit", DIGIT),
        ("gelsight-mini", MINI),
        ("gelsight", MINI),
        ("/dev/video4", OTHER),
        ("/dev/v4l/by-path/p2", MINI),
    ],
)
def test_by_serial_first_name_second_path_last(spec, camera):
    assert chosen_camera(spec, PLUGGED_IN) is camera


def test_the_only_one_needs_no_name():
    assert chosen_camera("", [DIGIT]) is DIGIT
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
