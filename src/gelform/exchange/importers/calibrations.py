"""A Calibration from another package's calibration: one function for all formats."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import datetime, timezone
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gelform import __version__
from gelform.calibration_file import Calibration, CalibrationSettings
from gelform.exchange.importers.networks import read_gs_sdk, read_gsrobotics, read_gsrobotics_web
from gelform.exchange.importers.tables import mm_per_px_of_lut, read_lut
from gelform.foundations.checks import (
    check_choice,
    check_image,
    check_is,
    check_path,
    check_sensor_pitch,
)
from gelform.image.background.average import noise_from_image
from gelform.image.background.change import ChangeSettings
from gelform.image.view import View, image_from_frame
from gelform.sensors.profiles import SENSORS, check_gel_width, make_of, view_from_camera
from gelform.slopes.color_models import ColorModel

# Gray levels / 255. Pixels of a Mini at rest differ from its background by up to this, from noise and drift together.
UNTOUCHED_CHANGE = 8 / 255

PACKAGES: dict[str, Callable[..., ColorModel]] = {
    "gs_sdk": read_gs_sdk,
    "gsrobotics": read_gsrobotics,
    "gsrobotics-web": read_gsrobotics_web,
    "lut": read_lut,
}
POSITIONED = ("gsrobotics", "gsrobotics-web")
# Makes whose frames a package's own programs crop and resize, as their profiles do.
MAKES = dict.fromkeys(("gs_sdk", *POSITIONED), "gelsight-mini")


def import_calibration(
    path: str | PathLike[str],
    package: str,
    *,
    background: ArrayLike,
    mm_per_px: float | None = None,
    position: str | None = None,
    flip_depth: bool = False,
    range_levels: Sequence[float] | None = None,
    sensor_name: str | None = None,
) -> Calibration:
    """A calibration from another package's file, with gelform's signs and a current background image.

    Values that the file lacks stay unknown. Without `mm_per_px` the calibration gives gradients and depth in pixels.
    It states no standard deviation of the slopes, so confidence is 1 except at clipped pixels.

    Parameters
    ----------
    path : the package's file
    package : a name in `PACKAGES`: gs_sdk, gsrobotics, gsrobotics-web or lut
    background : (H, W, 3) RGB, 0-255, the background image, cropped and sized as that package's images; or a whole frame of
        the camera whose crop that package knows, which becomes the calibration's view
    mm_per_px : width of an image's pixel on the gel, mm, if known; by default what a `.mat` states
    position : required for gsrobotics and gsrobotics-web, and only there: "zeros", the input of its program, or "true", the
        input of its network's training
    flip_depth : only for lut: the table's surface falls where pressed
    range_levels : only for lut (`.npy`): (low, high) of the differences that it spans, gray levels; (-90, 90) by default
    sensor_name : name of the calibration's sensor; by default the file's name

    Raises
    ------
    DataError
        The file is not of that package or damaged, holds more than weights, or needs torch, which is not installed.
    ValueError
        The package is unknown, an option is missing or not accepted, or the scale is none of these images.
    """
    path = check_path(path)
    options = _options(check_is(package, str, "package"), position, flip_depth, range_levels)
    if sensor_name is not None:
        check_is(sensor_name, str, "sensor_name")
    frame = check_image(background, name="background").astype(np.float32)
    if package == "lut" and mm_per_px is None:
        mm_per_px = mm_per_px_of_lut(path, (frame.shape[0], frame.shape[1]))
    if mm_per_px is not None:
        mm_per_px = check_sensor_pitch(mm_per_px)
    view = _view(MAKES.get(package), (frame.shape[0], frame.shape[1]), mm_per_px)
    image = image_from_frame(frame, view)
    if mm_per_px is not None:
        make = MAKES.get(package) if not view.is_identity else make_of(sensor_name or "")
        check_gel_width((image.shape[0], image.shape[1]), mm_per_px, make)
    model = PACKAGES[package](path, image, **options)
    blur_px = (
        0.5**0.5 if package == "lut" else 0.0
    )  # as wide as the 3x3 blur of tables, weights 1/4, 1/2, 1/4
    change = ChangeSettings("subtract", 0.0, blur_px)
    return Calibration(
        sensor_name=sensor_name or Path(path).stem,
        serial=None,
        gel_id=None,
        view=view,
        image_shape=(image.shape[0], image.shape[1]),
        mm_per_px=mm_per_px,
        mm_per_px_sigma=None,
        background=image,
        background_noise=noise_from_image(image),
        change=change,
        color_model=model,
        forward=None,
        slope_sigma=None,
        untouched_change=UNTOUCHED_CHANGE,
        held_out={},
        training_digests=(),
        settings=CalibrationSettings(others={"imported_from": package, **options}),
        library_version=__version__,
        created_utc=datetime.now(timezone.utc).isoformat(timespec="seconds"),
    )


def _view(make: str | None, frame_shape: tuple[int, int], mm_per_px: float | None) -> View:
    """The view of a background (H, W): of a make's frame that crop, of its image that of its camera, else identity.

    ValueError: it is a frame of the make's camera, and the scale is not that of its images.
    """
    known = SENSORS[make] if make is not None else None
    if known is None or known.profile is None or known.camera is None:
        return View()
    profile = known.profile
    if frame_shape == profile.image_shape:
        return view_from_camera(make, frame_shape, mm_per_px)
    if (
        frame_shape != known.camera.frame_shape
    ):  # of another sensor, unless the scale says that it is this one
        cropped = profile.has_aspect(frame_shape) and profile.is_cropped_scale(mm_per_px)
        return profile.view(frame_shape) if cropped else View()
    if mm_per_px is not None and not profile.is_cropped_scale(mm_per_px):
        height, width = profile.image_shape
        raise ValueError(
            f"Expected mm_per_px of images of {height}x{width} px, to which frames of a {profile.name} are cropped and "
            f"resized, about {profile.mm_per_px:g}, got {mm_per_px:g}."
        )
    return profile.view(frame_shape)


def _options(
    package: str, position: str | None, flip_depth: bool, range_levels: Sequence[float] | None
) -> dict[str, Any]:
    """Keywords of the package's reader."""
    check_choice(package, PACKAGES, "a package")
    if position is not None:
        check_is(position, str, "position")
    if position not in (("zeros", "true") if package in POSITIONED else (None,)):
        raise ValueError(
            f"Expected position ('zeros' as its program feeds it, or 'true') for {' and '.join(POSITIONED)} and no "
            f"other, got {position!r} for {package}."
        )
    if check_is(flip_depth, bool, "flip_depth") and package != "lut":
        raise ValueError(
            f"Expected flip_depth for lut only, whose tables differ in sign, got it for {package}."
        )
    if package == "lut":
        return {"depth_sign": -1 if flip_depth else 1, "range_levels": range_levels}
    if range_levels is not None:
        raise ValueError(f"Expected range_levels for lut only, got it for {package}.")
    return {} if position is None else {"position": position}
