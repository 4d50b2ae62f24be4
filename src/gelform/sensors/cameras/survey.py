"""A camera's measured frame rate and settings."""

from __future__ import annotations

import time
from dataclasses import dataclass

from gelform.errors import GelformError
from gelform.sensors.cameras.camera import Camera
from gelform.sensors.cameras.usb import UsbCamera
from gelform.sensors.grabber import Grabber

MEASURED_S, FIRST_S = 1.0, 3.0  # s: time in which frames are counted; longest wait for the first frame


@dataclass(frozen=True)
class Survey:
    """The result of probing a camera.

    Attributes
    ----------
    camera : Camera
    rate_hz : measured rate in the mode that gelform uses; None if not measured
    settings : settings read back in that mode
    problem : why the camera could not be opened; empty if it could
    """

    camera: Camera
    rate_hz: float | None
    settings: dict[str, float | str]
    problem: str = ""


def survey_of(camera: Camera, *, measure: bool = True) -> Survey:
    """Open a camera and count its frames for a second, unless `measure` is False."""
    if not measure:
        return Survey(camera, None, {})
    try:
        with Grabber(lambda: UsbCamera(camera)) as grabber:
            frame = grabber.newest(-1, FIRST_S)
            if frame is None:
                return Survey(camera, None, grabber.settings, "it opens, but gives no frame")
            time.sleep(MEASURED_S)
            return Survey(camera, grabber.stats.rate_hz, grabber.settings)
    except GelformError as problem:
        return Survey(camera, None, {}, str(problem))
