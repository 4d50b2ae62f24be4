"""Write what was measured beside the presses where it is read again: a `sensor.toml`, or a calibration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

from gelform.calibration.geometry.crosstalk import Crosstalk
from gelform.calibration.geometry.lens import GridView
from gelform.calibration.geometry.scale import Scale
from gelform.calibration.geometry.toml_text import Table, edited_toml
from gelform.calibration_file import load_calibration
from gelform.errors import CalibrationError, DataError
from gelform.npz_files import written_file
from gelform.sensors.files import read_sensor_toml


def save_scale(scale: Scale, place: str | PathLike[str], *, sensor_name: str | None = None) -> Path:
    """Write a scale into a `sensor.toml` or an imported calibration.

    Parameters
    ----------
    scale : from `scale_from_punch` and the like
    place : a folder, its `sensor.toml` (made where there is none), or a calibration
    sensor_name : for a new `sensor.toml`; the folder's name by default

    Returns
    -------
    Path
        The file that was written; it is replaced in one step.

    Raises
    ------
    CalibrationError
        The calibration was fitted on presses: its slopes hold at the scale of that time.
    DataError
        The file cannot be read, edited or written.
    """
    place = Path(place)
    if place.suffix == ".npz":
        return _save_in_calibration(scale, place)
    return _save_in_toml(place, _scale_values(scale), sensor_name)


def save_grid_view(found: GridView, place: str | PathLike[str], *, sensor_name: str | None = None) -> Path:
    """Write the lens and the scale that a grid told into a `sensor.toml`; a lens that was there is replaced.

    Parameters and errors as in `save_scale`; also a DataError where the `[view]` there crops, flips or resizes
    without a lens, and a CalibrationError for a calibration: its background and its color model are of other images.
    """
    place = Path(place)
    if place.suffix == ".npz":
        raise CalibrationError(
            f"Expected a folder or a sensor.toml for a lens, got the calibration {place}: it was made for images that "
            "the lens has not been undone in. Write the lens into sensor.toml and calibrate again."
        )
    file = _toml_in(place)
    if file.is_file():
        view = read_sensor_toml(file).view
        if view.lens is None and not view.is_identity:
            raise DataError(
                f"Expected {file} without a [view], or with that of an earlier lens, got a crop, flip or size. Take the "
                "[view] out: the lens brings its own."
            )
    view_values = found.view.to_dict()
    lens_values = view_values.pop("lens")
    changes: dict[Table, dict[str, Any]] = {**_scale_values(found.scale)}
    changes[("measured",)] = {**changes[("measured",)], "lens": found.describe()}
    changes |= {("view",): view_values, ("view", "lens"): lens_values}
    return _save_in_toml(place, changes, sensor_name, drop=[("view",)])


def save_crosstalk(crosstalk: Crosstalk, place: str | PathLike[str]) -> Path:
    """Write a crosstalk into an existing `sensor.toml`; parameters and errors as in `save_scale`."""
    place = Path(place)
    if place.suffix == ".npz" or not _toml_in(place).is_file():
        raise DataError(
            f"Expected a folder with a sensor.toml, or that file, for a crosstalk, got {place}. Write name and mm_per_px "
            "into sensor.toml first."
        )
    values = {"crosstalk": crosstalk.matrix, "crosstalk_spread": crosstalk.spread}
    return _save_in_toml(place, {("measured",): values})


def _scale_values(scale: Scale) -> dict[Table, dict[str, Any]]:
    values = {"mm_per_px": scale.mm_per_px, "mm_per_px_sigma": scale.sigma}
    return {(): values, ("measured",): {"scale": scale.source}}


def _toml_in(place: Path) -> Path:
    return place if place.suffix == ".toml" else place / "sensor.toml"


def _save_in_toml(
    place: Path,
    changes: Mapping[Table, Mapping[str, Any]],
    sensor_name: str | None = None,
    drop: Sequence[Table] = (),
) -> Path:
    file = _toml_in(place)
    if file.is_file():
        read_sensor_toml(file)  # what is wrong in it is said as always
        text = file.read_bytes().decode("utf-8")
    else:
        text = edited_toml("", {(): {"name": sensor_name or file.parent.resolve().name}})
    try:
        edited = edited_toml(text, changes, drop)
    except ValueError as problem:
        raise DataError(f"{file}: {problem}") from problem
    with written_file(file, overwrite=True) as handle:
        handle.write(edited.encode("utf-8"))
    return file


def _save_in_calibration(scale: Scale, place: Path) -> Path:
    calibration = load_calibration(place)
    if calibration.training_digests:
        raise CalibrationError(
            f"Expected a calibration without presses of its own (an imported one), got {place}, whose slopes were read "
            f"off balls at {calibration.mm_per_px:g} mm/px: another scale would leave them wrong. Write the scale into "
            "the presses' sensor.toml and calibrate again."
        )
    settings = {**calibration.settings, "scale_source": scale.source}
    replace(calibration, mm_per_px=scale.mm_per_px, mm_per_px_sigma=scale.sigma, settings=settings).save(
        place, overwrite=True
    )
    return place
