"""Read presses of a ball: a press folder, gs_sdk's folder, or a plain folder of images."""

from __future__ import annotations

import csv
import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.geometry import Geometry
from gelform.checks import check_positive
from gelform.errors import DataError
from gelform.progress import Progress, no_progress
from gelform.sensors.backgrounds import read_background
from gelform.sensors.files import IMAGE_SUFFIXES, SensorSettings, read_image, read_sensor_toml
from gelform.sensors.profiles import profile_named
from gelform.view import View, image_from_frame

LABEL_COLUMNS = ("center_x_px", "center_y_px", "contact_radius_px")


@dataclass(frozen=True)
class Press:
    """One press of a ball.

    Attributes
    ----------
    name : path of the image below the folder
    image : (H, W, 3) uint8, RGB, after the view
    ball_diameter_mm : float
    label : (centre x, centre y, contact radius) in px of the image, where somebody labelled it
    digest : SHA-256 of the image's pixels
    """

    name: str
    image: NDArray[Any]
    ball_diameter_mm: float
    label: tuple[float, float, float] | None
    digest: str


@dataclass(frozen=True)
class Presses:
    """A folder of presses of one sensor with one gel.

    Attributes
    ----------
    folder : where they came from
    presses : in the order of the table, or of their names
    background : (H, W, 3) float32, the untouched image, after the view
    mm_per_px, mm_per_px_sigma : pixel pitch of the images, mm, and its standard deviation where known
    sensor_name, serial, gel_id : from sensor.toml or the profile
    view : how frames become images
    response : exponent of the camera's response, from sensor.toml; undone where it is not 1
    geometry : what was measured beside the presses: scale, crosstalk, lens
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

    @property
    def image_shape(self) -> tuple[int, int]:
        """(H, W) of the images."""
        return self.background.shape[0], self.background.shape[1]

    def subset(self, indices: Sequence[int]) -> Presses:
        """The same sensor with some of the presses."""
        return replace(self, presses=tuple(self.presses[i] for i in indices))


@dataclass(frozen=True)
class _Row:
    name: str
    ball_diameter_mm: float
    label: tuple[float, float, float] | None


def read_presses(
    path: str | PathLike[str],
    *,
    sensor: str | None = None,
    mm_per_px: float | None = None,
    ball_diameter_mm: float | None = None,
    background: str | PathLike[str] | None = None,
    crop: tuple[float, float, float, float] | None = None,
    progress: Progress = no_progress,
) -> Presses:
    """Read a folder of ball presses.

    Parameters
    ----------
    path : folder with `presses.csv` (columns image, ball_diameter_mm), or gs_sdk's with `catalog.csv`, or of
        plain images together with `ball_diameter_mm`
    sensor : name of a profile, which gives the view and mm_per_px
    mm_per_px : pixel pitch, mm; goes before sensor.toml and the profile
    ball_diameter_mm : for a folder without a table
    background : the untouched image, or a folder of several; the folder's `background.png` or `background/` by default
    crop : (left, top, width, height) in pixels of the frame
    progress : called with (done, total, what)

    Raises
    ------
    DataError
        The folder, a table, a column or an image is missing or unreadable, sizes differ, no scale is known, or
        a ball diameter is not a number > 0. The message says what was expected and what to do.
    """
    folder = Path(path)
    if not folder.is_dir():
        kind = "a file" if folder.exists() else "not there"
        raise DataError(f"Expected a folder of presses, got {folder}, which is {kind}.")
    settings = _settings(folder, sensor, mm_per_px)
    rest_path = Path(background) if background is not None else _background_of(folder)
    rows = _rows(folder, ball_diameter_mm, rest_path)
    rest = read_background(rest_path)
    frame_shape = (rest.shape[0], rest.shape[1])
    view = _view(settings, sensor, crop, frame_shape)
    presses = []
    for done, row in enumerate(rows):
        presses.append(_press(folder, row, view, frame_shape))
        progress(done + 1, len(rows), "reading presses")
    return Presses(
        folder=str(folder),
        presses=tuple(presses),
        background=image_from_frame(rest, view).astype(np.float32),
        mm_per_px=settings.mm_per_px,
        mm_per_px_sigma=settings.mm_per_px_sigma,
        sensor_name=settings.name,
        serial=settings.serial or None,
        gel_id=settings.gel_id or None,
        view=view,
        response=settings.response,
    )


def _settings(folder: Path, sensor: str | None, mm_per_px: float | None) -> SensorSettings:
    """sensor.toml, else the profile; a scale that is given goes before both."""
    settings: SensorSettings | None = None
    if (folder / "sensor.toml").is_file():
        settings = read_sensor_toml(folder / "sensor.toml")
    elif sensor is not None:
        profile = profile_named(sensor)
        settings = SensorSettings(profile.name, profile.mm_per_px, profile.mm_per_px_sigma)
    if mm_per_px is not None:
        pitch = check_positive(mm_per_px, "mm_per_px")
        if settings is None:
            return SensorSettings(folder.resolve().name, pitch)
        return replace(settings, mm_per_px=pitch, mm_per_px_sigma=None)
    if settings is None:
        raise DataError(
            f"No scale for {folder}: presses of a ball alone do not tell it. Write name and mm_per_px into "
            f"{folder / 'sensor.toml'}, give mm_per_px= (--mm-per-px) or sensor= (--sensor), or measure it: two marked "
            "points (--scale-points), a flat punch (--punch), a thread (--thread), a stage's step (--stage) or a grid "
            "(--lens-images)."
        )
    return settings


def _view(
    settings: SensorSettings,
    sensor: str | None,
    crop: tuple[float, float, float, float] | None,
    frame_shape: tuple[int, int],
) -> View:
    """What is asked for, else sensor.toml's view, else the profile's where the images are frames of it."""
    if crop is not None:
        return View(frame_shape=frame_shape, crop=crop)
    if not settings.view.is_identity or sensor is None:
        return settings.view
    return profile_named(sensor).view(frame_shape)


def _background_of(folder: Path) -> Path:
    found = sorted(
        p
        for p in folder.iterdir()
        if p.stem == "background" and (p.suffix.lower() in IMAGE_SUFFIXES or p.is_dir())
    )
    if not found:
        raise DataError(
            f"No background in {folder}: expected background.png, an image of the untouched gel. "
            "Take one, or name it with background= (--background)."
        )
    return found[0]


def _rows(folder: Path, ball_diameter_mm: float | None, background: Path) -> list[_Row]:
    if (folder / "presses.csv").is_file():
        rows = list(_press_table(folder))
    elif (folder / "catalog.csv").is_file():
        rows = list(_gs_sdk_table(folder))
    else:
        rows = list(_plain_images(folder, ball_diameter_mm, background))
    if not rows:
        raise DataError(f"No press in {folder}: expected images and a presses.csv with a row for each.")
    return rows


def _press_table(folder: Path) -> Iterator[_Row]:
    for line, row in _table(folder / "presses.csv", ("image", "ball_diameter_mm")):
        if row.get("indenter", "ball") not in ("", "ball"):
            continue  # other indenters are for evaluation by other means
        label = tuple(_number(row[c], c, line) for c in LABEL_COLUMNS) if _labelled(row) else None
        yield _Row(row["image"], _diameter(row["ball_diameter_mm"], line), label)  # type: ignore[arg-type]


def _gs_sdk_table(folder: Path) -> Iterator[_Row]:
    for line, row in _table(folder / "catalog.csv", ("experiment_reldir", "diameter(mm)")):
        directory = folder / row["experiment_reldir"]
        label = _gs_sdk_label(directory / "label.npz") if (directory / "label.npz").is_file() else None
        yield _Row(f"{row['experiment_reldir']}/gelsight.png", _diameter(row["diameter(mm)"], line), label)


def _gs_sdk_label(path: Path) -> tuple[float, float, float]:
    try:
        with np.load(path, allow_pickle=False) as label:
            x, y = (float(v) for v in np.ravel(label["center"]))
            return x, y, float(label["radius"])
    except (KeyError, ValueError, OSError) as problem:
        raise DataError(f"Expected center and radius in {path}, got: {problem}.") from problem


def _plain_images(folder: Path, ball_diameter_mm: float | None, background: Path) -> Iterator[_Row]:
    images = [p for p in sorted(folder.iterdir()) if p.suffix.lower() in IMAGE_SUFFIXES]
    images = [p for p in images if p.stem != "background" and p.resolve() != background.resolve()]
    if images and ball_diameter_mm is None:
        raise DataError(
            f"{folder} has images but no presses.csv: which ball pressed? Give ball_diameter_mm= "
            "(--ball-diameter-mm), or write presses.csv with the columns image,ball_diameter_mm."
        )
    for path in images:
        yield _Row(path.name, check_positive(ball_diameter_mm or 0, "ball_diameter_mm"), None)


def _table(path: Path, columns: tuple[str, ...]) -> Iterator[tuple[str, dict[str, str]]]:
    """Rows of a CSV with where they stand, after its columns were checked."""
    with path.open(newline="", encoding="utf-8-sig") as file:
        reader = csv.DictReader(file)
        missing = [c for c in columns if c not in (reader.fieldnames or [])]
        if missing:
            raise DataError(
                f"Expected the columns {', '.join(columns)} in {path}, got {', '.join(reader.fieldnames or []) or 'none'}: "
                f"{', '.join(missing)} missing."
            )
        for row in reader:
            if any((value or "").strip() for value in row.values() if isinstance(value, str)):
                yield (
                    f"{path}, line {reader.line_num}",
                    {k: (v or "").strip() for k, v in row.items() if isinstance(k, str)},
                )


def _labelled(row: dict[str, str]) -> bool:
    return all(row.get(column) for column in LABEL_COLUMNS)


def _diameter(text: str, where: str) -> float:
    value = _number(text, "ball diameter", where)
    if not 0 < value < 1000:
        raise DataError(f"Expected a ball diameter in mm > 0 (and under 1000), got {text} ({where}).")
    return value


def _number(text: str, name: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise DataError(f"Expected {name} as a number, got {text!r} ({where}).") from None
    if not np.isfinite(value):
        raise DataError(f"Expected {name} as a finite number, got {text!r} ({where}).")
    return value


def _press(folder: Path, row: _Row, view: View, frame_shape: tuple[int, int]) -> Press:
    frame = read_image(folder / row.name)
    if frame.shape[:2] != frame_shape:
        raise DataError(
            f"Expected all images of one size: {row.name} is {frame.shape[0]}x{frame.shape[1]} px, the background "
            f"{frame_shape[0]}x{frame_shape[1]}. Take both with the same camera settings."
        )
    image = np.ascontiguousarray(image_from_frame(frame, view))
    digest = hashlib.sha256(repr(image.shape).encode() + image.tobytes()).hexdigest()
    return Press(row.name, image, row.ball_diameter_mm, row.label, digest)
