"""The untouched gel from files: one for all sequences, or a table that names one for each."""

from __future__ import annotations

import csv
import hashlib
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from gelform.background.check import background_digest
from gelform.batch.inputs.reading import image_of_calibration
from gelform.calibration_file import Calibration
from gelform.errors import DataError, GelformError
from gelform.frames import Frame
from gelform.sensors.files import read_background

COLUMNS = ("sequence", "background")
MOST_NAMED = 3


@dataclass(frozen=True)
class Backgrounds:
    """Files of the untouched gel.

    Attributes
    ----------
    of_all : an image or a folder of several, of every sequence; None where there is none
    by_sequence : the same for each sequence, where a table names them
    """

    of_all: Path | None = None
    by_sequence: Mapping[str, Path] = field(default_factory=dict)

    @property
    def files(self) -> list[Path]:
        """All of them."""
        return [*self.by_sequence.values()] + ([] if self.of_all is None else [self.of_all])

    def read(self, sequences: Collection[str], calibration: Calibration) -> tuple[NDArray[Any] | None, str]:
        """The image (H, W, 3) of all sequences, if it is one, and a digest of all that are used; empty without any.

        Raises
        ------
        DataError
            The table leaves out a sequence or names another one; a background cannot be read, or is of another size.
        """
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
    """What `--background` means: an image, a folder of several, or a CSV table of `sequence,background`.

    A table's paths start from its own folder; sequences are named as in the table that the batch writes.

    Raises
    ------
    DataError
        The table cannot be read, lacks a column, or has a sequence twice.
    """
    if path is None or path.suffix.lower() != ".csv":
        return Backgrounds(path)
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.DictReader(file))
    except (OSError, ValueError, csv.Error) as problem:
        raise DataError(f"Cannot read the table of backgrounds {path}: {problem}.") from problem
    if not rows or not all(row.get(one) is not None for row in rows for one in COLUMNS):
        raise DataError(
            f"Expected rows with the columns {' and '.join(COLUMNS)} in {path}. Name an image of the untouched gel for "
            "each sequence."
        )
    found = {row["sequence"]: path.parent / row["background"] for row in rows}
    if len(found) < len(rows):
        raise DataError(f"Expected each sequence once in {path}, got {len(rows)} rows of {len(found)}.")
    return Backgrounds(by_sequence=found)


def background_of_file(path: Path, calibration: Calibration) -> NDArray[Any]:
    """The image (H, W, 3) of the untouched gel, through the calibration's view.

    Raises
    ------
    DataError
        It cannot be read, or is of another size.
    """
    try:
        return image_of_calibration(Frame(read_background(path), 0.0, 0, 0), calibration)
    except GelformError as problem:
        raise DataError(f"The background {path}: {problem}") from problem


def _refuse(sequences: Collection[str], said: str) -> None:
    if sequences:
        named = ", ".join(repr(one) for one in sorted(sequences)[:MOST_NAMED])
        more = f" and {len(sequences) - MOST_NAMED} more" if len(sequences) > MOST_NAMED else ""
        raise DataError(f"{said} {named}{more}. Names are those of the table frames.csv of a batch.")
