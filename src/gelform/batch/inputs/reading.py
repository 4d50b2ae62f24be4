"""The frames of a part, each with its position or its error, and the background image of a sequence."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from gelform.batch.inputs.containers import container_values, stored_images, video_frames
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
from gelform.sensors.films import open_film
from gelform.sensors.pictures import image_from_values

BACKGROUND_COLUMNS = ("sequence", "background")
MOST_NAMED = 3  # sequences that a message names at most


def frames_of_part(
    part: Part, most_pixels: float = MAX_PIXELS
) -> Iterator[tuple[int, Frame | BaseException]]:
    """Position in the film, and frame or error, of each frame of a part; larger pictures are not decoded.

    A video ends at its first unreadable frame. Images of a folder have no times.
    """
    index = part.start
    try:
        for frame in _frames(part, most_pixels):
            yield index, in_rgb(frame) if part.bgr and isinstance(frame, Frame) else frame
            index += 1
    except (GelformError, OSError, MemoryError) as problem:
        for missed in range(index, max(part.start + part.count, index + 1)):
            yield missed, problem


def _frames(part: Part, most_pixels: float) -> Iterator[Frame | BaseException]:
    film = part.film
    if not (film.images or film.dataset):
        yield from open_film(film.path)
        return
    pictures: Iterable[tuple[float, Callable[..., NDArray[Any]], Any]]
    if film.images:
        pictures = ((0.0, read_image, film.path / one) for one in film.images)
    else:
        pictures = ((time_s, image_from_values, values) for time_s, values in _values(part))
    for index, (time_s, image_from, stored) in enumerate(pictures, part.start):
        frame: Frame | BaseException
        try:
            frame = Frame(image_from(stored, most_pixels=most_pixels), time_s, 0, index)
        except (GelformError, MemoryError) as problem:
            frame = problem
        yield frame


def _values(part: Part) -> Iterator[tuple[float, NDArray[Any] | DataError]]:
    film, begin = part.film, part.film.offset + part.start
    if film.path.suffix == ".mp4":
        return video_frames(film.path, film.offset, part.start, part.count)
    if film.path.suffix == ".parquet":
        return stored_images(film.path, film.dataset, film.offset, part.start, part.count)
    return ((0.0, one) for one in container_values(film.path, film.dataset, begin, part.count))


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
    first = [one for _, one in islice(frames_of_part(part.beginning(count), calibration.most_pixels), count)]
    images = [image_of_calibration(one, calibration) for one in first if isinstance(one, Frame)]
    if not images:
        why = next((reason(one) for one in first if not isinstance(one, Frame)), "there is none.")
        raise DataError(f"No background: none of the first {count} frames can be read: {why}")
    try:
        return background_from_frames(images).background
    except DataError as problem:
        raise DataError(f"No background from the first {count} frames: {problem}") from problem


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
