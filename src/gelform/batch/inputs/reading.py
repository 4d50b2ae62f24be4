"""The frames of a part, each with its name or its error, and the background image of a sequence."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from gelform.batch.inputs.containers import hdf5_values, is_zarr, stored_images, video_frames, zarr_values
from gelform.batch.inputs.listing import Part
from gelform.calibration.presses.press_set import file_of, table_rows
from gelform.calibration_file import Calibration
from gelform.errors import DataError, GelformError, reason
from gelform.foundations.checks import check_image
from gelform.image.agreement import background_digest
from gelform.image.background import background_from_frames
from gelform.image.frame import Frame, in_rgb
from gelform.image.view import MAX_PIXELS, image_from_frame
from gelform.sensors.files import read_background, read_image
from gelform.sensors.pictures import image_from_values
from gelform.sensors.source import open_source

BACKGROUND_COLUMNS = ("sequence", "background")
MOST_NAMED = 3  # sequences that a message names at most


@dataclass(frozen=True)
class NamedFrame:
    """A frame of a sequence, or its error.

    Attributes
    ----------
    name : name of its output, without ending
    index : its position in the sequence, from 0
    frame : None if it is unreadable; images of a folder have no times
    error : the reason; empty if there is a frame
    timed : whether the frame has the times of its recording
    """

    name: str
    index: int
    frame: Frame | None
    error: str = ""
    timed: bool = False


def frames_of_part(part: Part, most_pixels: float = MAX_PIXELS) -> Iterator[NamedFrame]:
    """The frames of a part in order; a video ends at its first unreadable frame, and larger pictures are not decoded."""
    if part.images:
        frames = _images(part.path, part.images, part.names, part.start, most_pixels)
    elif part.dataset:
        frames = _dataset(part, part.start, part.count, most_pixels)
    else:
        frames = _film(part.path)
    yield from _in_rgb(frames, part.bgr)


def image_of_calibration(frame: Frame, calibration: Calibration) -> NDArray[Any]:
    """The image (H, W, 3) of a frame, through the calibration's view; DataError for a frame of another size."""
    try:
        image = image_from_frame(frame.image, calibration.view)
        return check_image(image, shape=calibration.image_shape, name="frame")
    except ValueError as problem:
        raise DataError(str(problem)) from problem


def background_of_sequence(part: Part, count: int, calibration: Calibration) -> NDArray[Any]:
    """The average (H, W, 3) of the first readable frames of a part's sequence.

    DataError if none is readable, one has another size, or they differ because something touches the gel.
    """
    first = list(islice(_in_rgb(_from_the_first(part, count, calibration.most_pixels), part.bgr), count))
    images = [image_of_calibration(one.frame, calibration) for one in first if one.frame is not None]
    if not images:
        why = first[0].error if first else "there is none."
        raise DataError(f"No background: none of the first {count} frames can be read: {why}")
    try:
        return background_from_frames(images).background
    except DataError as problem:
        raise DataError(f"No background from the first {count} frames: {problem}") from problem


def _in_rgb(frames: Iterator[NamedFrame], bgr: bool) -> Iterator[NamedFrame]:
    """The frames with red first, for files whose channels are blue, green, red."""
    for named in frames:
        if bgr and named.frame is not None:
            named = replace(named, frame=in_rgb(named.frame))
        yield named


def _from_the_first(part: Part, count: int, most_pixels: float) -> Iterator[NamedFrame]:
    """Frames of a part's sequence from its start."""
    if part.images:
        return _images(part.path, part.first, part.first, 0, most_pixels)
    if part.dataset:
        return _dataset(part, 0, min(count, part.total), most_pixels)
    return _film(part.path)


def _dataset(part: Part, start: int, count: int, most_pixels: float) -> Iterator[NamedFrame]:
    """Frames of a sequence in a larger file, each with its image or its error."""
    index, timed = start, part.rate_hz > 0
    try:
        for seconds, values in _values(part, start, count):
            try:
                frame = Frame(image_from_values(values, most_pixels), seconds, 0, index)
                yield NamedFrame(f"{index:06d}", index, frame, timed=timed)
            except (DataError, MemoryError) as problem:
                yield NamedFrame(f"{index:06d}", index, None, reason(problem))
            index += 1
    except (GelformError, OSError, MemoryError) as problem:
        for missed in range(index, max(start + count, index + 1)):
            yield NamedFrame(f"{missed:06d}", missed, None, reason(problem))


def _values(part: Part, start: int, count: int) -> Iterator[tuple[float, NDArray[Any] | DataError]]:
    if part.path.suffix == ".mp4":
        return video_frames(part.path, part.offset, start, count)
    if part.path.suffix == ".parquet":
        return stored_images(part.path, part.dataset, part.offset, start, count)
    values = zarr_values if is_zarr(part.path) else hdf5_values
    return ((0.0, one) for one in values(part.path, part.dataset, part.offset + start, count))


def _images(
    folder: Path, images: Sequence[str], names: Sequence[str], start: int, most_pixels: float
) -> Iterator[NamedFrame]:
    for index, (image, name) in enumerate(zip(images, names), start):
        try:
            frame = Frame(read_image(folder / image, most_pixels=most_pixels), 0.0, 0, index)
        except (GelformError, MemoryError) as problem:
            yield NamedFrame(name, index, None, reason(problem))
        else:
            yield NamedFrame(name, index, frame)


def _film(path: Path) -> Iterator[NamedFrame]:
    count = 0
    try:
        with open_source(path) as source:
            for frame in source:
                yield NamedFrame(f"{count:06d}", count, frame, timed=True)
                count += 1
    except (GelformError, OSError, MemoryError) as problem:
        yield NamedFrame(f"{count:06d}", count, None, reason(problem))


@dataclass(frozen=True)
class Backgrounds:
    """Files of the gel at rest.

    Attributes
    ----------
    of_all : an image or a folder of several, for every sequence; or None
    by_sequence : the same for each sequence that a table names
    """

    of_all: Path | None = None
    by_sequence: Mapping[str, Path] = field(default_factory=dict)

    @property
    def files(self) -> list[Path]:
        """All files."""
        return [*self.by_sequence.values()] + ([] if self.of_all is None else [self.of_all])

    def read(self, sequences: Collection[str], calibration: Calibration) -> tuple[NDArray[Any] | None, str]:
        """The image (H, W, 3) for all sequences, if there is one, and a digest of all; DataError for unknown sequences."""
        if self.of_all is not None:
            image = background_of_file(self.of_all, calibration)
            return image, background_digest(image)
        if not self.by_sequence:
            return None, ""
        without = [one for one in sequences if one not in self.by_sequence]
        _refuse(without, "The table of backgrounds has no row for")
        _refuse(
            self.by_sequence.keys() - set(sequences), "The table of backgrounds names, and the input lacks,"
        )
        sha = hashlib.sha256()
        for name, path in sorted(self.by_sequence.items()):
            sha.update(f"{name}\0{background_digest(background_of_file(path, calibration))}\n".encode())
        return None, sha.hexdigest()


def backgrounds_of(path: Path | None) -> Backgrounds:
    """Read `--background`: an image, a folder of several, or a CSV table of `sequence,background` (DataError if neither).

    Paths in a table are relative to its folder; sequences have their names in the batch's own table.
    """
    if path is None or path.suffix.lower() != ".csv":
        return Backgrounds(path)
    rows = [row for _, row in table_rows(path, BACKGROUND_COLUMNS)]
    if not rows:
        raise DataError(
            f"Expected rows with the columns {' and '.join(BACKGROUND_COLUMNS)} in {path}. Name an image of the untouched "
            "gel for each sequence."
        )
    found = {row["sequence"]: path.parent / file_of(path.parent, row["background"]) for row in rows}
    if len(found) < len(rows):
        raise DataError(f"Expected each sequence once in {path}, got {len(rows)} rows of {len(found)}.")
    return Backgrounds(by_sequence=found)


def background_of_file(path: Path, calibration: Calibration) -> NDArray[Any]:
    """The background image (H, W, 3) from a file, through the calibration's view; DataError if that fails."""
    try:
        return image_of_calibration(Frame(read_background(path), 0.0, 0, 0), calibration)
    except GelformError as problem:
        raise DataError(f"The background {path}: {problem}") from problem


def _refuse(sequences: Collection[str], said: str) -> None:
    if sequences:
        named = ", ".join(repr(one) for one in sorted(sequences)[:MOST_NAMED])
        more = f" and {len(sequences) - MOST_NAMED} more" if len(sequences) > MOST_NAMED else ""
        raise DataError(f"{said} {named}{more}. Names are those of the table frames.csv of a batch.")
