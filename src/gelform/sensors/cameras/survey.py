"""What a camera offers and how fast it really is: opened for a moment."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from gelform.errors import GelformError
from gelform.sensors.cameras.camera import Camera
from gelform.sensors.cameras.modes import Mode, modes_of
from gelform.sensors.cameras.usb import UsbCamera
from gelform.sensors.grabber import Grabber
from gelform.sensors.source import Source

MEASURED_S, FIRST_S = 1.0, 3.0  # how long frames are counted, and how long the first one may take


@dataclass(frozen=True)
class Survey:
    """A camera, looked at.

    Attributes
    ----------
    camera : Camera
    modes : that its driver lists
    rate_hz : measured in the mode that gelform asks for; None where it was not measured
    settings : read back in that mode
    problem : why it could not be opened; empty where it could
    """

    camera: Camera
    modes: tuple[Mode, ...]
    rate_hz: float | None
    settings: dict[str, float | str]
    problem: str = ""


def survey_of(
    camera: Camera, *, measure: bool = True, opened: Callable[[Camera], Source] = UsbCamera
) -> Survey:
    """Ask a camera's driver for its modes and, unless `measure` is False, count its frames for a second."""
    modes = tuple(modes_of(camera.path))
    if not measure:
        return Survey(camera, modes, None, {})
    try:
        with Grabber(lambda: opened(camera)) as grabber:
            frame = grabber.newest(-1, FIRST_S)
            if frame is None:
                return Survey(camera, modes, None, grabber.settings, "it opens, but gives no frame")
            time.sleep(MEASURED_S)
            return Survey(camera, modes, grabber.stats.rate_hz, grabber.settings)
    except GelformError as problem:
        return Survey(camera, modes, None, {}, str(problem))
