"""A camera's settings: set, read back, compared."""

import cv2
import pytest

from gelform.errors import SensorError
from gelform.sensors.cameras.settings import (
    calibrated_settings,
    check_settings,
    controls_of,
    set_controls,
    settings_mismatch,
)
from made.capture import Capture


def test_what_is_set_is_read_back_and_automatics_go_off():
    capture = Capture(
        exposure=100.0, auto_exposure=3.0, gain=0.0, wb_temperature=4000.0, auto_wb=1.0, zoom=0.0
    )
    set_controls(capture, {"exposure": 50, "gain": 7, "white_balance": 5000, "led_level": 15}, 15, "DIGIT")
    assert controls_of(capture, 15) == {
        "exposure": 50.0,
        "auto_exposure": 1.0,
        "gain": 7.0,
        "white_balance": 5000.0,
        "auto_white_balance": 0.0,
        "led_level": 15.0,
    }
    assert capture.get(cv2.CAP_PROP_ZOOM) == 0xFFF


def test_what_is_not_asked_for_stays():
    capture = Capture(exposure=100.0, auto_exposure=3.0)
    set_controls(capture, {}, 0, "x")
    assert controls_of(capture, 0) == {"exposure": 100.0, "auto_exposure": 3.0}


def test_a_control_that_is_missing_or_clipped_is_an_error():
    with pytest.raises(SensorError, match="DIGIT: expected to set gain to 5, but it lacks"):
        set_controls(Capture(), {"gain": 5}, 15, "DIGIT")
    clipped = Capture(gain=0.0, limits={cv2.CAP_PROP_GAIN: (0, 64)})
    with pytest.raises(SensorError, match="to 500, but it has 64"):
        set_controls(clipped, {"gain": 500}, 15, "DIGIT")


def test_led_levels_are_whole_and_of_cameras_that_have_them():
    for level, levels in ((16, 15), (-1, 15), (2.5, 15), (3, 0)):
        with pytest.raises(SensorError, match="led_level"):
            set_controls(Capture(zoom=0.0), {"led_level": level}, levels, "x")


def test_unknown_settings_are_refused():
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
