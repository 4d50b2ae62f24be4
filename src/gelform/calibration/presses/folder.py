"""Read presses of a ball from a press folder, other packages' folders, plain images, a video or a recording."""

from __future__ import annotations

import json
import re
import zipfile
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.geometry.scale import Scale
from gelform.calibration.presses.press_set import (
    NAMED,
    UNREAD,
    FlatPress,
    Press,
    Presses,
    check_ball_diameter,
    file_of,
    number,
    presses_from_settings,
    table_rows,
)
from gelform.calibration.presses.video import presses_in_film
from gelform.errors import DataError, Progress, no_progress, said
from gelform.foundations.checks import (
    check_is,
    check_path,
    check_positive,
    check_sensor_pitch,
    check_sensor_pitches,
)
from gelform.foundations.files import (
    DAMAGED_ARCHIVE,
    MAX_ARRAY_BYTES,
    MAX_TEXT_BYTES,
    bytes_of,
    checked_archive,
    way_for,
)
from gelform.image.view import Frame, View, image_from_frame, image_px_from_frame_px, rgb_from_bgr
from gelform.sensors.containers import is_data_set
from gelform.sensors.files import (
    FILM_SUFFIXES,
    SensorSettings,
    background_in,
    images_of_stack,
    is_likely_background,
    is_stack,
    read_background,
    read_image,
    read_sensor_toml,
)
from gelform.sensors.films import open_film
from gelform.sensors.mcap import refuse_bag
from gelform.sensors.pictures import IMAGE_SUFFIXES
from gelform.sensors.profiles import PROFILES, profile_named

__all__ = ["Press", "Presses", "as_presses", "kind_of_presses", "read_presses"]

PRESS_FOLDER, TAXIM, PLAIN, VIDEO = "press folder", "Taxim dataPack", "folder of images", "video"
LABEL_COLUMNS = ("center_x_px", "center_y_px", "contact_radius_px")
DIAMETER = re.compile(r"(?<![\d.,])(\d+(?:[.,]\d+)?)[ _-]?mm(?![a-z])", re.IGNORECASE)  # in a folder's name


@dataclass(frozen=True)
class ReadOptions:
    """Options of `read_presses`; each overrides what lies beside the data."""

    sensor: str | None = None  # name of a profile
    mm_per_px: float | tuple[float, float] | None = None  # or (x, y)
    ball_diameter_mm: float | None = None
    background: Path | None = None  # path of the background image
    crop: tuple[float, float, float, float] | None = None  # (left, top, width, height) in pixels of the frame
    bgr: bool = False  # whether all images, the background too, are blue, green, red

    def __post_init__(self) -> None:
        for name, check in (("mm_per_px", check_sensor_pitches), ("ball_diameter_mm", check_ball_diameter)):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, check(getattr(self, name)))

    def settings(self, place: Path, known: SensorSettings | None = None) -> SensorSettings:
        """sensor.toml next to the data, else the data's own settings, else the profile.

        A given scale and the name of a profile override them.
        """
        profile = None if self.sensor is None else profile_named(self.sensor)
        toml = place / "sensor.toml" if place.is_dir() else place.parent / "sensor.toml"
        settings = read_sensor_toml(toml) if toml.is_file() else known
        if settings is None and profile is not None:
            scale, thickness_mm = (profile.mm_per_px, profile.mm_per_px_sigma), profile.gel_thickness_mm
            settings = SensorSettings(profile.name, *scale, gel_thickness_mm=thickness_mm)
        if settings is None and self.mm_per_px is not None:
            settings = SensorSettings(place.resolve().stem, self.mm_per_px)
        if settings is None:
            raise DataError(
                f"No scale for {place}: presses of a ball alone do not tell it. Write name and mm_per_px into "
                f"{toml}, give mm_per_px= (--mm-per-px) or sensor= (--sensor), or measure it on two marked points "
                "or a stage's step (gelform scale), or on a grid (gelform lens)."
            )
        if self.sensor is not None:
            settings = replace(settings, make=self.sensor)
        if self.mm_per_px is not None:
            others = {name: value for name, value in settings.measured.items() if name != "scale"}
            settings = replace(settings, mm_per_px=self.mm_per_px, mm_per_px_sigma=None, measured=others)
        return settings

    def view(self, settings: SensorSettings, frame_shape: tuple[int, int]) -> View:
        """The requested crop, else sensor.toml's view, else the profile's if the images are frames of it; square pixels.

        They are frames of the profile if the user names it, or if their scale is that of its images.
        """
        view, make = settings.view, self.sensor or settings.make
        if self.crop is not None:
            try:
                view = View(frame_shape=frame_shape, crop=self.crop)
            except ValueError as problem:  # the frame shows it, not the option alone
                raise DataError(f"{problem} It is crop= (--crop).") from problem
        elif view.is_identity and (
            self.sensor is not None or (make and PROFILES[make].is_cropped_scale(settings.square_mm_per_px))
        ):
            view = profile_named(make).view(frame_shape)
        return settings.squared(view, frame_shape)

    def ball(self, what: str) -> float:
        """The ball's diameter, for data without it."""
        if self.ball_diameter_mm is None:
            raise DataError(
                f"{what}: which ball pressed? Give ball_diameter_mm= (--ball-diameter-mm), or write presses.csv "
                "with the columns image,ball_diameter_mm."
            )
        return self.ball_diameter_mm

    def in_rgb(self, image: NDArray[Any]) -> NDArray[Any]:
        """An image as it was read, in RGB."""
        return rgb_from_bgr(image) if self.bgr else image


@dataclass(frozen=True)
class PressSource:
    """Presses as a reader finds them; frames are (H, W, 3) uint8 as they are stored."""

    listed: Sequence[Press | FlatPress]  # before their images are read
    background: Path | NDArray[Any] | None = None  # of the gel at rest; None: the one in the folder
    # The frame of a number in the list; None: it is in the file of its name.
    frame: Callable[[int], NDArray[Any]] | None = None
    known: SensorSettings | None = None  # settings of the sensor in the data, if any
    notes: tuple[str, ...] = ()  # for the user, about the list


def read_presses(
    path: str | PathLike[str],
    *,
    sensor: str | None = None,
    mm_per_px: float | tuple[float, float] | None = None,
    ball_diameter_mm: float | None = None,
    background: str | PathLike[str] | None = None,
    crop: tuple[float, float, float, float] | None = None,
    bgr: bool = False,
    dataset: str = "",
    progress: Progress = no_progress,
) -> Presses:
    """Read ball presses.

    Parameters
    ----------
    path : a press folder (`presses.csv` with the columns image, ball_diameter_mm), gs_sdk's (`catalog.csv`) or
        py3DCal's folder, Taxim's `dataPack.npz`, or a folder of plain images, a TIFF of several pages, frames of numpy
        (`.npy`), a video, a recording (`*.mcap`) or a data set (HDF5, Zarr, LeRobot) with `ball_diameter_mm`
    sensor : name of a profile, which has the view and mm_per_px
    mm_per_px : pixel pitch, mm, or (x, y) of pixels that are not square; overrides sensor.toml and the profile
    ball_diameter_mm : for data without it; a table that states another is refused
    background : the background image, or a folder of several; the press folder's `background.png` or `background/`
        by default
    crop : (left, top, width, height) in pixels of the frame
    bgr : whether all images, the background too, are blue, green, red, as OpenCV writes an array
    dataset : where the frames are in a data set, as in `open_source`
    progress : called with (done, total, what)

    Raises
    ------
    DataError
        The data, a table, a column or an image is missing or unreadable, sizes differ, no scale is known,
        a ball diameter is not a number > 0, or a video shows no gel at rest or no press (see
        `presses_from_frames`). The message says what was expected and what to do.
    """
    place = check_path(path)
    rest = None if background is None else check_path(background, "background as a path")
    options = ReadOptions(sensor, mm_per_px, ball_diameter_mm, rest, crop, bgr)
    kind = kind_of_presses(place)
    if kind == VIDEO or dataset:  # of another kind of path, it is refused there
        at_rest = None if rest is None else read_background(rest, bgr=bgr)
        return _presses_of_film(open_film(place, bgr=bgr, dataset=dataset), place, options, at_rest, progress)
    if kind is None:
        is_picture = place.suffix.lower() in IMAGE_SUFFIXES
        is_part = is_picture or place.suffix.lower() in (".csv", ".toml")
        is_file = (
            f"one {'picture' if is_picture else 'table'}: give the folder of all"
            if is_part
            else "a file of another kind"
        )
        is_what = is_file if place.exists() else "not there"
        raise DataError(
            f"Expected a folder of presses, a video, a recording (*.mcap), a data set or a Taxim dataPack.npz, got {place}, "
            f"which is {is_what}.{way_for(place) if place.exists() else ''}"
        )
    refuse_bag(place)
    pictures = kind == PLAIN and any(one.suffix.lower() in IMAGE_SUFFIXES for one in place.iterdir())
    if kind == PLAIN and not pictures and (tables := sorted(place.glob("*/presses.csv"))):
        names = ", ".join(str(one.parent) for one in tables[:NAMED])
        raise DataError(
            f"Expected a press folder, got {place}, which holds others: give one of them ({names})."
        )
    _, source = LAYOUTS[kind]
    return _presses_of_images(source(place, options), place, options, progress)


def presses_from_frames(
    frames: Iterable[Frame],
    *,
    ball_diameter_mm: float,
    mm_per_px: float | tuple[float, float] | None = None,
    sensor: str | None = None,
    background: NDArray[Any] | None = None,
    crop: tuple[float, float, float, float] | None = None,
    name: str = "frames",
    progress: Progress = no_progress,
) -> Presses:
    """Find the presses of a ball in a sequence of frames.

    The gel at rest is the state that returns between the presses. The background is the trimmed mean of its frames, and
    their scatter is the noise. One frame of each contact that stands still becomes a press. Frames in which a contact
    slides, rolls or is pressed down are left out; `notes` of the result list them with the reasons.

    Parameters
    ----------
    frames : in the order of time, with some of the gel at rest; RGB
        They are read twice if possible (`gelform.Video`, a list). The images of an iterator, such as a camera, are kept
        in memory, up to 1 GiB.
    ball_diameter_mm : diameter of the ball
    mm_per_px, sensor : the scale, or the profile that has it
    background : (H, W, 3) background frame, 0-255, for a sequence without one
    crop : (left, top, width, height) in pixels of the frame
    name : prefix of the presses' names
    progress : called with (done, total, what)

    Raises
    ------
    DataError
        No frame, no scale, no stretch at rest, no contact, none that stands still, or an iterator of more
        than 1 GiB.
    """
    check_is(frames, Iterable, "frames")  # type: ignore[type-abstract]
    place = check_path(check_is(name, str, "name"), "name")
    options = ReadOptions(sensor, mm_per_px, ball_diameter_mm, None, crop)
    return _presses_of_film(frames, place, options, background, progress)


def _presses_of_film(
    frames: Iterable[Frame],
    place: Path,
    options: ReadOptions,
    background: NDArray[Any] | None,
    progress: Progress,
) -> Presses:
    """The presses in frames; a `sensor.toml` next to their place can hold settings."""
    settings, ball = options.settings(place), options.ball(str(place))
    found = presses_in_film(frames, partial(options.view, settings), background, str(place), progress)
    presses = [Press(f"{place.stem}, frame {number}", image, ball) for number, image in found.stills.items()]
    more = {"background_noise": found.noise, "notes": found.notes}
    return presses_from_settings(settings, str(place), presses, found.background, found.view, **more)


def _presses_of_images(source: PressSource, place: Path, options: ReadOptions, progress: Progress) -> Presses:
    """Read every image of a source, through one view."""
    rest = options.background or source.background
    if rest is None:
        rest = background_in(place if place.is_dir() else place.parent)
    rest = options.in_rgb(read_background(rest) if isinstance(rest, Path) else rest)
    settings = options.settings(place, source.known)
    flat_count = sum(isinstance(one, FlatPress) for one in source.listed)
    if flat_count == len(source.listed):
        others = f" beside {flat_count} of flat punches" if flat_count else ""
        why = "".join(f" {note}" for note in source.notes)
        raise DataError(
            f"No press of a ball in {place}{others}: expected images and a presses.csv with a row for each.{why}"
        )
    frame_shape = (rest.shape[0], rest.shape[1])
    view = options.view(settings, frame_shape)
    if view.frame_shape not in (None, frame_shape):
        raise DataError(
            f"The view of {place} is of frames of {_px(view.frame_shape)}, and its background is {_px(frame_shape)}. "
            "Correct the view in sensor.toml, or leave it out where the images need none."
        )
    background = image_from_frame(rest, view).astype(np.float32)
    presses: list[Press] = []
    flats: list[FlatPress] = []
    sizes = {}
    for k, one in enumerate(source.listed):
        frame = options.in_rgb(read_image(place / one.name) if source.frame is None else source.frame(k))
        sizes[one.name] = (frame.shape[0], frame.shape[1])
        if sizes[one.name] == frame_shape:
            image = np.ascontiguousarray(image_from_frame(frame, view))
            if isinstance(one, Press):
                presses.append(replace(one, image=image))
            else:
                flats.append(replace(one, image=image))
        progress(k + 1, len(source.listed), "reading presses")
    _check_one_size(sizes, frame_shape)
    more: dict[str, Any] = {"notes": source.notes, "flats": tuple(flats)}
    return presses_from_settings(settings, str(place), presses, background, view, **more)


def _check_one_size(sizes: Mapping[str, tuple[int, int]], background: tuple[int, int]) -> None:
    """Refuse images of another size than the background's, and name the ones that differ."""
    odd = {name: size for name, size in sizes.items() if size != background}
    if not odd:
        return
    (usual, count), *_ = Counter(sizes.values()).most_common(1)
    if usual != background and count > len(sizes) / 2:
        raise DataError(
            f"Expected all images of one size: the background is {_px(background)}, {count} of {len(sizes)} presses "
            f"are {_px(usual)}. Take the background anew with the camera settings of the presses."
        )
    named = ", ".join(f"{name} is {_px(size)}" for name, size in list(odd.items())[:NAMED])
    more = f", and {len(odd) - NAMED} more" if len(odd) > NAMED else ""
    raise DataError(
        f"Expected all images of one size: {named}{more}; the background and {len(sizes) - len(odd)} presses are "
        f"{_px(background)}. Leave the odd ones out, or take all with the same camera settings."
    )


def _px(size: tuple[int, int]) -> str:
    return f"{size[0]}x{size[1]} px"


def as_presses(presses: Presses | str | PathLike[str], *, progress: Progress = no_progress) -> Presses:
    """Return a press set unchanged, or read it from a path, for functions that take presses; TypeError: neither."""
    if isinstance(presses, Presses):
        return presses
    if isinstance(presses, (str, PathLike)):
        return read_presses(presses, progress=progress)
    raise TypeError(
        f"Expected presses, from gelform.read_presses(path), or the path of a press folder, got {type(presses).__name__}."
    )


def with_scale(presses: Presses | str | PathLike[str], scale: Scale) -> Presses:
    """The presses, or those at a path, with a measured scale."""
    check_is(scale, Scale, "scale")
    presses = as_presses(presses)
    geometry = replace(presses.geometry, scale_source=scale.source)
    return replace(presses, mm_per_px=scale.mm_per_px, mm_per_px_sigma=scale.sigma, geometry=geometry)


def with_view(presses: Presses, view: View, source: str) -> Presses:
    """Presses that were read without a view, through one that removes the lens; labels move with their pixels.

    `view` is of their frames, measured on the target `source`.
    """

    def seen(frame: NDArray[Any]) -> NDArray[Any]:
        return np.ascontiguousarray(image_from_frame(frame, view))

    def through(press: Press) -> Press:
        label = None
        if press.label is not None:
            x, y, radius = press.label
            ring = np.array([(x, y), (x + radius, y), (x - radius, y), (x, y + radius), (x, y - radius)])
            center, *rim = image_px_from_frame_px(ring, view)
            distances = [float(np.hypot(*(point - center))) for point in rim]
            label = (float(center[0]), float(center[1]), float(np.mean(distances)))
        return replace(press, image=seen(press.image), label=label)

    return replace(
        presses,
        presses=tuple(map(through, presses.presses)),
        flats=tuple(replace(flat, image=seen(flat.image)) for flat in presses.flats),
        background=image_from_frame(presses.background, view).astype(np.float32),
        view=view,
        geometry=replace(presses.geometry, lens=source),
    )


def press_folder_source(folder: Path, options: ReadOptions) -> PressSource:
    """A press folder: `presses.csv` (image, ball_diameter_mm, optional labels, flat punches), `background.png`, images."""
    listed: list[Press | FlatPress] = []
    left_out: Counter[str] = Counter()
    for where, row in table_rows(folder / "presses.csv", ("image", "ball_diameter_mm")):
        name, indenter = file_of(folder, row["image"]), row.get("indenter", "")
        if indenter in ("", "ball"):
            label = None
            if all(row.get(column) for column in LABEL_COLUMNS):
                x, y, radius = (number(row[column], column, where) for column in LABEL_COLUMNS)
                label = (x, y, radius)
            listed.append(Press(name, UNREAD, diameter(row["ball_diameter_mm"], where, options), label))
        elif indenter == "flat" and row.get("height_mm"):
            height_mm = number(row["height_mm"], "height_mm", where)
            if not 0.01 <= height_mm <= 20:
                raise DataError(
                    f"Expected height_mm of 0.01 to 20 mm, got {height_mm:g}. Is it in mm? ({where})"
                )
            listed.append(FlatPress(name, UNREAD, height_mm))
        else:  # not measured, or for evaluation by other means
            left_out["flat without height_mm" if indenter == "flat" else indenter] += 1
    notes = tuple(
        f"gelform left out rows of presses.csv with the indenter {name}: {count} (it knows ball, and flat with "
        "height_mm)."
        for name, count in left_out.items()
    )
    return PressSource(listed, notes=notes)


def diameter(text: str, where: str, options: ReadOptions) -> float:
    """A ball's diameter in mm, from a table; an option that contradicts it is refused."""
    try:
        ball_mm = check_ball_diameter(number(text, "ball diameter", where))
    except ValueError as problem:
        raise DataError(f"{problem} ({where})") from None
    if options.ball_diameter_mm not in (None, ball_mm):
        raise DataError(
            f"ball_diameter_mm= (--ball-diameter-mm) is {options.ball_diameter_mm:g}, but {where}, states {ball_mm:g}. "
            "Leave the option out, or correct the table."
        )
    return ball_mm


def gs_sdk_source(folder: Path, options: ReadOptions) -> PressSource:
    """gs_sdk's folder: `catalog.csv` (experiment_reldir, diameter(mm)), `<dir>/gelsight.png`, `background.png`."""
    listed = []
    for where, row in table_rows(folder / "catalog.csv", ("experiment_reldir", "diameter(mm)")):
        name, label = file_of(folder, row["experiment_reldir"]), None
        path = folder / name / "label.npz"
        if path.is_file():
            arrays = arrays_of(path, "the label of a press", ("center", "radius"))
            circle = np.concatenate([np.ravel(one) for one in arrays.values()]).astype(float).tolist()
            if arrays["center"].size != 2 or len(circle) != 3 or not np.isfinite(circle).all():
                raise DataError(
                    f"Expected center (x, y) and radius as numbers in {path}. Label the press again."
                )
            label = (circle[0], circle[1], circle[2])
        ball_mm = diameter(row["diameter(mm)"], where, options)
        listed.append(Press(f"{name}/gelsight.png", UNREAD, ball_mm, label))
    return PressSource(listed)


def arrays_of(
    path: Path,
    what: str,
    names: Sequence[str],
    optional: Sequence[str] = (),
    max_bytes: int = MAX_ARRAY_BYTES,
) -> dict[str, NDArray[Any]]:
    """Arrays of numbers by name in another program's .npz, and optional ones of anything.

    Nothing is unpickled: a member of Python objects is refused. DataError: one is missing, or the file is damaged.
    """
    try:
        checked_archive(path, what, max_bytes)
        with path.open("rb") as handle, np.load(handle, allow_pickle=False) as data:
            missing = [name for name in names if name not in data.files]
            if missing:
                raise DataError(
                    f"Expected the arrays {', '.join(names)} in {path}, {', '.join(missing)} missing."
                )
            arrays = {name: data[name] for name in (*names, *optional) if name in data.files}
    except (OSError, *DAMAGED_ARCHIVE) as problem:
        raise DataError(f"{path} is truncated or damaged: {said(problem)}. Copy it again.") from problem
    except ValueError as problem:
        raise DataError(
            f"{path} holds Python objects, which could run code when read: refused. Save it again with plain "
            f"arrays (numpy.asarray(imgs, dtype=numpy.uint8) ...). ({problem})"
        ) from problem
    for name in names:  # numpy gives the bytes of a member that is no array
        if not isinstance(arrays[name], np.ndarray) or arrays[name].dtype.kind not in "uif":
            raise DataError(
                f"Expected {name} as an array of numbers in {path}. Save it again with numpy.savez."
            )
    return arrays


def is_py3dcal(folder: Path) -> bool:
    """Whether a folder is py3DCal's, annotated or not."""
    of_stage = (folder / "annotations").is_dir() or (folder / "probe_data.csv").is_file()
    return (folder / "probe_images").is_dir() and of_stage


def py3dcal_source(folder: Path, options: ReadOptions) -> PressSource:
    """py3DCal's folder: a printer pressed one probe at the positions of a stage.

    `annotations/annotations.csv` (img_name, x_px, y_px), `annotations/metadata.json` (px_per_mm,
    probe_radius_mm), `blank_images/blank.png`, `probe_images/`.
    """
    table = folder / "annotations" / "annotations.csv"
    if not table.is_file():
        positions = any(
            file.is_file() for file in (table.with_name("probe_data.csv"), folder / "probe_data.csv")
        )
        there = " probe_data.csv has the positions of the stage only." if positions else ""
        raise DataError(
            f"{folder} is a py3DCal folder before its annotation: annotations/annotations.csv, the centers of the "
            f"presses in pixels, is missing.{there} Run py3DCal's annotate on the folder first; it writes metadata.json "
            "too."
        )
    rest = options.background or _blank_in(folder / "blank_images")
    places = [table.with_name("metadata.json"), folder / "metadata.json"]  # the package stores it in either
    path = next((place for place in places if place.is_file()), places[0])
    try:
        facts = json.loads(bytes_of(path, "metadata of py3DCal", MAX_TEXT_BYTES))
        names = ("px_per_mm", "probe_radius_mm")
        px_per_mm, radius_mm = (check_positive(float(facts[name]), name) for name in names)
        known = SensorSettings(folder.resolve().name, check_sensor_pitch(1 / px_per_mm))
        ball = options.ball_diameter_mm or check_ball_diameter(2 * radius_mm)
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as problem:
        raise DataError(
            f"Expected px_per_mm and probe_radius_mm > 0 in {path}, got: {said(problem)}."
        ) from problem
    listed = []
    for where, row in table_rows(table, ("img_name", "x_px", "y_px")):
        center = (number(row["x_px"], "x_px", where), number(row["y_px"], "y_px", where))
        listed.append(Press(f"probe_images/{row['img_name']}", UNREAD, ball, None, center))
    return PressSource(listed, rest, known=known)


def _blank_in(folder: Path) -> Path:
    if (folder / "blank.png").is_file():
        return folder / "blank.png"
    images = sorted(p for p in folder.glob("*") if p.suffix.lower() in IMAGE_SUFFIXES)
    if not images:
        raise DataError(
            f"No background in {folder}: expected blank.png, an image of the gel at rest. "
            "Take one, or name it with background= (--background)."
        )
    return images[0]


def taxim_pack_in(path: Path) -> Path | None:
    """The `dataPack.npz` at or in a path, under this name or another; or None."""
    pack = path / "dataPack.npz" if path.is_dir() else path
    if not pack.is_file() or pack.suffix != ".npz":
        return None
    if pack.name == "dataPack.npz":
        return pack
    try:
        with zipfile.ZipFile(pack) as archive:
            return pack if {"f0.npy", "imgs.npy"} <= set(archive.namelist()) else None
    except (OSError, *DAMAGED_ARCHIVE):
        return None


def taxim_source(path: Path, options: ReadOptions) -> PressSource:
    """Taxim's `dataPack.npz`: f0, imgs (BGR, as OpenCV read them), touch_center (x, y), touch_radius, names."""
    pack = taxim_pack_in(path)
    assert pack is not None
    needed = ("f0", "imgs", "touch_center", "touch_radius")
    arrays = arrays_of(pack, "a dataPack", needed, ("names",), 4 << 30)
    images, centers = arrays["imgs"], arrays["touch_center"]
    radii = arrays["touch_radius"].astype(float)
    for name in ("f0", "imgs"):
        if arrays[name].dtype != np.uint8:
            raise DataError(
                f"Expected {name} as uint8 in {pack}, got {arrays[name].dtype}. Scale it to 0-255 and convert it: "
                "other values would wrap around."
            )
    if images.ndim != 4 or centers.shape != (len(images), 2) or radii.shape != (len(images),):
        raise DataError(
            f"Expected imgs (N, H, W, 3), touch_center (N, 2) and touch_radius (N,) in {pack}, got "
            f"{images.shape}, {centers.shape} and {radii.shape}."
        )
    ball = options.ball(str(pack))
    names = [str(name) for name in arrays.get("names", np.arange(len(images)))]
    circles = zip(names, centers, radii)
    listed = [Press(name, UNREAD, ball, (float(x), float(y), float(r))) for name, (x, y), r in circles]
    return PressSource(listed, rgb_from_bgr(arrays["f0"]), lambda k: rgb_from_bgr(images[k]))


def plain_source(folder: Path, options: ReadOptions) -> PressSource:
    """A folder of images of one ball, one press each, and `background.png`."""
    if rows := rows_by_folder(folder):
        raise DataError(
            f"{folder} has folders whose names are diameters, and no presses.csv. Write the lines that they suggest: "
            f"{'; '.join(rows[:6])} ... (gelform info {folder} prints all {len(rows)}), if they are right."
        )
    rest_path = options.background or background_in(folder)
    images = [p for p in sorted(folder.iterdir()) if p.suffix.lower() in IMAGE_SUFFIXES]
    images = [p for p in images if p.stem != "background" and p.resolve() != rest_path.resolve()]
    ball = options.ball(f"{folder} has images but no presses.csv") if images else 0.0
    return PressSource([Press(path.name, UNREAD, ball) for path in images], rest_path)


def rows_by_folder(folder: Path) -> list[str]:
    """The lines of a presses.csv that folders such as `5mm/` suggest, its header first; [] without such folders."""
    rows = []
    for below in sorted(folder.iterdir()):
        words = DIAMETER.search(below.name)
        images = sorted(below.iterdir()) if words and below.is_dir() else []
        named = [p for p in images if p.suffix.lower() in IMAGE_SUFFIXES and not is_likely_background(p)]
        rows += [f"{below.name}/{p.name},{words[1].replace(',', '.')}" for p in named if words]
    return rows and ["image,ball_diameter_mm", *rows]


def stack_source(file: Path, options: ReadOptions) -> PressSource:
    """A TIFF of several pages, or an array of frames (`.npy`), of one ball, one press each."""
    image, count = images_of_stack(file)
    ball = options.ball(f"{file} has images but no presses.csv")
    return PressSource([Press(f"image {k}", UNREAD, ball) for k in range(count)], frame=image)


# How to tell each layout, and how to read it; of several that fit, the first.
LAYOUTS: Mapping[str, tuple[Callable[[Path], bool], Callable[[Path, ReadOptions], PressSource]]] = {
    "file of several images": (is_stack, stack_source),
    PRESS_FOLDER: (lambda place: (place / "presses.csv").is_file(), press_folder_source),
    "gs_sdk folder": (lambda place: (place / "catalog.csv").is_file(), gs_sdk_source),
    "py3DCal folder": (is_py3dcal, py3dcal_source),
    TAXIM: (lambda place: taxim_pack_in(place) is not None, taxim_source),
    PLAIN: (Path.is_dir, plain_source),
}


def kind_of_presses(place: Path) -> str | None:
    """The layout of presses at a path: VIDEO, a name in `LAYOUTS`, or None."""
    if (place.is_file() and place.suffix.lower() in FILM_SUFFIXES) or (place.exists() and is_data_set(place)):
        return VIDEO
    return next((name for name, (is_it, _) in LAYOUTS.items() if is_it(place)), None)
