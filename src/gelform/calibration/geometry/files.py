"""Write measurements apart from the presses to a `sensor.toml` or a calibration, and read the setup for them.

A TOML file keeps its comments, its order and all other keys.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from numpy.typing import NDArray
from tomlkit.exceptions import TOMLKitError

from gelform.calibration.geometry.measured import Crosstalk
from gelform.calibration.geometry.scale import GridView, Scale
from gelform.calibration_file import load_calibration
from gelform.errors import CalibrationError, DataError
from gelform.foundations.files import written_file
from gelform.image.view import View, image_from_frame
from gelform.sensors.files import background_in, read_background, read_image, read_sensor_toml
from gelform.sensors.profiles import check_gel_width, make_of, profile_named

Table = tuple[str, ...]


def edited_toml(text: str, changes: Mapping[Table, Mapping[str, Any]], drop: Sequence[Table] = ()) -> str:
    """TOML text with some values changed; "" stands for a new file.

    `changes` are, by table (a path of names, () for the top level), numbers, texts, or lists of them by key; the tables
    `drop` are removed first. ValueError: the text is no TOML, or has a value where a table is meant.
    """

    def table_in(document: Any, path: Table) -> Any:
        for name in path:
            if name not in document:
                document[name] = tomlkit.table()
            document = document[name]
        return document

    try:
        document = tomlkit.parse(text)
        for path in drop:
            table_in(document, path[:-1]).pop(path[-1], None)
        for path, values in changes.items():
            table_in(document, path).update(json.loads(json.dumps(values)))
    except (TOMLKitError, TypeError, AttributeError) as problem:
        raise ValueError(f"the settings cannot be written into it: {problem}") from problem
    edited = tomlkit.dumps(document)
    if tomlkit.parse(edited).unwrap() != document.unwrap():
        raise ValueError("the settings cannot be written into it. Put each key on a line of its own.")
    return edited


def stated_scale(place: str | PathLike[str]) -> float | None:
    """The one mm per pixel that `save_scale` would replace in a `sensor.toml`, if there is one."""
    file = None if Path(place).suffix == ".npz" else _toml_in(Path(place))
    stated = read_sensor_toml(file).mm_per_px if file is not None and file.is_file() else None
    return stated if isinstance(stated, float) else None


def save_scale(scale: Scale, place: str | PathLike[str]) -> Path:
    """Write a scale into a `sensor.toml` or an imported calibration, in one step; return the written file.

    `place` is a folder, its `sensor.toml` (created if missing, for a sensor of the folder's name), or a calibration.

    Raises
    ------
    CalibrationError
        The calibration was fitted on presses, and its slopes hold only at their scale.
    DataError
        The file cannot be read, edited or written, or the gel would have a width that no sensor has.
    """
    place = Path(place)
    width_note(scale.mm_per_px, place)
    if place.suffix != ".npz":
        file = _toml_in(place)
        if file.is_file() and isinstance(read_sensor_toml(file).mm_per_px, tuple):
            raise DataError(
                f"Expected one mm_per_px in {file}, got a pair for pixels that are not square, which one scale does not "
                "give. Measure x and y and write both, or take gelform lens."
            )
        return _save_in_toml(file, _scale_values(scale))
    calibration = load_calibration(place)
    if calibration.training_digests:
        raise CalibrationError(
            f"Expected a calibration without presses of its own (an imported one), got {place}, whose slopes were read "
            f"off balls at {calibration.mm_per_px:g} mm/px: another scale would leave them wrong. Write the scale into "
            "the presses' sensor.toml and calibrate again."
        )
    settings = replace(calibration.settings, scale_source=scale.source)
    scaled = replace(calibration, mm_per_px=scale.mm_per_px, mm_per_px_sigma=scale.sigma, settings=settings)
    scaled.save(place, overwrite=True)
    return place


def width_note(mm_per_px: float, place: Path) -> str | None:
    """The note of `check_gel_width` on a scale of the images at a place as in `save_scale`; None where none is seen.

    DataError: no sensor's gel is that wide.
    """
    make = None
    if place.suffix == ".npz":
        calibration = load_calibration(place)
        shape, make = calibration.image_shape, make_of(calibration.sensor_name)
    else:
        file = _toml_in(place)
        try:
            rest = read_background(background_in(file.parent))
        except DataError:  # no background yet: calibrate looks again
            return None
        shape = (rest.shape[0], rest.shape[1])
        if file.is_file():
            settings = read_sensor_toml(file)
            shape, make = settings.view.shape or shape, settings.make or make_of(settings.name)
    try:
        return check_gel_width(shape, mm_per_px, make)
    except ValueError as problem:
        raise DataError(f"{place}: {problem}") from problem


def save_grid_view(found: GridView, place: str | PathLike[str]) -> Path:
    """Write the lens and the scale of a grid into a `sensor.toml`, in place of an earlier lens; return the file.

    `place` and errors are those of `save_scale`. It also raises a DataError if the `[view]` there crops, flips or resizes
    without a lens, and a CalibrationError for a calibration, because its background and color model belong to other images.
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
    changes = _scale_values(found.scale)
    changes[("measured",)]["lens"] = found.describe()
    lens_values = view_values.pop("lens")
    changes |= {("view",): view_values, ("view", "lens"): lens_values}
    return _save_in_toml(file, changes, drop=[("view",)])


def save_crosstalk(crosstalk: Crosstalk, place: str | PathLike[str]) -> Path:
    """Write a crosstalk into an existing `sensor.toml`, and return that; `place` and errors as in `save_scale`."""
    place = Path(place)
    if place.suffix == ".npz" or not _toml_in(place).is_file():
        raise DataError(
            f"Expected a folder with a sensor.toml, or that file, for a crosstalk, got {place}. Write name and mm_per_px "
            "into sensor.toml first."
        )
    values = {"crosstalk": crosstalk.matrix, "crosstalk_spread": crosstalk.spread}
    return _save_in_toml(_toml_in(place), {("measured",): values})


def _scale_values(scale: Scale) -> dict[Table, dict[str, Any]]:
    values = {"mm_per_px": scale.mm_per_px, "mm_per_px_sigma": scale.sigma}
    return {(): values, ("measured",): {"scale": scale.source}}


def _toml_in(place: Path) -> Path:
    return place if place.suffix == ".toml" else place / "sensor.toml"


def _save_in_toml(file: Path, changes: Mapping[Table, Mapping[str, Any]], drop: Sequence[Table] = ()) -> Path:
    if file.is_file():
        read_sensor_toml(file)  # raises the usual errors for the file
        text = file.read_bytes().decode("utf-8")
    else:
        text = edited_toml("", {(): {"name": file.parent.resolve().name}})
    try:
        edited = edited_toml(text, changes, drop)
    except ValueError as problem:
        raise DataError(f"{file}: {problem}") from problem
    with written_file(file, overwrite=True) as handle:
        handle.write(edited.encode("utf-8"))
    return file


@dataclass(frozen=True)
class SensorSetup:
    """The setup of a sensor."""

    view: View  # from its frames to images
    background: NDArray[np.float32]  # (H, W, 3)

    def image(self, path: Path) -> NDArray[Any]:
        """The image (H, W, 3) of a frame in a file."""
        return image_from_frame(read_image(path), self.view)


def read_setup(place: Path, *, background: Path | None = None, sensor: str | None = None) -> SensorSetup:
    """The view and the background image of a press folder, its `sensor.toml` or a calibration.

    `background` is the background frame, if it is not the folder's `background.png`; `sensor` names a profile, for the
    view of a folder without one in a `sensor.toml`. DataError, CalibrationError: one is missing or unreadable.
    """
    if place.suffix == ".npz":
        calibration = load_calibration(place)
        if background is None:
            return SensorSetup(calibration.view, calibration.background)
        view, frame = calibration.view, read_background(background)
    else:
        folder = place.parent if place.suffix == ".toml" else place
        if not folder.is_dir():
            raise DataError(
                f"Expected a folder, its sensor.toml or a calibration, got {place}, which is not there."
            )
        frame = read_background(background or background_in(folder))
        toml = folder / "sensor.toml"
        view = read_sensor_toml(toml).view if toml.is_file() else View()
        if view.is_identity and sensor is not None:
            view = profile_named(sensor).view((frame.shape[0], frame.shape[1]))
    return SensorSetup(view, image_from_frame(frame, view).astype(np.float32))
