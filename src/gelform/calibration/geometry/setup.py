"""The view and the untouched image of a sensor: what images of a gauge or a punch are read with."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.calibration_file import load_calibration
from gelform.errors import DataError
from gelform.sensors.backgrounds import background_in, read_background
from gelform.sensors.files import read_image, read_sensor_toml
from gelform.sensors.profiles import profile_named
from gelform.view import View, image_from_frame


@dataclass(frozen=True)
class Setup:
    """A sensor as it is set up.

    Attributes
    ----------
    view : from its frames to images
    background : (H, W, 3) float32, the untouched image, after the view
    """

    view: View
    background: NDArray[np.float32]

    def image(self, path: str | PathLike[str]) -> NDArray[Any]:
        """The image (H, W, 3) of a frame in a file."""
        return image_from_frame(read_image(Path(path)), self.view)


def read_setup(
    place: str | PathLike[str],
    *,
    background: str | PathLike[str] | None = None,
    sensor: str | None = None,
) -> Setup:
    """The view and the untouched image that a press folder, its `sensor.toml` or a calibration says.

    Parameters
    ----------
    place : a folder with an image of the untouched gel, its `sensor.toml`, or a calibration
    background : the untouched frame, where it is not the folder's `background.png`
    sensor : name of a profile, for the view of a folder without a `sensor.toml`

    Raises
    ------
    DataError, CalibrationError
        There is none, or it cannot be read.
    """
    place = Path(place)
    if place.suffix == ".npz":
        calibration = load_calibration(place)
        if background is None:
            return Setup(calibration.view, calibration.background)
        view = calibration.view
        return Setup(view, image_from_frame(read_background(Path(background)), view).astype(np.float32))
    folder = place.parent if place.suffix == ".toml" else place
    if not folder.is_dir():
        raise DataError(
            f"Expected a folder, its sensor.toml or a calibration, got {place}, which is not there."
        )
    frame = read_background(Path(background) if background is not None else background_in(folder))
    view = _view_of(folder / "sensor.toml", sensor, (frame.shape[0], frame.shape[1]))
    return Setup(view, image_from_frame(frame, view).astype(np.float32))


def _view_of(settings: Path, sensor: str | None, frame_shape: tuple[int, int]) -> View:
    if settings.is_file():
        view = read_sensor_toml(settings).view
        if not view.is_identity:
            return view
    return View() if sensor is None else profile_named(sensor).view(frame_shape)
