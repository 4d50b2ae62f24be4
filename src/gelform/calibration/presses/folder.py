"""Read presses of a ball from a press folder, other packages' folders, plain images, a video or a recording."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.geometry.measured import Crosstalk
from gelform.calibration.geometry.scale import Scale
from gelform.calibration.presses.layouts import SOURCES, VIDEO, PressSource, ReadOptions, kind_of_presses
from gelform.calibration.presses.press_set import FlatPress, Press, Presses, presses_from_settings
from gelform.calibration.presses.video import presses_in_film
from gelform.errors import DataError
from gelform.foundations.checks import check_is, check_path
from gelform.foundations.files import way_for
from gelform.foundations.findings import Progress, no_progress
from gelform.image.frame import Frame
from gelform.image.view import View, image_from_frame, image_px_from_frame_px
from gelform.sensors.files import IMAGE_SUFFIXES, background_in, read_background, read_image
from gelform.sensors.films import open_film
from gelform.sensors.recordings.mcap_reader import refuse_bag

__all__ = ["Press", "Presses", "as_presses", "kind_of_presses", "read_presses"]

NAMED_ODD = 5  # images of another size that a message lists


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
        at_rest = None if rest is None else read_background(rest, bgr=bgr)
        return _presses_of_film(open_film(place, bgr=bgr), place, options, at_rest, progress)
    if kind is None:
        is_picture = place.suffix.lower() in IMAGE_SUFFIXES
        is_file = "one picture: give the folder of all" if is_picture else "a file of another kind"
        is_what = is_file if place.exists() else "not there"
        raise DataError(
            f"Expected a folder of presses, a video, a recording (*.mcap) or a Taxim dataPack.npz, got {place}, which is "
            f"{is_what}.{way_for(place) if place.exists() else ''}"
        )
    refuse_bag(place)
    return _presses_of_images(SOURCES[kind](place, options), place, options, progress)


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
    flat_count = sum(listed.height_mm is not None for listed in source.listed)
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
    presses: list[Press] = []
    flats: list[FlatPress] = []
    sizes = {}
    for k, one in enumerate(source.listed):
        frame = options.in_rgb(read_image(place / one.name) if source.frame is None else source.frame(k))
        sizes[one.name] = (frame.shape[0], frame.shape[1])
        if sizes[one.name] == frame_shape:
            image = _seen(frame, view)
            if one.height_mm is None:
                presses.append(Press(one.name, image, one.ball_diameter_mm, one.label, one.center_px))
            else:
                flats.append(FlatPress(one.name, image, one.height_mm))
        progress(k + 1, len(source.listed), "reading presses")
    _check_one_size(sizes, frame_shape)
    background = image_from_frame(rest, view).astype(np.float32)
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
    return replace(
        presses,
        presses=tuple(_through(press, view) for press in presses.presses),
        flats=tuple(replace(flat, image=_seen(flat.image, view)) for flat in presses.flats),
        background=image_from_frame(presses.background, view).astype(np.float32),
        view=view,
        geometry=replace(presses.geometry, lens=source),
    )


def _through(press: Press, view: View) -> Press:
    label = None
    if press.label is not None:
        x, y, radius = press.label
        ring = np.array([(x, y), (x + radius, y), (x - radius, y), (x, y + radius), (x, y - radius)])
        center, *rim = image_px_from_frame_px(ring, view)
        distances = [float(np.hypot(*(point - center))) for point in rim]
        label = (float(center[0]), float(center[1]), float(np.mean(distances)))
    return replace(press, image=_seen(press.image, view), label=label)


def _seen(frame: NDArray[Any], view: View) -> NDArray[Any]:
    return np.ascontiguousarray(image_from_frame(frame, view))
