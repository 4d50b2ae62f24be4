"""Images, backgrounds and sensor settings from files. Files' BGR is converted to RGB here, and only here."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from io import BytesIO
from itertools import chain
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from gelform.arrays import MIB, Array, Image
from gelform.errors import DataError, GelformError, said
from gelform.foundations.checks import (
    check_gel_thickness,
    check_path,
    check_positive,
    check_response,
    check_sensor_pitches,
)
from gelform.foundations.files import MAX_TEXT_BYTES, bytes_of, way_for
from gelform.image.background import background_from_frames
from gelform.image.view import MAX_PIXELS, View, rgb_from_bgr
from gelform.sensors.pictures import (
    IMAGE_SUFFIXES,
    begin_tiff_at,
    image_from_bytes,
    image_of_npy,
    is_npy,
    npy_values,
    tiff_pages,
)
from gelform.sensors.profiles import PROFILES

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


def read_toml(path: Path, what: str, error: type[GelformError] = DataError) -> dict[str, Any]:
    """The settings in a TOML file; `what` describes it in errors.

    error: the file is missing, too large, no text in UTF-8, no TOML, or nested beyond reason.
    """
    try:
        return tomllib.loads(bytes_of(path, what, MAX_TEXT_BYTES, error).decode("utf-8"))
    except UnicodeDecodeError as problem:
        raise error(
            f"{path} is no text in UTF-8: byte {problem.start} is none. Save it as UTF-8."
        ) from problem
    except ValueError as problem:  # of a number with thousands of digits too
        how = 'Text stands in quotes and numbers have a decimal point: name = "my sensor", mm_per_px = 0.06.'
        raise error(f"{path} is no TOML file: {said(problem)}. {how}") from problem
    except RecursionError:
        raise error(f"{path} holds tables inside tables beyond reason: expected {what}.") from None


VIDEO_SUFFIXES = (".avi", ".mp4", ".mov", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg", ".wmv")
FILM_SUFFIXES = (*VIDEO_SUFFIXES, ".mcap")


def is_video(path: str | Path) -> bool:
    """Whether a path has the ending of a video file."""
    return Path(path).suffix.lower() in VIDEO_SUFFIXES


# Words in names of images of the gel at rest, as people call them.
AT_REST = re.compile(
    "ambient|background|base|baseline|bg|blank|bkg|empty|f0|flat|frame0|init|initial|nocontact|notouch|rest|ref|reference|"
    "undeformed|untouched|zero"
)


@dataclass(frozen=True)
class SensorSettings:
    """The content of a `sensor.toml`: the sensor that made a folder of images.

    Attributes
    ----------
    name : str
    mm_per_px : mm per image pixel, after the view; a pair (x, y) if pixels are not square, which are then resampled to
        square ones
    mm_per_px_sigma : its standard deviation, mm; None if unknown
    response : exponent of the camera's response, I = light^response; 1 if linear or unknown
    serial, gel_id : the unit and the gel; empty if unknown
    make : name of the make's profile; empty if unknown
    gel_thickness_mm : thickness of the gel at rest, the upper limit of depth; None if unknown
    view : maps the camera's frames to images; identity by default
    measured : results of `gelform scale` and `gelform lens`: the origin of scale and lens (texts under `scale` and `lens`),
        `crosstalk` and `crosstalk_spread` (3x3)
    camera : camera settings during the recording (exposure, gain ...): numbers and texts
    """

    name: str
    mm_per_px: float | tuple[float, float]
    mm_per_px_sigma: float | None = None
    response: float = 1.0
    serial: str = ""
    gel_id: str = ""
    make: str = ""
    gel_thickness_mm: float | None = None
    view: View = field(default_factory=View)
    measured: Mapping[str, Any] = field(default_factory=dict)
    camera: Mapping[str, float | str] = field(default_factory=dict)

    @property
    def square_mm_per_px(self) -> float:
        """The pitch of square pixels: the wider side where `mm_per_px` is a pair."""
        return max(self.mm_per_px) if isinstance(self.mm_per_px, tuple) else self.mm_per_px

    def squared(self, view: View, frame_shape: tuple[int, int]) -> View:
        """A view of frames (H, W) to images of this sensor, with square pixels."""
        if not isinstance(self.mm_per_px, tuple):
            return view
        return view.of_frames(frame_shape).squared(self.mm_per_px)


def read_image(path: str | Path, *, most_pixels: float = MAX_PIXELS, bgr: bool = False) -> Image:
    """Read an image file as RGB.

    Parameters
    ----------
    path : a PNG, JPEG, BMP, TIFF, WebP or PPM file of 8-bit color, or an array (H, W, 3) of numpy (`.npy`), RGB
    most_pixels : a file that declares more is refused before its pixels take memory
    bgr : whether its channels are blue, green, red, as OpenCV writes an array

    Returns
    -------
    image : (H, W, 3) uint8, RGB; pixels as stored, ignoring an orientation tag

    Raises
    ------
    DataError
        The file is missing or unreadable, or its bytes are refused by `image_from_bytes`; the message says why and what to
        do.
    """
    path = check_path(path)
    if bgr:
        return rgb_from_bgr(read_image(path, most_pixels=most_pixels))
    if is_stack(path):
        raise DataError(
            f"{path} holds several images. Give it to gelform reconstruct, batch or live, which read all of them."
        )
    if is_npy(path):
        return image_of_npy(npy_values(path, most_pixels), str(path))
    if is_video(path) or path.suffix.lower() == ".mcap":
        raise DataError(f"Expected an image, got a video or a recording: {path}. Its frames: gelform batch.")
    content = _picture_bytes(path, most_pixels)
    return image_from_bytes(content, str(path), most_pixels, hint=way_for(path))


def _picture_bytes(path: Path, most_pixels: float) -> bytes:
    """The bytes of a file with at most 4 of a pixel, with transparency and not compressed, and 64 MB of all else."""
    return bytes_of(path, "an image", 4 * most_pixels + 64 * MIB)


def is_stack(path: Path) -> bool:
    """Whether a file holds several images: a TIFF of several pages, or an array (N, H, W, 3) of numpy."""
    if path.suffix.lower() not in (".tif", ".tiff", ".npy") or not path.is_file():
        return False
    if is_npy(path):
        return npy_values(path).ndim == 4
    try:
        with path.open("rb") as file:
            return len(tiff_pages(file, 2)) > 1
    except OSError:
        return False  # reading it says why


def images_of_stack(path: Path) -> tuple[Callable[[int], Image], int]:
    """(number -> image, for one thread at a time, and number of images) of a file as in `is_stack`.

    Errors as in `read_image`.
    """
    if is_npy(path):
        values = npy_values(path)
        return lambda number: image_of_npy(values[number], f"Image {number} of {path}"), len(values)
    content = _picture_bytes(path, MAX_PIXELS)
    pages = tiff_pages(BytesIO(content))
    begun = bytearray(content)  # changed in place: a copy of a large file takes longer than decoding a page

    def image(number: int) -> Image:
        begin_tiff_at(begun, pages[number])
        return image_from_bytes(begun, str(path), alone=False)

    return image, len(pages)


def _images_at_rest(path: Path) -> Iterator[Array]:
    """The image of a file, or all of them; a `.npy` of the gel at rest may hold an average, in floats."""
    if is_stack(path):
        image, count = images_of_stack(path)
        yield from map(image, range(count))
    elif is_npy(path) and (values := npy_values(path)).dtype.kind == "f":
        levels = np.asarray(values, dtype=np.float32)
        if not (np.isfinite(levels).all() and levels.min() >= 0 and 2 < levels.max() <= 255):
            raise DataError(
                f"Expected gray levels from 0 to 255 in {path}, got {levels.min():.3g} to {levels.max():.3g}."
            )
        yield levels
    else:
        yield read_image(path)


def read_sensor_toml(path: str | Path) -> SensorSettings:
    """Read a `sensor.toml`.

    It has `name` and `mm_per_px`, and may have `make`, `mm_per_px_sigma`, `response`, `serial`, `gel_id`,
    `gel_thickness_mm`, `[view]`, `[measured]`, `[camera]`.

    Raises
    ------
    DataError
        The file is missing or no TOML, lacks a key, has an unknown key, or a value out of range.
    """
    path = check_path(path)
    settings = read_toml(path, "the settings of a sensor")
    try:
        return _sensor_settings(settings)
    except (ValueError, TypeError) as problem:
        raise DataError(f"{path}: {problem}") from problem


def _sensor_settings(settings: dict[str, Any]) -> SensorSettings:
    keys = [field.name for field in fields(SensorSettings)]
    unknown = [key for key in settings if key not in keys]
    if unknown:
        raise ValueError(f"Expected keys among {', '.join(keys)}, got {', '.join(unknown)}.")
    missing = [key for key in keys[:2] if key not in settings]
    if missing:
        raise ValueError(f"Expected the keys name and mm_per_px, {' and '.join(missing)} missing.")
    texts = {key: settings[key] for key in ("name", "serial", "gel_id", "make") if key in settings}
    wrong = [key for key, value in texts.items() if not isinstance(value, str)]
    if wrong:
        raise ValueError(f"Expected {wrong[0]} as text in quotes.")
    if texts.get("make", "") not in ("", *PROFILES):
        raise ValueError(
            f"Expected make as one of {', '.join(PROFILES)}, got {texts['make']!r}. Leave it out for another make; the name "
            "is free."
        )
    for table in ("view", "measured", "camera"):
        if not isinstance(settings.get(table, {}), dict):
            raise ValueError(f"Expected a table [{table}], got {settings[table]!r}.")
    for key, value in settings.get("camera", {}).items():
        if isinstance(value, bool) or not isinstance(value, (int, float, str)) or value != value:
            raise ValueError(f"Expected {key} of [camera] as a number or a text, got {value!r}.")
    sigma, thickness = settings.get("mm_per_px_sigma"), settings.get("gel_thickness_mm")
    return SensorSettings(
        **texts,
        mm_per_px=check_sensor_pitches(settings["mm_per_px"]),
        mm_per_px_sigma=None if sigma is None else check_positive(sigma, "mm_per_px_sigma"),
        gel_thickness_mm=None if thickness is None else check_gel_thickness(thickness),
        response=check_response(settings.get("response", 1.0)),
        view=View.from_dict(settings.get("view", {})),
        measured=_measured(settings.get("measured", {})),
        camera=settings.get("camera", {}),
    )


def _measured(table: dict[str, Any]) -> dict[str, Any]:
    """The table `[measured]`: two texts, two matrices."""
    kinds = {"scale": str, "lens": str, "crosstalk": list, "crosstalk_spread": list}
    unknown = [key for key in table if key not in kinds]
    if unknown:
        raise ValueError(f"Expected keys of [measured] among {', '.join(kinds)}, got {', '.join(unknown)}.")
    for key, value in table.items():
        if not isinstance(value, kinds[key]):
            raise ValueError(f"Expected {key} of [measured] as {kinds[key].__name__}, got {value!r}.")
        try:
            numbers = np.zeros((3, 3)) if kinds[key] is str else np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError):
            numbers = np.empty(0)
        if numbers.shape != (3, 3) or not np.isfinite(numbers).all():
            raise ValueError(f"Expected {key} of [measured] as 3x3 numbers, got {value!r}.")
    return table


def read_background(paths: str | Path | Sequence[str | Path], *, bgr: bool = False) -> Array:
    """The background image (H, W, 3), RGB: uint8 from one file, float32 as the robust average of several.

    Parameters
    ----------
    paths : an image, a folder of images, a file of several images, or several of either; also `.npy`, RGB
    bgr : whether their channels are blue, green, red

    Raises
    ------
    DataError
        A file is missing or unreadable, a folder contains no image, or the frames disagree (see
        `background_from_frames`).
    """
    files = background_files(paths)
    if len(files) == 1 and not is_stack(files[0]):
        (rest,) = _images_at_rest(files[0])
    else:
        names: list[str] = []
        for file in files:
            several = range(images_of_stack(file)[1]) if is_stack(file) else None
            names += [str(file)] if several is None else [f"{file} {number}" for number in several]
        # A stack is opened again where its images are taken, so that the memory holds one file at a time.
        images = chain.from_iterable(map(_images_at_rest, files))
        try:
            rest = background_from_frames(images, names=names).background
        except ValueError as problem:  # an image of another size
            raise DataError(f"Images of the gel at rest in {files[0].parent}: {problem}") from problem
    return rgb_from_bgr(rest) if bgr else rest


def background_in(folder: Path) -> Path:
    """The image background.* in a folder, or a folder of that name with several images."""
    named = (p for p in folder.glob("background*") if p.stem == "background")
    found = sorted(p for p in named if p.suffix.lower() in IMAGE_SUFFIXES or is_npy(p) or p.is_dir())
    if not found:
        raise DataError(
            f"No background in {folder}: expected background.png, an image of the gel at rest. "
            f"{likely_background(folder) or 'Take one, or name it with background= (--background).'}"
        )
    return found[0]


def likely_background(folder: Path) -> str:
    """A sentence that names the images of a folder, or above it, that are the gel at rest by their names; "" without any."""
    places = (folder, folder.resolve().parent)
    found = [p for one in places for p in sorted(one.iterdir()) if is_likely_background(p)]
    if not found:
        return ""
    named = " or ".join(map(str, found[:3]))
    return f"By its name it is {named}. Name it with background= (--background {found[0]})."


def is_likely_background(path: Path) -> bool:
    """Whether a file or a folder is of the gel at rest, by its name."""
    words = re.split(r"[^a-z0-9]+", path.stem.lower())
    is_images = path.suffix.lower() in (*IMAGE_SUFFIXES, ".npy") or path.is_dir()
    return is_images and any(map(AT_REST.fullmatch, (*words, "".join(words))))


def background_files(paths: str | Path | Sequence[str | Path]) -> list[Path]:
    """All images of the given paths; folders are listed in the order of their file names."""
    if not isinstance(paths, (str, PathLike, Sequence)) or isinstance(paths, bytes):
        raise TypeError(f"Expected the path of an image or a folder, or several, got {type(paths).__name__}.")
    given = [paths] if isinstance(paths, (str, PathLike)) else list(paths)
    files: list[Path] = []
    for path in map(check_path, given):
        inside = [path]
        if path.is_dir():
            inside = sorted(p for p in path.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES)
        if not inside:
            raise DataError(f"Expected images of the gel at rest in the folder {path}, got none.")
        files += inside
    return files
