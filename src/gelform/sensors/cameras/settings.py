"""Camera settings (exposure, gain, white balance, LED level): set, read back, compared with a calibration's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2

from gelform.errors import SensorError
from gelform.foundations.checks import check_number

Settings = Mapping[str, float | str]
# name: (OpenCV's property, the automatic control that must be off)
CONTROLS = {
    "exposure": (cv2.CAP_PROP_EXPOSURE, "auto_exposure"),
    "gain": (cv2.CAP_PROP_GAIN, None),
    "white_balance": (cv2.CAP_PROP_WB_TEMPERATURE, "auto_white_balance"),
}
AUTOMATIC = {"auto_exposure": cv2.CAP_PROP_AUTO_EXPOSURE, "auto_white_balance": cv2.CAP_PROP_AUTO_WB}
OFF = {"auto_exposure": 1.0, "auto_white_balance": 0.0}  # 1: V4L2_EXPOSURE_MANUAL
LED = cv2.CAP_PROP_ZOOM  # of a DIGIT: four bits each for red, green and blue
LED_OF_LEVEL = 0x111  # one brightness step of all three colors
MODE = ("width", "height", "fps", "fourcc")
SETTABLE = (*MODE, *CONTROLS, "led_level")
COMPARED = ("width", "height", "reduced", "fourcc", *CONTROLS, *AUTOMATIC, "led_level")
UNKNOWN = -1.0  # OpenCV's value of a control that the camera lacks


def check_settings(settings: Settings) -> dict[str, float | str]:
    """Check that settings can be applied; ValueError for an unknown name or a value that is no number or format."""
    unknown = [name for name in settings if name not in SETTABLE]
    if unknown:
        raise ValueError(
            f"Expected settings of a camera among {', '.join(SETTABLE)}, got {', '.join(unknown)}."
        )
    fourcc = str(settings.get("fourcc", "MJPG"))
    if len(fourcc) != 4 or not fourcc.isascii():
        raise ValueError(f"Expected fourcc as four letters, such as MJPG or YUYV, got {fourcc!r}.")
    return {
        name: str(value) if name == "fourcc" else check_number(float(value), name)
        for name, value in settings.items()
    }


def set_controls(capture: cv2.VideoCapture, settings: Settings, led_levels: int, name: str) -> None:
    """Set exposure, gain, white balance and LED level, and read each back.

    Parameters
    ----------
    capture : an open camera
    settings : values by name
    led_levels : LED steps of the known camera; 0 if its LEDs cannot be set
    name : the camera's name, for messages

    Raises
    ------
    SensorError
        The camera lacks a control, or reports another value after setting it.
    """
    for setting, (which, automatic) in CONTROLS.items():
        if setting in settings:
            if automatic is not None:
                capture.set(AUTOMATIC[automatic], OFF[automatic])
            _set(capture, which, float(settings[setting]), setting, name)
    if "led_level" in settings:
        level = float(settings["led_level"])
        if not (led_levels and level == int(level) and 0 <= level <= led_levels):
            allowed = (
                f"a whole number from 0 to {led_levels}" if led_levels else "none: it cannot be set here"
            )
            raise SensorError(f"{name}: expected led_level as {allowed}, got {level:g}.")
        _set(capture, LED, level * LED_OF_LEVEL, "led_level", name)


def controls_of(capture: cv2.VideoCapture, led_levels: int) -> dict[str, float]:
    """The current values of the controls that the camera has."""
    properties = {**{name: which for name, (which, _) in CONTROLS.items()}, **AUTOMATIC}
    found = {name: float(capture.get(which)) for name, which in properties.items()}
    if led_levels:
        found["led_level"] = float(capture.get(LED)) / LED_OF_LEVEL
    return {name: value for name, value in found.items() if value != UNKNOWN}


def settings_mismatch(calibrated: Settings, used: Settings) -> dict[str, tuple[Any, Any]]:
    """Settings in which a camera differs from its calibration: name -> (calibrated, used).

    Parameters
    ----------
    calibrated : from the calibration, `calibration.settings.camera or {}`
    used : from the source, `source.settings`

    Compares the settings that affect colors: size, reduction, picture format, exposure, gain, white balance and LED level. A
    setting counts only if both sides know it: a video does not record its camera's exposure. Empty: no known difference.
    """
    return {
        name: (calibrated[name], used[name])
        for name in COMPARED
        if name in calibrated and name in used and not _same(calibrated[name], used[name])
    }


def calibrated_settings(calibrated: Settings) -> dict[str, float | str]:
    """Settings for `open_source(settings=...)` that restore the camera's state during calibration.

    Parameters
    ----------
    calibrated : from the calibration, `calibration.settings.camera or {}`

    Automatic exposure and white balance are left out, because setting a value would switch them off.
    """
    by_hand = {
        name: automatic is None or calibrated.get(automatic, OFF[automatic]) == OFF[automatic]
        for name, (_, automatic) in CONTROLS.items()
    }
    names = [name for name in SETTABLE if name != "fps" and by_hand.get(name, True)]
    return {name: calibrated[name] for name in names if name in calibrated}


def _set(capture: cv2.VideoCapture, which: int, value: float, setting: str, name: str) -> None:
    accepted = capture.set(which, value)
    found = float(capture.get(which))
    if not accepted or not _same(found, value):
        why = "it lacks this control" if found == UNKNOWN else f"it has {found:g} afterwards"
        raise SensorError(
            f"{name}: expected to set {setting} to {value:g}, but {why}. Choose a value within its range (v4l2-ctl -d "
            "PATH --list-ctrls shows it on Linux)."
        )


def _same(one: float | str, other: float | str) -> bool:
    if isinstance(one, str) or isinstance(other, str):
        return str(one) == str(other)
    return abs(one - other) <= 1e-3 * max(abs(one), abs(other))
