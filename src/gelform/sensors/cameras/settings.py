"""How a camera is set: exposure, gain, white balance, LED level; set, read back, and compared with a calibration's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import cv2

from gelform.errors import SensorError
from gelform.foundations.checks import check_number

Settings = Mapping[str, float | str]
# name: (OpenCV's property, the automatic control that has to be off for it)
CONTROLS = {
    "exposure": (cv2.CAP_PROP_EXPOSURE, "auto_exposure"),
    "gain": (cv2.CAP_PROP_GAIN, None),
    "white_balance": (cv2.CAP_PROP_WB_TEMPERATURE, "auto_white_balance"),
}
AUTOMATIC = {"auto_exposure": cv2.CAP_PROP_AUTO_EXPOSURE, "auto_white_balance": cv2.CAP_PROP_AUTO_WB}
OFF = {"auto_exposure": 1.0, "auto_white_balance": 0.0}  # 1: V4L2_EXPOSURE_MANUAL
LED = cv2.CAP_PROP_ZOOM  # of a DIGIT: four bits each of red, green and blue
LED_OF_LEVEL = 0x111  # one step of all three
MODE = ("width", "height", "fps", "fourcc")
SETTABLE = (*MODE, *CONTROLS, "led_level")
COMPARED = ("width", "height", "reduced", "fourcc", *CONTROLS, *AUTOMATIC, "led_level")
UNKNOWN = -1.0  # what OpenCV gives for a control that a camera lacks


def check_settings(settings: Settings) -> dict[str, float | str]:
    """Settings that can be asked for; ValueError for an unknown name or a value that is no number."""
    unknown = [name for name in settings if name not in SETTABLE]
    if unknown:
        raise ValueError(
            f"Expected settings of a camera among {', '.join(SETTABLE)}, got {', '.join(unknown)}."
        )
    return {
        name: str(value) if name == "fourcc" else check_number(float(value), name)
        for name, value in settings.items()
    }


def set_controls(capture: cv2.VideoCapture, settings: Settings, led_levels: int, name: str) -> None:
    """Set exposure, gain, white balance and LED level, and read each back.

    Parameters
    ----------
    capture : an open camera
    settings : the wanted ones by name
    led_levels : of the known camera; 0 where the LEDs cannot be set
    name : of the camera, for messages

    Raises
    ------
    SensorError
        The camera lacks a control, or has another value afterwards.
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
    """The controls as they are now, of those that the camera has."""
    properties = {**{name: which for name, (which, _) in CONTROLS.items()}, **AUTOMATIC}
    found = {name: float(capture.get(which)) for name, which in properties.items()}
    if led_levels:
        found["led_level"] = float(capture.get(LED)) / LED_OF_LEVEL
    return {name: value for name, value in found.items() if value != UNKNOWN}


def settings_mismatch(calibrated: Settings, used: Settings) -> dict[str, tuple[Any, Any]]:
    """Settings of a camera that are not those of its calibration: name -> (calibrated, used).

    Parameters
    ----------
    calibrated : kept in the calibration, `calibration.settings.camera or {}`
    used : of the source, `source.settings`

    Compares what decides the colours (size, reduction, picture format, exposure, gain, white balance, LED level), where
    both are known: a video does not know its camera's exposure. Empty: nothing is known to be different.
    """
    return {
        name: (calibrated[name], used[name])
        for name in COMPARED
        if name in calibrated and name in used and not _same(calibrated[name], used[name])
    }


def calibrated_settings(calibrated: Settings) -> dict[str, float | str]:
    """The settings for `open_source(settings=...)` that make a camera as it was in a calibration.

    Parameters
    ----------
    calibrated : kept in the calibration, `calibration.settings.camera or {}`

    Exposure and white balance are left out where they were automatic: to set them would switch that off.
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
