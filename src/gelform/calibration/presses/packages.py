"""Presses in the layouts of other packages: gs_sdk, py3DCal, and Taxim's dataPack.npz."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.presses.press_set import (
    Listed,
    PressSource,
    ReadOptions,
    check_ball_diameter,
    diameter,
    file_of,
    number,
    table_rows,
)
from gelform.errors import DataError, said
from gelform.foundations.checks import check_positive, check_sensor_pitch
from gelform.foundations.npz_files import DAMAGED_ARCHIVE, checked_archive
from gelform.foundations.whole_files import MAX_TEXT_BYTES, bytes_of
from gelform.sensors.files import IMAGE_SUFFIXES, SensorSettings, background_in, read_background, read_image

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
