"""Press set: the presses of a ball on one sensor, from any source, for calibration."""

from __future__ import annotations

import csv
import io
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.arrays import Array
from gelform.calibration.geometry.measured import Geometry
from gelform.errors import DataError, said
from gelform.foundations.checks import check_positive, check_sensor_pitch
from gelform.foundations.files import MAX_ARRAY_BYTES, bytes_of, plain_cell
from gelform.image.view import View, pixels_digest, scale_of
from gelform.sensors.files import SensorSettings
from gelform.sensors.profiles import check_gel_width, make_of, view_from_camera

if TYPE_CHECKING:
    from gelform.simulate import SimulatedPresses

NAMED = 5  # places, images and presses that a note lists
MIN_IMAGE_PX = 24  # of an image's height and width; a contact has no room in less
UNREAD = np.empty((0, 0, 3), np.uint8)  # the image of a press that is listed, before it is read
Circle = tuple[float, float, float]  # (center x, center y, radius), px


@dataclass(frozen=True)
class _Image:
    """An image of a press, whatever was pressed."""

    name: str  # path of the image below the folder, or its place in the film
    image: NDArray[Any]  # (H, W, 3) uint8, RGB, after the view

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the image's pixels."""
        return pixels_digest(self.image)


@dataclass(frozen=True, repr=False)
class Press(_Image):
    """One press of a ball; ValueError, TypeError: a diameter outside 0.1 to 200 mm."""

    ball_diameter_mm: float
    label: Circle | None = None  # (center x, center y, contact radius) in px of the image
    # (x, y) in px of the image, if only the center is known, from a stage
    center_px: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        try:
            check_ball_diameter(self.ball_diameter_mm)
        except (TypeError, ValueError) as problem:
            raise type(problem)(f"{problem} ({self.name})") from None

    def __repr__(self) -> str:
        return f"Press({self.name}, ball {self.ball_diameter_mm:g} mm{', labeled' if self.label else ''})"


@dataclass(frozen=True, repr=False)
class FlatPress(_Image):
    """One press of a flat punch of known height, level on the gel."""

    height_mm: float  # of the middle of its face over the gel around it

    def __repr__(self) -> str:
        return f"FlatPress({self.name}, {self.height_mm:g} mm high)"


@dataclass(frozen=True)
class Presses:
    """Presses of one sensor with one gel; ValueError: `mm_per_px` is of no sensor."""

    folder: str  # their source
    presses: tuple[Press, ...]  # in the order of the table, or of their names, or of time
    background: NDArray[np.float32]  # (H, W, 3), the background image, after the view
    mm_per_px: float  # of the images, mm
    mm_per_px_sigma: float | None  # its standard deviation, if known
    sensor_name: str  # from sensor.toml or the profile, as serial and gel_id
    serial: str | None
    gel_id: str | None
    view: View  # from frames to images
    response: float = 1.0  # exponent of the camera's response, from sensor.toml; removed if it is not 1
    geometry: Geometry = field(default_factory=Geometry)  # separate measurements: scale, crosstalk, lens
    # (3,) standard deviation of a pixel in one frame, gray levels; None if only one frame of the gel at rest was there
    background_noise: NDArray[np.float64] | None = None
    camera: Mapping[str, float | str] = field(default_factory=dict)  # its settings, from sensor.toml
    notes: tuple[str, ...] = ()  # for the user, about the reading, such as parts of a film that were left out
    flats: tuple[FlatPress, ...] = ()  # presses of a flat punch, besides those of a ball
    # name of the make's profile, from sensor.toml, or from the start of the sensor's name; None if unknown
    make: str | None = None
    reduced_by: int = 1  # pixels of the images as read along a side of one of these

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

    def reduced(self) -> Presses:
        """The same with means over squares of pixels, as wide as the blur of color changes leaves nothing finer.

        Color changes are blurred by a length that grows with the image (`circles.find.BLUR_PX`), so images with a shorter
        side of 480 px or more lose nothing. Smaller ones stay as they are. What lies beyond the last square is left out.
        """
        side = int(scale_of(self.image_shape))
        if side < 2:
            return self

        def smaller(image: Array) -> Array:
            height, width = (n // side for n in image.shape[:2])
            part = image[: height * side, : width * side]
            return np.asarray(cv2.resize(part, (width, height), interpolation=cv2.INTER_AREA))

        presses = [
            replace(
                press,
                image=smaller(press.image),
                label=press.label and _circle_at_scale(press.label, side),
                center_px=press.center_px and _circle_at_scale((*press.center_px, 0.0), side)[:2],
            )
            for press in self.presses
        ]
        return replace(
            self,
            presses=tuple(presses),
            flats=tuple(replace(flat, image=smaller(flat.image)) for flat in self.flats),
            background=smaller(self.background),
            mm_per_px=side * self.mm_per_px,
            mm_per_px_sigma=self.mm_per_px_sigma and side * self.mm_per_px_sigma,
            reduced_by=side * self.reduced_by,
        )

    def as_read(self, circle: Circle) -> Circle:
        """A circle in these images, in px of the images as they were read."""
        return _circle_at_scale(circle, 1 / self.reduced_by)

    def from_read(self, circle: Circle) -> Circle:
        """A circle in the images as they were read, in px of these."""
        return _circle_at_scale(circle, self.reduced_by)


def _circle_at_scale(circle: Circle, side: float) -> Circle:
    """A circle where a pixel is `side` times as wide; centers of pixels are at integers."""
    x, y, radius = circle
    return (x + 0.5) / side - 0.5, (y + 0.5) / side - 0.5, radius / side


def presses_from_simulated(made: SimulatedPresses) -> Presses:
    """Simulated presses, in the form that `read_presses` gives for a folder without labels."""
    settings = SensorSettings(made.sensor.name, made.sensor.mm_per_px)
    presses = [Press(f"press {k}", one.image, one.ball_diameter_mm) for k, one in enumerate(made.presses)]
    background = made.background.astype(np.float32)
    return presses_from_settings(settings, "simulated presses", presses, background, View())


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
    except ValueError as problem:
        raise DataError(f"{folder}: {problem}") from problem


def table_rows(path: Path, columns: tuple[str, ...]) -> Iterator[tuple[str, dict[str, str]]]:
    """Rows of a CSV with their line numbers; DataError for missing columns, too many or few fields, or no text.

    After a header with semicolons, semicolons separate and numbers may have a decimal comma: so spreadsheets write where
    the comma is the decimal sign.
    """
    try:
        text = bytes_of(path, f"a table with the columns {', '.join(columns)}", MAX_ARRAY_BYTES).decode(
            "utf-8-sig"
        )
        file = io.StringIO(text, newline="")
        header = file.readline()
        file.seek(0)
        semicolons = header.count(";") > header.count(",")
        reader = csv.DictReader(file, delimiter=";" if semicolons else ",")
        names = list(reader.fieldnames or [])
        missing = [name for name in columns if name not in names]
        if missing:
            raise DataError(
                f"Expected the columns {', '.join(columns)} in {path}, got {', '.join(names) or 'none'}: "
                f"{', '.join(missing)} missing."
            )
        for row in reader:
            fields = [*(value for value in row.values() if isinstance(value, str)), *row.get(None, ())]
            if not any(value.strip() for value in fields):
                continue
            where = f"{path}, line {reader.line_num}"
            if len(fields) != len(names):
                raise DataError(
                    f"Expected {len(names)} fields, got {len(fields)} ({where}). Was a decimal comma meant? Write "
                    "6.35, quote texts that have commas, and keep the commas of empty fields."
                )
            cells = {name: plain_cell(value.strip()) for name, value in row.items()}
            if semicolons:
                cells = {k: re.sub(r"\A([+-]?\d+),(\d+)\Z", r"\1.\2", cell) for k, cell in cells.items()}
            yield where, cells
    except UnicodeDecodeError as problem:
        raise DataError(
            f"{path} is no table of text in UTF-8: byte {problem.start} is none. Save it as UTF-8."
        ) from problem
    except csv.Error as problem:
        raise DataError(f"{path} is no table of comma-separated text: {said(problem)}.") from problem


def file_of(folder: Path, name: str) -> str:
    """A file's name from a table, also where Windows wrote its folders."""
    return name if os.path.exists(folder / name) else name.replace("\\", "/")


def check_ball_diameter(ball_diameter_mm: float) -> float:
    """A ball's diameter in mm: 0.1 to 200; TypeError or ValueError for others."""
    value = check_positive(ball_diameter_mm, "ball_diameter_mm")
    if value > 200:
        raise ValueError(f"Expected ball_diameter_mm up to 200 mm, got {value:g}.")
    if value < 0.1:
        raise ValueError(f"Expected ball_diameter_mm of at least 0.1 mm, got {value:g}. Is it in mm?")
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
