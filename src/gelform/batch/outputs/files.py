"""The settings of a batch, which determine its outputs' bytes; each file, and the maps of a result as they are written."""

from __future__ import annotations

import hashlib
import os
import sys
from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from gelform import DataError, Reconstruction
from gelform.batch.inputs import Part
from gelform.depth.integrate import checked_solver
from gelform.errors import cannot
from gelform.exchange.exporters.surface import MM_PER_LEVEL, UNKNOWN, ZERO_LEVEL, levels_from_depth
from gelform.foundations.checks import check_choice
from gelform.foundations.files import written_file
from gelform.result.maps import KEPT_MAPS, MAPS

FRAMES, PARTS = "frames", "parts"
KEPT, FORMATS = tuple(KEPT_MAPS), ("npz", "png", "zarr", "hdf5", "lerobot")
Maps = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class BatchSettings:
    """Settings of a batch; a continued run must have the same.

    Attributes
    ----------
    form : "npz" and "png", a file per frame; "zarr" and "hdf5", whose chunks are frames; "lerobot", a
        LeRobot data set with an additional column of depth
    keep : maps among KEPT; ("all",), only for npz: the whole result, which `gelform.load_result` reads
    dtype : of the kept maps; "uint16" is depth only, (v - 32768) x 1e-4 mm, 0 where unknown: always so in png, never in
        npz; in lerobot 1000 + depth in um
    solver : as of a `Reconstructor`
    background_frames : number of frames at the start of each sequence that are averaged as its background; 0: none
    bgr : whether the input's channels are in the order blue, green, red, as OpenCV writes an array
    part_frames : images in one part; a video or a recording is one part

    Raises
    ------
    ValueError
        A setting is invalid; the message says what was expected.
    """

    form: str = "npz"
    keep: tuple[str, ...] = ("depth", "known")
    solver: str = "auto"
    background_frames: int = 0
    part_frames: int = 256
    dtype: str = ""
    bgr: bool = False

    def __post_init__(self) -> None:
        check_choice(self.form, FORMATS, "a format")
        keeps_all = self.keep == ("all",)
        if not self.keep or not (keeps_all or set(self.keep) <= set(KEPT)):
            raise ValueError(f"Expected maps to keep among {', '.join(KEPT)}, or all, got {self.keep}.")
        if keeps_all and self.form != "npz":
            raise ValueError(
                f"Expected maps by name in {self.form}, got all. Whole results are written as npz."
            )
        usual = "uint16" if self.form in ("png", "lerobot") else "float32"
        object.__setattr__(self, "dtype", self.dtype or usual)
        check_choice(self.dtype, ("float32", "uint16"), "a dtype")
        if self.dtype != usual and self.form not in ("zarr", "hdf5"):
            raise ValueError(f"Expected {usual} in {self.form}, got {self.dtype}. Zarr and HDF5 hold either.")
        if self.dtype == "uint16" and set(self.keep) - {"depth", "known"}:
            raise ValueError(
                f"Expected depth alone in 16 bits, got {', '.join(self.keep)}. Write float32 as npz, zarr or hdf5."
            )
        checked_solver(self.solver)
        if not 0 <= self.background_frames <= 200:  # which are in memory together
            raise ValueError(f"Expected 0 to 200 frames for a background, got {self.background_frames}.")
        if self.part_frames < 1:
            raise ValueError(f"Expected at least one frame in a part, got {self.part_frames}.")

    @property
    def frames_in_a_part(self) -> int:
        """The largest number of images in a part; all of a sequence in LeRobot's form, where that is one file."""
        return sys.maxsize if self.form == "lerobot" else self.part_frames

    def facts(self) -> dict[str, Any]:
        """The settings for JSON."""
        return {**vars(self), "keep": list(self.keep)}


@dataclass(frozen=True)
class PartTarget:
    """The data about a part that a writer needs."""

    output: Path  # folder of the batch
    part: Part
    settings: BatchSettings
    shape: tuple[int, int]  # (H, W) of the maps
    facts: Mapping[str, Any]  # mm_per_px and calibration_digest, for the files' attributes

    @property
    def folder(self) -> Path:
        """The folder of the part's film."""
        return self.output / FRAMES / self.part.film.name


class FlushedLater(AbstractContextManager["FlushedLater"]):
    """Flushes files to the disk in the background; the end of the context waits until the disk has them all.

    Otherwise a worker would wait for the disk after every frame. If power fails before, the part has no record and is done
    again. DataError if the disk rejected a file.
    """

    def __init__(self, output: Path) -> None:
        self._output = output
        self._flushing = ThreadPoolExecutor(4)
        self._files: list[Future[None]] = []

    def write(self, path: Path, content: bytes) -> OutputFile:
        """Write a file completely or not at all; makes its folders."""
        written = write_output(self._output, path, content, flushed=False)
        self._files.append(self._flushing.submit(_flush, path))
        return written

    def __exit__(self, *error: object) -> None:
        self._flushing.shutdown(cancel_futures=error[0] is not None)
        with cannot(f"write into {self._output}"):
            for one in self._files if error[0] is None else ():
                one.result()


def _flush(path: Path) -> None:
    handle = os.open(path, os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@dataclass(frozen=True)
class OutputFile:
    """A file that a part wrote: its path below the output, size in bytes, and SHA-256."""

    path: str
    bytes: int
    sha256: str


def write_output(output: Path, path: Path, content: bytes, *, flushed: bool = True) -> OutputFile:
    """Write a file below an output completely or not at all (DataError); makes its folders."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with written_file(path, overwrite=True, flushed=flushed) as file:
        file.write(content)
    name = path.relative_to(output).as_posix()
    return OutputFile(name, len(content), hashlib.sha256(content).hexdigest())


def output_file(output: Path, path: Path) -> OutputFile:
    """The entry of an existing file."""
    sha, size = hashlib.sha256(), 0
    with path.open("rb") as file:
        while piece := file.read(1 << 20):
            sha.update(piece)
            size += len(piece)
    return OutputFile(path.relative_to(output).as_posix(), size, sha.hexdigest())


class PartWriter(AbstractContextManager["PartWriter"]):
    """Writes the results of a part, frame by frame; a context manager.

    `files` are the files with several frames, complete once the context ended without an error. After an exception no
    partial file has its final name.
    """

    def __init__(self, target: PartTarget) -> None:
        self.files: list[OutputFile] = []
        self._target = target

    def prepared(self, result: Reconstruction) -> Any:
        """The argument of `add`; raises DataError for a result that the form cannot hold, such as depth beyond 16 bits."""
        return maps_of(result, self._target.settings)

    @abstractmethod
    def add(self, name: str, index: int, prepared: Any | None) -> dict[str, Any]:
        """Write the next frame, or None for a frame with an error; DataError if it cannot be written.

        Returns the row's columns: output, and bytes and sha256 if the frame has its own file.
        """

    @abstractmethod
    def __exit__(self, *error: Any) -> None:
        """Finish complete files, or leave none."""

    def _row(self, path: Path, prepared: Any | None) -> dict[str, Any]:
        """The row of a frame in a shared file."""
        return {} if prepared is None else {"output": path.relative_to(self._target.output).as_posix()}


def _remembering(name: str, otherwise: Callable[..., Any]) -> Any:
    """The method of a file until one fails; from then on `otherwise` answers."""

    def method(self: RememberingFile, *args: Any) -> Any:
        if self.problem is None:
            try:
                return getattr(self.file, name)(*args)
            except OSError as problem:
                self.problem = problem
        return otherwise(*args)

    return method


class RememberingFile:
    """A file for C libraries that lose the reason of a failed write or only print it.

    The first error is kept for `check`; later writes are ignored.
    """

    def __init__(self, file: BinaryIO) -> None:
        self.file = file
        self.problem: OSError | None = None

    def check(self) -> None:
        """Raise the OSError of a failed write."""
        if self.problem is not None:
            raise self.problem

    write = _remembering("write", len)
    seek = _remembering("seek", lambda offset, whence=0: offset)
    truncate = _remembering("truncate", lambda size=None: size or 0)
    flush = _remembering("flush", lambda: None)
    tell = _remembering("tell", lambda: 0)
    read = _remembering("read", lambda size=-1: b"")
    readinto = _remembering("readinto", lambda buffer: 0)


def maps_of(result: Reconstruction, settings: BatchSettings) -> dict[str, NDArray[Any]]:
    """The kept maps by name, (H, W) or with trailing axes; depth as uint16 levels if the settings say so.

    DataError for depth beyond 16 bits, or a map that this calibration does not provide.
    """
    if settings.dtype == "uint16":
        return {"depth_mm": levels_from_depth(result.depth_mm, result.known)}
    maps = {}
    for name in (KEPT_MAPS[one].name for one in settings.keep):
        if (values := getattr(result, name)) is None:
            raise DataError(f"This calibration gives no {name}. Leave it out of --keep.")
        maps[name] = np.asarray(values)
    return maps


def blank_maps(settings: BatchSettings, shape: tuple[int, int]) -> dict[str, NDArray[Any]]:
    """The maps of a frame with an error: NaN, False, or level 0, which means unknown."""
    if settings.dtype == "uint16":
        return {"depth_mm": np.full(shape, UNKNOWN, dtype=np.uint16)}
    kept, blank = [KEPT_MAPS[name] for name in settings.keep], {"bool": False, "float32": np.nan}
    return {one.name: np.full((*shape, *one.axes), blank[one.dtype], one.dtype) for one in kept}


def attributes_of(name: str, settings: BatchSettings) -> dict[str, Any]:
    """Unit of a map, and conversion of levels to mm: scale_factor x level + add_offset, as in the CF conventions."""
    if settings.dtype == "uint16":
        return {"unit": "mm", "scale_factor": MM_PER_LEVEL, "add_offset": -ZERO_LEVEL * MM_PER_LEVEL}
    return {"unit": MAPS[name].unit}


def facts_of(result: Reconstruction) -> dict[str, Any]:
    """The numbers of a result with a scale, its force and findings; only findings if depth is known in no pixel."""
    health = " ".join(dict.fromkeys(finding.name for finding in result.health))
    if (found := result.numbers) is None:
        return {"health": health}
    return {
        "deepest_mm": result.peak_mm,  # refuses a result without a scale
        "deepest_x_px": found.x_px,
        "deepest_y_px": found.y_px,
        "contact_mm2": found.area,
        "volume_mm3": found.volume,
        "contacts": found.contacts,
        **result.force.columns(),
        "health": health,
    }


def check_names(sequences: Iterable[str], settings: BatchSettings) -> None:
    """Refuse (DataError) folders with the names of arrays next to them."""
    if settings.form not in ("zarr", "hdf5"):
        return
    for sequence in sequences:
        if taken := {one.name for one in KEPT_MAPS.values()} & set(sequence.split("/")):
            raise DataError(
                f"The input {sequence} would lie where an array {taken.pop()} does. Rename it, or write npz."
            )
