"""Where a part's outputs go, what is recorded of each file, and the maps of a result as they are written."""

from __future__ import annotations

import hashlib
import os
from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from gelform.batch.inputs.plan import Part
from gelform.batch.settings import BatchSettings
from gelform.errors import DataError
from gelform.exporters.quantised import MM_PER_LEVEL, UNKNOWN, ZERO_LEVEL, levels_from_depth
from gelform.foundations.npz_files import written_file
from gelform.reconstruction import Reconstruction
from gelform.reconstruction.maps import KEPT_MAPS, MAPS, ResultMap

FRAMES, PARTS = "frames", "parts"
FLUSHED_AT_ONCE = 4  # threads that wait for the disk
LEVELS = {"unit": "mm", "scale_factor": MM_PER_LEVEL, "add_offset": -ZERO_LEVEL * MM_PER_LEVEL}
Maps = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class PartTarget:
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
        """Write a file whole or not at all."""
        return write_output(self.output, path, content)


class FlushedLater:
    """Files that are flushed to the disk beside the work; a context manager, whose block ends when the disk has them all.

    A worker would wait for the disk after every frame. What a loss of power takes before is a part without its record, which
    is done again. DataError where the disk has not taken one of them.
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
    """Write a file below an output whole or not at all (DataError), and the folders above it."""
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


class PartWriter(AbstractContextManager["PartWriter"]):
    """Writes the results of a part, frame by frame; a context manager.

    Attributes
    ----------
    files : those that hold several frames, whole when the block has ended well. Where the block ends by an exception,
        nothing half-written is left under its name.
    """

    def __init__(self, target: PartTarget) -> None:
        self.files: list[OutputFile] = []
        self._target = target

    def prepared(self, result: Reconstruction) -> Any:
        """What `add` takes; raises what the result itself forbids, such as depth beyond 16 bits (DataError)."""
        return maps_of(result, self._target.settings)

    @abstractmethod
    def add(self, name: str, index: int, prepared: Any | None) -> dict[str, Any]:
        """Write the next frame, None where it has an error; raises DataError where it cannot be written.

        Gives what the row says: output, and bytes and sha256 where that is a file of its own.
        """

    @abstractmethod
    def __exit__(self, *error: Any) -> None:
        """Leave whole files, or none."""

    def _row(self, path: Path, prepared: Any | None) -> dict[str, Any]:
        """Of a frame in a file of several."""
        return {} if prepared is None else {"output": self._target.name_of(path)}


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
        return int(self._tried(self._file.write, content, otherwise=len(content)))

    def seek(self, offset: int, whence: int = 0) -> int:
        """As of a file; writes what was buffered."""
        return int(self._tried(self._file.seek, offset, whence, otherwise=offset))

    def truncate(self, size: int | None = None) -> int:
        """As of a file."""
        return int(self._tried(self._file.truncate, size, otherwise=size or 0))

    def flush(self) -> None:
        """As of a file."""
        self._tried(self._file.flush, otherwise=None)

    def tell(self) -> int:
        """As of a file."""
        return int(self._tried(self._file.tell, otherwise=0))

    def read(self, size: int = -1) -> bytes:
        """As of a file."""
        return bytes(self._tried(self._file.read, size, otherwise=b""))

    def readinto(self, buffer: Any) -> int:
        """As of a file."""
        return int(self._tried(self._file.readinto, buffer, otherwise=0))  # type: ignore[attr-defined]

    def _tried(self, action: Callable[..., Any], *args: Any, otherwise: Any) -> Any:
        if self._problem is None:
            try:
                return action(*args)
            except OSError as problem:
                self._problem = problem
        return otherwise


def maps_of(result: Reconstruction, settings: BatchSettings) -> dict[str, NDArray[Any]]:
    """The kept maps by their names in files, (H, W) or with axes behind; depth as uint16 levels where the settings say so.

    DataError for depth beyond 16 bits, or a map that this calibration does not give.
    """
    if settings.dtype == "uint16":
        return {"depth_mm": levels_from_depth(result.depth_mm, result.known)}
    return {one.name: _map(result, one.name) for one in _kept(settings)}


def blank_maps(settings: BatchSettings, shape: tuple[int, int]) -> dict[str, NDArray[Any]]:
    """The maps of a frame that could not be done: NaN, False, or level 0, which means unknown."""
    if settings.dtype == "uint16":
        return {"depth_mm": np.full(shape, UNKNOWN, dtype=np.uint16)}
    blank = {"bool": False, "float32": np.nan}
    return {one.name: np.full((*shape, *one.axes), blank[one.dtype], one.dtype) for one in _kept(settings)}


def attributes_of(name: str, settings: BatchSettings) -> dict[str, Any]:
    """Unit of a map, and how levels are turned to mm: scale_factor x level + add_offset, the names of the CF conventions."""
    if settings.dtype == "uint16":
        return dict(LEVELS)
    return {"unit": MAPS[name].unit}


def facts_of(result: Reconstruction) -> dict[str, Any]:
    """Deepest point (mm, and its pixel), area (mm^2) and volume (mm^3) of all contacts, their number, findings' names.

    Where depth is known in no pixel all but the names are left out.
    """
    health = " ".join(dict.fromkeys(finding.name for finding in result.health))
    if not result.known.any():
        return {"health": health}
    depth_mm = result.depth_mm
    deepest_y, deepest_x = divmod(int(depth_mm.argmax()), depth_mm.shape[1])
    return {
        "deepest_mm": float(depth_mm[deepest_y, deepest_x]),
        "deepest_x_px": deepest_x,
        "deepest_y_px": deepest_y,
        "contact_mm2": float(sum(one.area_mm2 or 0.0 for one in result.contacts)),
        "volume_mm3": float(sum(one.volume_mm3 or 0.0 for one in result.contacts)),
        "contacts": len(result.contacts),
        "health": health,
    }


def check_names(sequences: Iterable[str], settings: BatchSettings) -> None:
    """Refuse (DataError) folders that are called as the arrays beside them would be."""
    if settings.form not in ("zarr", "hdf5"):
        return
    arrays = {one.name for one in KEPT_MAPS.values()}
    for sequence in sequences:
        if taken := arrays & set(sequence.split("/")):
            raise DataError(
                f"The input {sequence} would lie where an array {taken.pop()} does. Rename it, or write npz."
            )


def _kept(settings: BatchSettings) -> list[ResultMap]:
    return [KEPT_MAPS[name] for name in settings.keep]


def _map(result: Reconstruction, name: str) -> NDArray[Any]:
    values = getattr(result, name)
    if values is None:
        raise DataError(f"This calibration gives no {name}. Leave it out of --keep.")
    return np.asarray(values)
