"""Read presses of a ball from a press folder, other packages' folders, plain images, a video or a recording."""

from __future__ import annotations

import json
import re
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.geometry.measured import Crosstalk
from gelform.calibration.geometry.scale import Scale
from gelform.calibration.presses.press_set import (
    FlatPress,
    Listed,
    ListedFlat,
    Press,
    Presses,
    PressSource,
    ReadOptions,
    check_ball_diameter,
    diameter,
    file_of,
    flat_from_frame,
    height,
    number,
    press_from_frame,
    presses_from_settings,
    table_rows,
)
from gelform.calibration.presses.video import presses_from_film
from gelform.errors import DataError, said
from gelform.foundations.checks import check_is, check_path, check_positive, check_sensor_pitch
from gelform.foundations.files import DAMAGED_ARCHIVE, MAX_TEXT_BYTES, bytes_of, checked_archive, way_for
from gelform.foundations.findings import Progress, no_progress
from gelform.image.frame import pixels_digest
from gelform.image.view import View, image_from_frame, image_px_from_frame_px
from gelform.sensors.files import (
    FILM_SUFFIXES,
    IMAGE_SUFFIXES,
    SensorSettings,
    background_in,
    images_of_stack,
    is_likely_background,
    is_stack,
    read_background,
    read_image,
)
from gelform.sensors.recordings.mcap_reader import refuse_bag

MAX_PACK_BYTES = 4 << 30  # bytes of an unpacked dataPack
_DAMAGED = (OSError, *DAMAGED_ARCHIVE)
TAXIM_ARRAYS = ("f0", "imgs", "touch_center", "touch_radius")


def gs_sdk_source(folder: Path, options: ReadOptions) -> PressSource:
    """gs_sdk's folder: `catalog.csv` (experiment_reldir, diameter(mm)), `<dir>/gelsight.png`, `background.png`."""
    rest = read_background(options.background or background_in(folder))
    listed = list(_gs_sdk_rows(folder))
    return PressSource(rest, listed, lambda k: read_image(folder / listed[k].name))


def _gs_sdk_rows(folder: Path) -> Iterator[Listed]:
    for where, row in table_rows(folder / "catalog.csv", ("experiment_reldir", "diameter(mm)")):
        name = file_of(folder, row["experiment_reldir"])
        directory = folder / name
        label = _gs_sdk_label(directory / "label.npz") if (directory / "label.npz").is_file() else None
        yield Listed(f"{name}/gelsight.png", diameter(row["diameter(mm)"], where), label)


def _gs_sdk_label(path: Path) -> tuple[float, float, float]:
    try:
        checked_archive(path, "the label of a press")
        with path.open("rb") as handle, np.load(handle, allow_pickle=False) as label:
            x, y = (float(v) for v in np.ravel(label["center"]))
            circle = x, y, float(label["radius"])
            if not np.isfinite(circle).all():
                raise ValueError(circle)
            return circle
    except _DAMAGED as problem:
        raise DataError(
            f"{path} is truncated or damaged. Copy it again, or label the press again."
        ) from problem
    except (KeyError, TypeError, ValueError) as problem:
        raise DataError(
            f"Expected center (x, y) and radius as numbers in {path}. Label the press again."
        ) from problem


def is_py3dcal(folder: Path) -> bool:
    """Whether a folder with probe images is py3DCal's, annotated or not."""
    return (folder / "annotations").is_dir() or any(map(Path.is_file, _probe_data(folder)))


def _probe_data(folder: Path) -> list[Path]:
    """Places where py3DCal lists the positions of its stage."""
    return [folder / "annotations" / "probe_data.csv", folder / "probe_data.csv"]


def py3dcal_source(folder: Path, options: ReadOptions) -> PressSource:
    """py3DCal's folder: a printer pressed one probe at the positions of a stage.

    `annotations/annotations.csv` (img_name, x_px, y_px), `annotations/metadata.json` (px_per_mm,
    probe_radius_mm), `blank_images/blank.png`, `probe_images/`.
    """
    if not (folder / "annotations" / "annotations.csv").is_file():
        positions = [path.name for path in _probe_data(folder) if path.is_file()]
        there = f" {positions[0]} has the positions of the stage only." if positions else ""
        raise DataError(
            f"{folder} is a py3DCal folder before its annotation: annotations/annotations.csv, the centers of the "
            f"presses in pixels, is missing.{there} Run py3DCal's annotate on the folder first; it writes metadata.json "
            "too."
        )
    rest = read_background(options.background or _blank_in(folder / "blank_images"))
    facts = _py3dcal_facts(folder)
    asked = options.ball_diameter_mm
    ball = check_ball_diameter(2 * facts["probe_radius_mm"] if asked is None else asked)
    rows = []
    for where, row in table_rows(folder / "annotations" / "annotations.csv", ("img_name", "x_px", "y_px")):
        center = (number(row["x_px"], "x_px", where), number(row["y_px"], "y_px", where))
        rows.append(Listed(f"probe_images/{row['img_name']}", ball, center_px=center))
    known = SensorSettings(folder.resolve().name, check_sensor_pitch(1 / facts["px_per_mm"]))
    return PressSource(rest, rows, lambda k: read_image(folder / rows[k].name), known)


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


def _py3dcal_facts(folder: Path) -> dict[str, float]:
    """px_per_mm and probe_radius_mm; the package stores its metadata in either of two places."""
    places = [folder / "annotations" / "metadata.json", folder / "metadata.json"]
    path = next((place for place in places if place.is_file()), places[0])
    try:
        facts = json.loads(bytes_of(path, "metadata of py3DCal", MAX_TEXT_BYTES))
        return {name: check_positive(float(facts[name]), name) for name in ("px_per_mm", "probe_radius_mm")}
    except (KeyError, TypeError, ValueError, OverflowError, RecursionError) as problem:
        raise DataError(
            f"Expected px_per_mm and probe_radius_mm > 0 in {path}, got: {said(problem)}."
        ) from problem


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
    except _DAMAGED:
        return None


def taxim_source(path: Path, options: ReadOptions) -> PressSource:
    """Taxim's `dataPack.npz`: f0, imgs (BGR, as OpenCV read them), touch_center (x, y), touch_radius, names.

    Nothing is unpickled: a member of Python objects is refused.
    """
    pack = taxim_pack_in(path)
    assert pack is not None
    arrays = _plain_arrays(pack)
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
    rows = [Listed(n, ball, (float(x), float(y), float(r))) for n, (x, y), r in zip(names, centers, radii)]
    rest = read_background(options.background) if options.background is not None else _rgb(arrays["f0"])
    return PressSource(rest, rows, lambda k: _rgb(images[k]))


def _plain_arrays(pack: Path) -> dict[str, NDArray[Any]]:
    try:
        checked_archive(pack, "a dataPack", MAX_PACK_BYTES)
        with pack.open("rb") as handle, np.load(handle, allow_pickle=False) as data:
            missing = [name for name in TAXIM_ARRAYS if name not in data.files]
            if missing:
                raise DataError(
                    f"Expected the arrays {', '.join(TAXIM_ARRAYS)} in {pack}, {', '.join(missing)} missing."
                )
            arrays = {name: data[name] for name in (*TAXIM_ARRAYS, "names") if name in data.files}
    except _DAMAGED as problem:
        raise DataError(f"{pack} is truncated or damaged: {said(problem)}.") from problem
    except ValueError as problem:
        raise DataError(
            f"{pack} holds Python objects, which could run code when read: refused. Save it again with plain "
            f"arrays (numpy.asarray(imgs, dtype=numpy.uint8) ...). ({problem})"
        ) from problem
    for name in TAXIM_ARRAYS:  # numpy gives the bytes of a member that is no array
        if not isinstance(arrays[name], np.ndarray) or arrays[name].dtype.kind not in "uif":
            raise DataError(
                f"Expected {name} as an array of numbers in {pack}. Save it again with numpy.savez."
            )
    return arrays


def _rgb(bgr: NDArray[Any]) -> NDArray[np.uint8]:
    return np.ascontiguousarray(bgr[..., ::-1], dtype=np.uint8)


LABEL_COLUMNS = ("center_x_px", "center_y_px", "contact_radius_px")
BALL, FLAT = "ball", "flat"  # indenters
DIAMETER = re.compile(r"(?<![\d.,])(\d+(?:[.,]\d+)?)[ _-]?mm(?![a-z])", re.IGNORECASE)  # in a folder's name
NAMED_ODD = 5  # images of another size that a message lists
PRESS_FOLDER, GS_SDK, PY3DCAL = "press folder", "gs_sdk folder", "py3DCal folder"
TAXIM, PLAIN, STACK, VIDEO = "Taxim dataPack", "folder of images", "file of several images", "video"


def read_presses(
    path: str | PathLike[str],
    *,
    sensor: str | None = None,
    mm_per_px: float | tuple[float, float] | None = None,
    ball_diameter_mm: float | None = None,
    background: str | PathLike[str] | None = None,
    crop: tuple[float, float, float, float] | None = None,
    bgr: bool = False,
    progress: Progress = no_progress,
) -> Presses:
    """Read ball presses.

    Parameters
    ----------
    path : a press folder (`presses.csv` with the columns image, ball_diameter_mm), gs_sdk's (`catalog.csv`) or
        py3DCal's folder, Taxim's `dataPack.npz`, or a folder of plain images, a TIFF of several pages, frames of numpy
        (`.npy`), a video or a recording (`*.mcap`) with `ball_diameter_mm`
    sensor : name of a profile, which has the view and mm_per_px
    mm_per_px : pixel pitch, mm, or (x, y) of pixels that are not square; overrides sensor.toml and the profile
    ball_diameter_mm : for data without it
    background : the background image, or a folder of several; the press folder's `background.png` or `background/`
        by default
    crop : (left, top, width, height) in pixels of the frame
    bgr : whether all images, the background too, are blue, green, red, as OpenCV writes an array
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
    if kind == VIDEO:
        return presses_from_film(place, options, progress)
    if kind is None:
        is_picture = place.suffix.lower() in IMAGE_SUFFIXES
        is_file = "one picture: give the folder of all" if is_picture else "a file of another kind"
        is_what = is_file if place.exists() else "not there"
        raise DataError(
            f"Expected a folder of presses, a video, a recording (*.mcap) or a Taxim dataPack.npz, got {place}, which is "
            f"{is_what}.{way_for(place) if place.exists() else ''}"
        )
    refuse_bag(place)
    return _read(place, SOURCES[kind](place, options), options, progress)


def as_presses(presses: Presses | str | PathLike[str], *, progress: Progress = no_progress) -> Presses:
    """Return a press set unchanged, or read it from a path, for functions that take presses.

    Raises
    ------
    TypeError, ValueError
        Neither, or a ball diameter outside 0.1 to 200 mm.
    """
    if isinstance(presses, Presses):
        for press in presses.presses:
            try:
                check_ball_diameter(press.ball_diameter_mm)
            except (TypeError, ValueError) as problem:
                raise type(problem)(f"{problem} ({press.name})") from None
        return presses
    if isinstance(presses, (str, PathLike)):
        return read_presses(presses, progress=progress)
    raise TypeError(
        f"Expected presses, from gelform.read_presses(path), or the path of a press folder, got {type(presses).__name__}."
    )


def kind_of_presses(place: Path) -> str | None:
    """The layout of presses at a path: VIDEO, a name in `SOURCES`, or None."""
    if place.is_file() and place.suffix.lower() in FILM_SUFFIXES:
        return VIDEO
    if is_stack(place):
        return STACK
    if (place / "presses.csv").is_file():
        return PRESS_FOLDER
    if (place / "catalog.csv").is_file():
        return GS_SDK
    if (place / "probe_images").is_dir() and is_py3dcal(place):
        return PY3DCAL
    if taxim_pack_in(place) is not None:
        return TAXIM
    return PLAIN if place.is_dir() else None


def _read(place: Path, source: PressSource, options: ReadOptions, progress: Progress) -> Presses:
    """Read every image of a source, through one view."""
    settings = options.settings(place, source.known)
    if not source.listed:
        others = f" beside {len(source.flats)} of flat punches" if source.flats else ""
        why = "".join(f" {note}" for note in source.notes)
        raise DataError(
            f"No press of a ball in {place}{others}: expected images and a presses.csv with a row for each.{why}"
        )
    frame_shape = (source.background.shape[0], source.background.shape[1])
    view = options.view(settings, frame_shape)
    if view.frame_shape not in (None, frame_shape):
        raise DataError(
            f"The view of {place} is of frames of {_px(view.frame_shape)}, and its background is {_px(frame_shape)}. "
            "Correct the view in sensor.toml, or leave it out where the images need none."
        )
    presses: list[Press] = []
    flats: list[FlatPress] = []
    sizes = {}
    rows: list[Listed | ListedFlat] = [*source.listed, *source.flats]
    for done, listed in enumerate(rows):
        frame = options.in_rgb(source.frame(done))
        sizes[listed.name] = (frame.shape[0], frame.shape[1])
        if sizes[listed.name] == frame_shape:
            if isinstance(listed, Listed):
                presses.append(press_from_frame(listed, frame, view))
            else:
                flats.append(flat_from_frame(listed, frame, view))
        progress(done + 1, len(rows), "reading presses")
    _check_one_size(sizes, frame_shape)
    background = image_from_frame(options.in_rgb(source.background), view).astype(np.float32)
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
    named = ", ".join(f"{name} is {_px(size)}" for name, size in list(odd.items())[:NAMED_ODD])
    more = f", and {len(odd) - NAMED_ODD} more" if len(odd) > NAMED_ODD else ""
    raise DataError(
        f"Expected all images of one size: {named}{more}; the background and {len(sizes) - len(odd)} presses are "
        f"{_px(background)}. Leave the odd ones out, or take all with the same camera settings."
    )


def _px(size: tuple[int, int]) -> str:
    return f"{size[0]}x{size[1]} px"


def press_folder_source(folder: Path, options: ReadOptions) -> PressSource:
    """A press folder: `presses.csv` (image, ball_diameter_mm, optional labels, flat punches), `background.png`, images."""
    rest = read_background(options.background or background_in(folder))
    balls: list[Listed] = []
    flats: list[ListedFlat] = []
    left_out: Counter[str] = Counter()
    for where, row in table_rows(folder / "presses.csv", ("image", "ball_diameter_mm")):
        row["image"], indenter = file_of(folder, row["image"]), row.get("indenter", "")
        if indenter in ("", BALL):
            balls.append(_listed_ball(row, where))
        elif indenter == FLAT and row.get("height_mm"):
            flats.append(ListedFlat(row["image"], height(row["height_mm"], where)))
        else:  # not measured, or for evaluation by other means
            left_out["flat without height_mm" if indenter == FLAT else indenter] += 1
    names = [ball.name for ball in balls] + [flat.name for flat in flats]
    notes = tuple(
        f"gelform left out rows of presses.csv with the indenter {name}: {count} (it knows {BALL}, and {FLAT} "
        "with height_mm)."
        for name, count in left_out.items()
    )
    return PressSource(rest, balls, lambda k: read_image(folder / names[k]), flats=flats, notes=notes)


def _listed_ball(row: Mapping[str, str], where: str) -> Listed:
    label = None
    if all(row.get(column) for column in LABEL_COLUMNS):
        x, y, radius = (number(row[column], column, where) for column in LABEL_COLUMNS)
        label = (x, y, radius)
    return Listed(row["image"], diameter(row["ball_diameter_mm"], where), label)


def plain_source(folder: Path, options: ReadOptions) -> PressSource:
    """A folder of images of one ball, one press each, and `background.png`."""
    if rows := rows_by_folder(folder):
        raise DataError(
            f"{folder} has folders whose names are diameters, and no presses.csv. Write the lines that they suggest: "
            f"{'; '.join(rows[: 1 + NAMED_ODD])} ... (gelform info {folder} prints all {len(rows)}), if they are right."
        )
    rest_path = options.background or background_in(folder)
    images = [p for p in sorted(folder.iterdir()) if p.suffix.lower() in IMAGE_SUFFIXES]
    images = [p for p in images if p.stem != "background" and p.resolve() != rest_path.resolve()]
    ball = options.ball(f"{folder} has images but no presses.csv") if images else 0.0
    listed = [Listed(path.name, ball) for path in images]
    return PressSource(read_background(rest_path), listed, lambda k: read_image(images[k]))


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
    rest, (image, count) = options.background or background_in(file.parent), images_of_stack(file)
    ball = options.ball(f"{file} has images but no presses.csv")
    return PressSource(read_background(rest), [Listed(f"image {k}", ball) for k in range(count)], image)


SOURCES: Mapping[str, Callable[[Path, ReadOptions], PressSource]] = {
    PRESS_FOLDER: press_folder_source,
    GS_SDK: gs_sdk_source,
    PY3DCAL: py3dcal_source,
    TAXIM: taxim_source,
    PLAIN: plain_source,
    STACK: stack_source,
}

__all__ = ["Press", "Presses", "as_presses", "kind_of_presses", "read_presses"]


def with_scale(presses: Presses | str | PathLike[str], scale: Scale) -> Presses:
    """The presses, or those at a path, with a measured scale."""
    check_is(scale, Scale, "scale")
    presses = as_presses(presses)
    return replace(
        presses,
        mm_per_px=scale.mm_per_px,
        mm_per_px_sigma=scale.sigma,
        geometry=replace(presses.geometry, scale_source=scale.source),
    )


def with_crosstalk(presses: Presses | str | PathLike[str], crosstalk: Crosstalk) -> Presses:
    """The presses with a known crosstalk, which the calibration removes before its color model."""
    check_is(crosstalk, Crosstalk, "crosstalk")
    presses = as_presses(presses)
    return replace(presses, geometry=replace(presses.geometry, crosstalk=crosstalk))


def with_view(presses: Presses | str | PathLike[str], view: View, source: str) -> Presses:
    """The presses through a view that removes the lens distortion; labels move with their pixels.

    Parameters
    ----------
    presses : as they were read, without a view
    view : from the presses' frames to images
    source : target that the view was measured on, for the report

    Raises
    ------
    DataError
        The presses have a view of their own already, or are of another size than the view's frames.
    """
    check_is(view, View, "view")
    check_is(source, str, "source")
    presses = as_presses(presses)
    if not presses.view.is_identity:
        raise DataError(
            "Expected presses without a view where the lens is undone, got a [view] or --crop: undo it on whole "
            "frames (leave the view out), and crop by the lens's view."
        )
    if presses.image_shape != view.frame_shape:
        raise DataError(
            f"Expected presses of the size of the grid's images, {view.frame_shape} px, got {presses.image_shape} px "
            "(height, width). Take both with the same camera settings."
        )
    background = image_from_frame(presses.background, view).astype(np.float32)
    through = tuple(_through(press, view) for press in presses.presses)
    flats = tuple(
        flat_from_frame(ListedFlat(flat.name, flat.height_mm), flat.image, view) for flat in presses.flats
    )
    geometry = replace(presses.geometry, lens=source)
    return replace(presses, presses=through, flats=flats, background=background, view=view, geometry=geometry)


def _through(press: Press, view: View) -> Press:
    image = np.ascontiguousarray(image_from_frame(press.image, view))
    label = None
    if press.label is not None:
        x, y, radius = press.label
        ring = np.array([(x, y), (x + radius, y), (x - radius, y), (x, y + radius), (x, y - radius)])
        center, *rim = image_px_from_frame_px(ring, view)
        distances = [float(np.hypot(*(point - center))) for point in rim]
        label = (float(center[0]), float(center[1]), float(np.mean(distances)))
    return replace(press, image=image, digest=pixels_digest(image), label=label)
