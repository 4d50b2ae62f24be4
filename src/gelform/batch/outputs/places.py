"""Where a part's outputs go, and what is recorded of each file."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from gelform.batch.inputs.plan import Part
from gelform.batch.settings import BatchSettings
from gelform.npz_files import written_file

FRAMES = "frames"
Maps = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class Place:
    """What a writer has to know of a part.

    Attributes
    ----------
    output : folder of the batch
    part : whose frames come
    settings : of the batch
    shape : (H, W) of the maps
    facts : of the calibration, for the files' attributes: mm_per_px and calibration_digest
    """

    output: Path
    part: Part
    settings: BatchSettings
    shape: tuple[int, int]
    facts: Mapping[str, Any]

    @property
    def folder(self) -> Path:
        """Of the part's sequence."""
        return self.output / FRAMES / self.part.sequence

    def name_of(self, path: Path) -> str:
        """A path as records and the table have it."""
        return path.relative_to(self.output).as_posix()

    def write(self, path: Path, content: bytes) -> OutputFile:
        """Write a file whole or not at all.

        Raises
        ------
        DataError
            The disk is full, or the folder cannot be written to.
        """
        path.parent.mkdir(parents=True, exist_ok=True)
        with written_file(path, overwrite=True) as file:
            file.write(content)
        return OutputFile(self.name_of(path), len(content), hashlib.sha256(content).hexdigest())


@dataclass(frozen=True)
class OutputFile:
    """A file that a part wrote: its path below the output, bytes, and SHA-256."""

    path: str
    bytes: int
    sha256: str


def output_file(output: Path, path: Path) -> OutputFile:
    """Of a file that is there."""
    sha, size = hashlib.sha256(), 0
    with path.open("rb") as file:
        while piece := file.read(1 << 20):
            sha.update(piece)
            size += len(piece)
    return OutputFile(path.relative_to(output).as_posix(), size, sha.hexdigest())
