"""Press set: the presses of a ball on one sensor, from any source, for calibration."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.geometry.measured import Geometry
from gelform.errors import DataError
from gelform.foundations.checks import (
    check_positive,
    check_sensor_pitch,
    check_sensor_pitches,
)
from gelform.foundations.files import plain_cell, present_file
from gelform.image.frame import pixels_digest, rgb_from_bgr
from gelform.image.view import View, image_from_frame
from gelform.sensors.files import SensorSettings, read_sensor_toml
from gelform.sensors.profiles import PROFILES, check_gel_width, make_of, profile_named, view_from_camera

if TYPE_CHECKING:
    from gelform.simulate import SimulatedPresses

MIN_BALL_MM, MAX_BALL_MM = 0.1, 200.0  # mm; other diameters are in another unit
MIN_IMAGE_PX = 24  # of an image's height and width; a contact has no room in less
MIN_HEIGHT_MM, MAX_HEIGHT_MM = 0.01, 20.0  # mm over the gel, of flat punches


@dataclass(frozen=True)
class Press:
    """One press of a ball.

    Attributes
    ----------
    name : path of the image below the folder, or its place in the video
    image : (H, W, 3) uint8, RGB, after the view
    ball_diameter_mm : float
    label : (center x, center y, contact radius) in px of the image, if labeled
    digest : SHA-256 of the image's pixels
    center_px : (x, y) in px of the image, if only the center is known, from a stage
    """

    name: str
    image: NDArray[Any]
    ball_diameter_mm: float
    label: tuple[float, float, float] | None
    digest: str
    center_px: tuple[float, float] | None = None

    def __repr__(self) -> str:
        return f"Press({self.name}, ball {self.ball_diameter_mm:g} mm{', labeled' if self.label else ''})"


@dataclass(frozen=True)
class FlatPress:
    """One press of a flat punch of known height, level on the gel.

    Attributes
    ----------
    name : path of the image below the folder
    image : (H, W, 3) uint8, RGB, after the view
    height_mm : height of the middle of its face over the gel around it
    digest : SHA-256 of the image's pixels
    """

    name: str
    image: NDArray[Any]
    height_mm: float
    digest: str

    def __repr__(self) -> str:
        return f"FlatPress({self.name}, {self.height_mm:g} mm high)"


@dataclass(frozen=True)
class Presses:
    """Presses of one sensor with one gel.

    Attributes
    ----------
    folder : their source
    presses : in the order of the table, or of their names, or of time
    background : (H, W, 3) float32, the background image, after the view
    mm_per_px, mm_per_px_sigma : pixel pitch of the images, mm, and its standard deviation if known
    sensor_name, serial, gel_id : from sensor.toml or the profile
    make : name of the make's profile, from there too or from the start of the sensor's name; None if unknown
    view : conversion of frames to images
    response : exponent of the camera's response, from sensor.toml; removed if it is not 1
    geometry : separate measurements: scale, crosstalk, lens
    background_noise : (3,) standard deviation of a pixel in one frame, gray levels; None if only
        one frame of the gel at rest was there
    camera : settings of the camera, from sensor.toml; empty if unknown
    notes : notes for the user about the reading, such as parts of a video that were left out
    flats : presses of a flat punch of known height, besides those of a ball
    """

    folder: str
    presses: tuple[Press, ...]
    background: NDArray[np.float32]
    mm_per_px: float
    mm_per_px_sigma: float | None
    sensor_name: str
    serial: str | None
    gel_id: str | None
    view: View
    response: float = 1.0
    geometry: Geometry = field(default_factory=Geometry)
    background_noise: NDArray[np.float64] | None = None
    camera: Mapping[str, float | str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    flats: tuple[FlatPress, ...] = ()
    make: str | None = None

    def __post_init__(self) -> None:
        if self.make is None:
            object.__setattr__(self, "make", make_of(self.sensor_name))
        check_gel_width(self.image_shape, check_sensor_pitch(self.mm_per_px), self.make)

    def __repr__(self) -> str:
        height, width = self.image_shape
        balls = ", ".join(f"{ball:g}" for ball in sorted({press.ball_diameter_mm for press in self.presses}))
        flats = f", {len(self.flats)} of flat punches" if self.flats else ""
        return (
            f"Presses({self.folder}: {len(self.presses)} of balls of {balls or 'no'} mm{flats}, {self.sensor_name}, "
            f"{height}x{width} px, {self.mm_per_px:g} mm per pixel)"
        )

    @property
    def image_shape(self) -> tuple[int, int]:
        """(H, W) of the images."""
        return self.background.shape[0], self.background.shape[1]

    @property
    def camera_view(self) -> View:
        """The view, or that of the make's camera where these are the make's images already."""
        if not self.view.is_identity:
            return self.view
        return view_from_camera(self.make, self.image_shape, self.mm_per_px)

    def subset(self, indices: Sequence[int]) -> Presses:
        """The same sensor with some of the presses of a ball, and all flat punches."""
        return replace(self, presses=tuple(self.presses[i] for i in indices))


def presses_from_simulated(made: SimulatedPresses) -> Presses:
    """Simulated presses, in the form that `read_presses` gives for a folder without labels."""
    settings, background = SensorSettings(made.sensor.name, made.sensor.mm_per_px), made.background
    presses = [
        press_from_frame(Listed(f"press {k}", press.ball_diameter_mm), press.image, View())
        for k, press in enumerate(made.presses)
    ]
    return presses_from_settings(
        settings, "simulated presses", presses, background.astype(np.float32), View()
    )


@dataclass(frozen=True)
class ReadOptions:
    """Options of `read_presses`; each overrides the folder."""

    sensor: str | None = None  # name of a profile
    mm_per_px: float | tuple[float, float] | None = None  # or (x, y)
    ball_diameter_mm: float | None = None
    background: Path | None = None  # path of the background image
    crop: tuple[float, float, float, float] | None = None  # (left, top, width, height) in pixels of the frame
    bgr: bool = False  # whether all images, the background too, are blue, green, red

    def in_rgb(self, image: NDArray[Any]) -> NDArray[Any]:
        """An image as it was read, in RGB."""
        return rgb_from_bgr(image) if self.bgr else image

    def __post_init__(self) -> None:
        if self.mm_per_px is not None:
            check_sensor_pitches(self.mm_per_px)
        if self.ball_diameter_mm is not None:
            check_ball_diameter(self.ball_diameter_mm)

    def settings(self, place: Path, known: SensorSettings | None = None) -> SensorSettings:
        """sensor.toml next to the data, else the data's own settings, else the profile.

        A given scale and the name of a profile override them.
        """
        settings, profile = known, None if self.sensor is None else profile_named(self.sensor)
        toml = place / "sensor.toml" if place.is_dir() else place.parent / "sensor.toml"
        if toml.is_file():
            settings = read_sensor_toml(toml)
        elif profile is not None:
            settings = known or SensorSettings(
                profile.name,
                profile.mm_per_px,
                profile.mm_per_px_sigma,
                gel_thickness_mm=profile.gel_thickness_mm,
            )
        if self.sensor is not None and settings is not None:
            settings = replace(settings, make=self.sensor)
        if self.mm_per_px is not None:
            pitch = check_sensor_pitches(self.mm_per_px)
            if settings is None:
                return SensorSettings(place.resolve().stem, pitch)
            others = {name: value for name, value in settings.measured.items() if name != "scale"}
            return replace(settings, mm_per_px=pitch, mm_per_px_sigma=None, measured=others)
        if settings is None:
            raise DataError(
                f"No scale for {place}: presses of a ball alone do not tell it. Write name and mm_per_px into "
                f"{toml}, give mm_per_px= (--mm-per-px) or sensor= (--sensor), or measure it on two marked points "
                "or a stage's step (gelform scale), or on a grid (gelform lens)."
            )
        return settings

    def view(self, settings: SensorSettings, frame_shape: tuple[int, int]) -> View:
        """The requested crop, else sensor.toml's view, else the profile's if the images are frames of it; square pixels."""
        if self.crop is not None:
            try:
                view = View(frame_shape=frame_shape, crop=self.crop)
            except ValueError as problem:  # the frame shows it, not the option alone
                raise DataError(f"{problem} It is crop= (--crop).") from problem
        elif settings.view.is_identity and self._is_profile_s(settings):
            view = profile_named(self.sensor or settings.make).view(frame_shape)
        else:
            view = settings.view
        return settings.squared(view, frame_shape)

    def _is_profile_s(self, settings: SensorSettings) -> bool:
        """Whether images are those of the make's profile: so the user says, or their scale."""
        return self.sensor is not None or (
            settings.make != "" and PROFILES[settings.make].is_cropped_scale(settings.square_mm_per_px)
        )

    def ball(self, what: str) -> float:
        """The ball's diameter, for data without it."""
        if self.ball_diameter_mm is None:
            raise DataError(
                f"{what}: which ball pressed? Give ball_diameter_mm= (--ball-diameter-mm), or write presses.csv "
                "with the columns image,ball_diameter_mm."
            )
        return check_ball_diameter(self.ball_diameter_mm)


def check_room(shape: tuple[int, ...]) -> None:
    """DataError: images of this shape (H, W, ...) are too small to hold a contact."""
    if min(shape[:2]) < MIN_IMAGE_PX:
        raise DataError(
            f"Expected images of at least {MIN_IMAGE_PX} px in height and width, got {shape[0]}x{shape[1]} px. Look at "
            "the crop and the view."
        )


def presses_from_settings(
    settings: SensorSettings,
    folder: str,
    presses: Sequence[Press],
    background: NDArray[np.float32],
    view: View,
    **more: Any,
) -> Presses:
    """The press set of a sensor, with the given other fields of `Presses`.

    DataError: the images are too small to hold a contact, or the scale is of no sensor.
    """
    check_room(background.shape)
    try:
        check_gel_width(
            background.shape[:2], settings.square_mm_per_px, settings.make or make_of(settings.name)
        )
    except ValueError as problem:
        raise DataError(f"{folder}: {problem}") from problem
    return Presses(
        folder=folder,
        presses=tuple(presses),
        background=background,
        mm_per_px=settings.square_mm_per_px,
        mm_per_px_sigma=settings.mm_per_px_sigma,
        sensor_name=settings.name,
        serial=settings.serial or None,
        gel_id=settings.gel_id or None,
        make=settings.make or None,
        view=view,
        response=settings.response,
        camera=settings.camera,
        geometry=Geometry.from_settings(settings.measured, settings.gel_thickness_mm),
        **more,
    )


@dataclass(frozen=True)
class Listed:
    """One press in a table, before its image is read; names and pixels as in `Press`."""

    name: str
    ball_diameter_mm: float
    label: tuple[float, float, float] | None = None
    center_px: tuple[float, float] | None = None


@dataclass(frozen=True)
class ListedFlat:
    """One press of a flat punch in a table, before its image is read."""

    name: str
    height_mm: float


@dataclass(frozen=True)
class PressSource:
    """Presses as a reader finds them."""

    background: NDArray[Any]  # (H, W, 3) uint8, RGB, frame of the gel at rest
    listed: Sequence[Listed]  # the presses
    # function of the number of a press to its frame, (H, W, 3) uint8, RGB; flat punches follow the balls
    frame: Callable[[int], NDArray[Any]]
    known: SensorSettings | None = None  # settings of the sensor in the data, if any
    flats: Sequence[ListedFlat] = ()  # presses of a flat punch
    notes: tuple[str, ...] = ()  # notes for the user about the list


def press_from_frame(listed: Listed, frame: NDArray[Any], view: View) -> Press:
    """A press whose image is the frame after the view."""
    image = np.ascontiguousarray(image_from_frame(frame, view))
    return Press(
        listed.name, image, listed.ball_diameter_mm, listed.label, pixels_digest(image), listed.center_px
    )


def flat_from_frame(listed: ListedFlat, frame: NDArray[Any], view: View) -> FlatPress:
    """A press of a flat punch whose image is the frame after the view."""
    image = np.ascontiguousarray(image_from_frame(frame, view))
    return FlatPress(listed.name, image, listed.height_mm, pixels_digest(image))


def table_rows(path: Path, columns: tuple[str, ...]) -> Iterator[tuple[str, dict[str, str]]]:
    """Rows of a CSV with their line numbers; DataError for missing columns, too many or few fields, or no text.

    After a header with semicolons, semicolons separate and numbers may have a decimal comma: so spreadsheets write where
    the comma is the decimal sign.
    """
    try:
        with present_file(path, "a table").open(newline="", encoding="utf-8-sig") as file:
            header = file.readline()
            file.seek(0)
            semicolons = header.count(";") > header.count(",")
            reader = csv.DictReader(file, delimiter=";" if semicolons else ",")
            missing = [c for c in columns if c not in (reader.fieldnames or [])]
            if missing:
                there = ", ".join(reader.fieldnames or []) or "none"
                raise DataError(
                    f"Expected the columns {', '.join(columns)} in {path}, got {there}: {', '.join(missing)} missing."
                )
            for row in reader:
                fields = [*(value for value in row.values() if isinstance(value, str)), *row.get(None, ())]
                if not any(value.strip() for value in fields):
                    continue
                where = f"{path}, line {reader.line_num}"
                if len(fields) != len(reader.fieldnames or []):
                    raise DataError(
                        f"Expected {len(reader.fieldnames or [])} fields, got {len(fields)} ({where}). Was a decimal comma "
                        "meant? Write 6.35, quote texts that have commas, and keep the commas of empty fields."
                    )
                cells = {name: plain_cell(value.strip()) for name, value in row.items()}
                yield where, {name: _pointed(cell) for name, cell in cells.items()} if semicolons else cells
    except UnicodeDecodeError as problem:
        raise DataError(
            f"{path} is no table of text in UTF-8: byte {problem.start} is none. Save it as UTF-8."
        ) from problem
    except csv.Error as problem:
        raise DataError(f"{path} is no table of comma-separated text: {problem}.") from problem
    except OSError as problem:
        raise DataError(f"Cannot read {path}: {problem.strerror or problem}.") from problem


def _pointed(cell: str) -> str:
    """A number with a decimal comma, with a point; any other text unchanged."""
    return cell.replace(",", ".") if re.fullmatch(r"[+-]?\d+,\d+", cell) else cell


def file_of(folder: Path, name: str) -> str:
    """A file's name from a table, also where Windows wrote its folders."""
    return name if os.path.exists(folder / name) else name.replace("\\", "/")


def diameter(text: str, where: str) -> float:
    """A ball's diameter in mm, from a table."""
    try:
        return check_ball_diameter(number(text, "ball diameter", where))
    except ValueError as problem:
        raise DataError(f"{problem} ({where})") from None


def check_ball_diameter(ball_diameter_mm: float) -> float:
    """A ball's diameter in mm: 0.1 to 200; TypeError or ValueError for others."""
    value = check_positive(ball_diameter_mm, "ball_diameter_mm")
    if value > MAX_BALL_MM:
        raise ValueError(f"Expected ball_diameter_mm up to {MAX_BALL_MM:g} mm, got {value:g}.")
    if value < MIN_BALL_MM:
        raise ValueError(
            f"Expected ball_diameter_mm of at least {MIN_BALL_MM:g} mm, got {value:g}. Is it in mm?"
        )
    return value


def height(text: str, where: str) -> float:
    """Height of a flat punch over the gel around it, mm, from a table: 0.01 to 20."""
    value = number(text, "height_mm", where)
    if not MIN_HEIGHT_MM <= value <= MAX_HEIGHT_MM:
        raise DataError(
            f"Expected height_mm of {MIN_HEIGHT_MM:g} to {MAX_HEIGHT_MM:g} mm, got {value:g}. Is it in mm? ({where})"
        )
    return value


def number(text: str, name: str, where: str) -> float:
    """A finite number from a table."""
    try:
        value = float(text)
    except ValueError:
        raise DataError(f"Expected {name} as a number, got {text!r} ({where}).") from None
    if not np.isfinite(value):
        raise DataError(f"Expected {name} as a finite number, got {text!r} ({where}).")
    return value
