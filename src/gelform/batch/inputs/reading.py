"""The frames of a part, each with its name or with why it cannot be read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from gelform.background.average import background_from_frames
from gelform.batch.inputs.containers import image_from_values
from gelform.batch.inputs.hdf5_datasets import hdf5_values
from gelform.batch.inputs.lerobot_images import stored_images
from gelform.batch.inputs.lerobot_set import video_frames
from gelform.batch.inputs.plan import Part
from gelform.batch.inputs.zarr_datasets import is_zarr, zarr_values
from gelform.calibration_file import Calibration
from gelform.checks import check_image
from gelform.errors import DataError, GelformError
from gelform.frames import Frame
from gelform.sensors.files import read_image
from gelform.sensors.source import open_source
from gelform.view import image_from_frame


@dataclass(frozen=True)
class NamedFrame:
    """A frame of a sequence, or why there is none.

    Attributes
    ----------
    name : of its output, without ending
    index : its place in the sequence, from 0
    frame : None where it cannot be read; images of a folder have no times
    error : why; empty where there is a frame
    timed : whether the frame's times are those of its recording
    """

    name: str
    index: int
    frame: Frame | None
    error: str = ""
    timed: bool = False


def frames_of_part(part: Part) -> Iterator[NamedFrame]:
    """The frames of a part in their order; a video ends with the first that cannot be read."""
    if part.images:
        yield from _images(part.path, part.images, part.names, part.start)
    elif part.dataset:
        yield from _dataset(part, part.start, part.count)
    else:
        yield from _film(part.path)


def image_of_calibration(frame: Frame, calibration: Calibration) -> NDArray[Any]:
    """The image (H, W, 3) of a frame, through the calibration's view.

    Raises
    ------
    DataError
        A frame of another size.
    """
    try:
        image = image_from_frame(frame.image, calibration.view)
        return check_image(image, shape=calibration.image_shape, name="frame")
    except ValueError as problem:
        raise DataError(str(problem)) from problem


def background_of_sequence(part: Part, count: int, calibration: Calibration) -> NDArray[Any]:
    """The average (H, W, 3) of the first frames of a part's sequence, those left out that cannot be read.

    Raises
    ------
    DataError
        None can be read, one is of another size, or they differ: something touches the gel in them.
    """
    first = list(islice(_from_the_first(part, count), count))
    images = [image_of_calibration(one.frame, calibration) for one in first if one.frame is not None]
    if not images:
        why = first[0].error if first else "there is none."
        raise DataError(f"No background: none of the first {count} frames can be read: {why}")
    try:
        return background_from_frames(images).background
    except DataError as problem:
        raise DataError(f"No background from the first {count} frames: {problem}") from problem


def _from_the_first(part: Part, count: int) -> Iterator[NamedFrame]:
    """Frames of a part's sequence from its beginning."""
    if part.images:
        return _images(part.path, part.first, part.first, 0)
    return _dataset(part, 0, min(count, part.total)) if part.dataset else _film(part.path)


def _dataset(part: Part, start: int, count: int) -> Iterator[NamedFrame]:
    """Frames of a sequence in a larger file, each with what it is or why it cannot be read."""
    index, timed = start, part.rate_hz > 0
    try:
        for seconds, values in _values(part, start, count):
            try:
                frame = Frame(image_from_values(values), seconds, 0, index)
                yield NamedFrame(f"{index:06d}", index, frame, timed=timed)
            except DataError as problem:
                yield NamedFrame(f"{index:06d}", index, None, str(problem))
            index += 1
    except (GelformError, OSError) as problem:
        for rest in range(index, max(start + count, index + 1)):
            yield NamedFrame(f"{rest:06d}", rest, None, str(problem))


def _values(part: Part, start: int, count: int) -> Iterator[tuple[float, NDArray[Any] | DataError]]:
    if part.path.suffix == ".mp4":
        return video_frames(part.path, part.offset, start, count)
    if part.path.suffix == ".parquet":
        return stored_images(part.path, part.dataset, part.offset, start, count)
    values = zarr_values if is_zarr(part.path) else hdf5_values
    return ((0.0, one) for one in values(part.path, part.dataset, part.offset + start, count))


def _images(folder: Path, images: Sequence[str], names: Sequence[str], start: int) -> Iterator[NamedFrame]:
    for index, (image, name) in enumerate(zip(images, names), start):
        try:
            frame = Frame(read_image(folder / image), 0.0, 0, index)
        except GelformError as problem:
            yield NamedFrame(name, index, None, str(problem))
        else:
            yield NamedFrame(name, index, frame)


def _film(path: Path) -> Iterator[NamedFrame]:
    count = 0
    try:
        with open_source(path) as source:
            for frame in source:
                yield NamedFrame(f"{count:06d}", count, frame, timed=True)
                count += 1
    except (GelformError, OSError) as problem:
        yield NamedFrame(f"{count:06d}", count, None, str(problem))
