"""Where a part's outputs go, and what is recorded of each file."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from numpy.typing import NDArray

from gelform.batch.inputs.plan import Part
from gelform.batch.settings import BatchSettings
from gelform.errors import DataError
from gelform.npz_files import written_file

FRAMES, PARTS = "frames", "parts"
FLUSHED_AT_ONCE = 4
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
        return write_output(self.output, path, content)


class FlushedLater:
    """Files that are flushed to the disk beside the work; a context manager, whose block ends when the disk has them all.

    A worker would wait for the disk after every frame. What a loss of power takes before is a part without its record, which
    is done again.

    Raises
    ------
    DataError
        The disk has not taken one of them.
    """

    def __init__(self, output: Path) -> None:
        self._output = output
        self._flushing = ThreadPoolExecutor(FLUSHED_AT_ONCE)
        self._files: list[Future[None]] = []

    def write(self, path: Path, content: bytes) -> OutputFile:
        """Write a file whole or not at all; the folders above it are made."""
        written = write_output(self._output, path, content, flushed=False)
        self._files.append(self._flushing.submit(_flush, path))
        return written

    def __enter__(self) -> FlushedLater:
        return self

    def __exit__(self, *error: object) -> None:
        self._flushing.shutdown(cancel_futures=error[0] is not None)
        try:
            for one in self._files if error[0] is None else ():
                one.result()
        except OSError as problem:
            raise DataError(f"Cannot write into {self._output}: {problem.strerror or problem}.") from problem


def _flush(path: Path) -> None:
    handle = os.open(path, os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@dataclass(frozen=True)
class OutputFile:
    """A file that a part wrote: its path below the output, bytes, and SHA-256."""

    path: str
    bytes: int
    sha256: str


def write_output(output: Path, path: Path, content: bytes, *, flushed: bool = True) -> OutputFile:
    """Write a file below an output whole or not at all, and the folders above it.

    Raises
    ------
    DataError
        The disk is full, or the folder cannot be written to.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with written_file(path, overwrite=True, flushed=flushed) as file:
        file.write(content)
    name = path.relative_to(output).as_posix()
    return OutputFile(name, len(content), hashlib.sha256(content).hexdigest())


def output_file(output: Path, path: Path) -> OutputFile:
    """Of a file that is there."""
    sha, size = hashlib.sha256(), 0
    with path.open("rb") as file:
        while piece := file.read(1 << 20):
            sha.update(piece)
            size += len(piece)
    return OutputFile(path.relative_to(output).as_posix(), size, sha.hexdigest())


class RememberingFile:
    """A file for libraries in C that lose or only print why a write failed.

    The first error is kept for `check`; what is written after it goes nowhere.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._problem: OSError | None = None

    def check(self) -> None:
        """Raise the OSError that a write met."""
        if self._problem is not None:
            raise self._problem

    def write(self, content: Any) -> int:
        """All of it, or nothing after an error."""
        return int(self._tried(lambda: self._file.write(content), len(content)))

    def seek(self, offset: int, whence: int = 0) -> int:
        """As of a file; writes what was buffered."""
        return int(self._tried(lambda: self._file.seek(offset, whence), offset))

    def truncate(self, size: int | None = None) -> int:
        """As of a file."""
        return int(self._tried(lambda: self._file.truncate(size), size or 0))

    def flush(self) -> None:
        """As of a file."""
        self._tried(self._file.flush, None)

    def tell(self) -> int:
        """As of a file."""
        return int(self._tried(self._file.tell, 0))

    def read(self, size: int = -1) -> bytes:
        """As of a file."""
        return bytes(self._tried(lambda: self._file.read(size), b""))

    def readinto(self, buffer: Any) -> int:
        """As of a file."""
        return int(self._tried(lambda: self._file.readinto(buffer), 0))  # type: ignore[attr-defined]

    def _tried(self, action: Callable[[], Any], otherwise: Any) -> Any:
        if self._problem is None:
            try:
                return action()
            except OSError as problem:
                self._problem = problem
        return otherwise
