"""The settings of a batch, which determine its outputs' bytes; each file, and maps as arrays in HDF5 and Zarr.

For HDF5 `frames/<sequence>/<first frame>.h5` has a dataset per map, with one compressed chunk per frame. `frames.h5` is
written when all parts are done. It has a group per sequence with virtual datasets that refer to the parts' files.

For Zarr the folder `frames/` is a version 3 group; sequences are groups below it. Each of their arrays, one per map, has
one shard file per run of frames, with one compressed chunk per frame. A shard ("sharding_indexed" of the Zarr
specification, version 3) contains the compressed frames, then (offset, size) of each as little-endian uint64, and a CRC-32C
of those numbers. This module writes the shards itself: each is one file that appears complete, and its bytes depend only on
the frames. zarr's own writer took several times as long per frame (`benchmarks/batch.py`).
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import sys
from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from gelform import DataError
from gelform.batch.inputs import Part
from gelform.errors import cannot, needed
from gelform.exchange.exporters.surface import MM_PER_LEVEL, UNKNOWN, ZERO_LEVEL, levels_from_depth
from gelform.foundations.checks import check_choice
from gelform.foundations.files import written_file
from gelform.result import Reconstruction
from gelform.result.maps import KEPT_MAPS, MAPS

FILES_IN_PART = 16  # a killed run loses the frames of a part: a second of work
FRAMES, PARTS, SHEET = "frames", "parts", "sheet.png"
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
    background_frames : number of frames at the start of each sequence that are averaged as its background; 0: none
    bgr : whether the input's channels are in the order blue, green, red, as OpenCV writes an array
    part_frames : images in one part, at most 16 for npz and png; a video or a recording is one part

    Raises
    ------
    ValueError
        A setting is invalid; the message says what was expected.
    """

    form: str = "npz"
    keep: tuple[str, ...] = ("depth", "known")
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
        if not 0 <= self.background_frames <= 200:  # which are in memory together
            raise ValueError(f"Expected 0 to 200 frames for a background, got {self.background_frames}.")
        if self.part_frames < 1:
            raise ValueError(f"Expected at least one frame in a part, got {self.part_frames}.")

    @property
    def frames_in_a_part(self) -> int:
        """The largest number of images in a part: few where each has a file of its own; for LeRobot all of a sequence."""
        if self.form in ("npz", "png"):
            return min(self.part_frames, FILES_IN_PART)
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


INDEX = "frames.h5"


class Hdf5Files(PartWriter):
    """Writes a part's file frame by frame; the file gets its name when the part is done."""

    def __init__(self, target: PartTarget) -> None:
        super().__init__(target)
        self._h5py = needed("h5py", "data", "HDF5")
        self._path = target.folder / f"{target.part.start:08d}.h5"
        self._blank = blank_maps(target.settings, target.shape)
        self._open = ExitStack()
        self._count = 0

    def add(self, name: str, index: int, prepared: Maps | None) -> dict[str, Any]:
        """Write a frame's maps; NaN, False or level 0 for a frame with an error."""
        for map_name, values in (prepared or self._blank).items():
            dataset = self._file[map_name]
            if self._count == len(dataset):  # for a video, whose frames were not counted
                dataset.resize(self._count + 1, axis=0)
            dataset[self._count] = values
        self._handle.check()
        self._count += 1
        return self._row(self._path, prepared)

    def __enter__(self) -> Hdf5Files:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._handle = RememberingFile(self._open.enter_context(written_file(self._path, overwrite=True)))
        self._open.callback(self._handle.check)
        self._file = self._open.enter_context(self._h5py.File(self._handle, "w"))
        for name, blank in self._blank.items():
            dataset = self._file.create_dataset(
                name,
                shape=(self._target.part.count, *blank.shape),
                maxshape=(None, *blank.shape),
                chunks=(1, *blank.shape),
                dtype=blank.dtype,
                fillvalue=blank.flat[0],
                compression="gzip",  # which every HDF5 reader knows
                compression_opts=1,
                shuffle=True,
            )
            dataset.attrs.update({**attributes_of(name, self._target.settings), **self._target.facts})
        return self

    def __exit__(self, *error: Any) -> None:
        self._open.__exit__(*error)  # a full disk becomes a DataError of `written_file`
        if error[0] is None:
            self.files.append(output_file(self._target.output, self._path))


def write_hdf5_index(output: Path, files: list[str], source: Path) -> list[OutputFile]:
    """Write the file of all sequences: virtual datasets with relative paths of the parts' files."""
    h5py, content = needed("h5py", "data", "HDF5"), io.BytesIO()
    sequences: dict[str, list[str]] = {}
    for name in files:
        sequences.setdefault(PurePosixPath(name).parent.relative_to(FRAMES).as_posix(), []).append(name)
    with h5py.File(content, "w") as file:
        for sequence, parts in sequences.items():
            group, lengths, kinds = file.require_group("/" if sequence == "." else sequence), [], {}
            for name in parts:
                with h5py.File(output / name, "r") as part:
                    kinds = {one: (d.shape, d.dtype, d.fillvalue, dict(d.attrs)) for one, d in part.items()}
                    lengths.append(max((len(dataset) for dataset in part.values()), default=0))
            for one, (shape, dtype, fill, attributes) in kinds.items():
                layout, begin = h5py.VirtualLayout((sum(lengths), *shape[1:]), dtype), 0
                layout.dcpl.set_obj_track_times(False)  # the same bytes at any time
                for name, length in zip(parts, lengths):
                    layout[begin : begin + length] = h5py.VirtualSource(name, one, (length, *shape[1:]))
                    begin += length
                group.create_virtual_dataset(one, layout, fillvalue=fill).attrs.update(attributes)
    return [write_output(output, output / INDEX, content.getvalue())]


def read_hdf5(path: Path, index: int) -> NDArray[Any] | None:
    """Depth of a frame, or its levels, read back from the part's file."""
    with needed("h5py", "data", "HDF5").File(path, "r") as file:
        return np.asarray(file["depth_mm"][index - int(path.stem)]) if "depth_mm" in file else None


BLOSC: dict[str, Any] = {"cname": "lz4", "clevel": 1, "shuffle": "bitshuffle", "blocksize": 0}
NODE = "zarr.json"


class ZarrArrays(PartWriter):
    """Writes frames/<sequence>/<map>/c/<shard>/..., each shard when it is full; memory does not grow with a video."""

    def __init__(self, target: PartTarget) -> None:
        super().__init__(target)
        blosc = needed("numcodecs.blosc", "data", "Zarr")
        needed("google_crc32c", "data", "Zarr")
        blosc.use_threads = False  # the same bytes each time, and no threads besides the workers
        self._later = FlushedLater(target.output)
        self._length = shard_frames(target.settings.part_frames)
        self._chunks: dict[str, list[bytes]] = {}
        self._blank = blank_maps(target.settings, target.shape)
        self._count = target.part.start

    def prepared(self, result: Reconstruction) -> dict[str, bytes]:
        """Each map as a compressed chunk."""
        from numcodecs import blosc

        chunks = {}
        for name, values in maps_of(result, self._target.settings).items():
            flat = np.ascontiguousarray(values, values.dtype.newbyteorder("<")).reshape(-1).view(np.uint8)
            how = BLOSC["cname"].encode(), BLOSC["clevel"], blosc.BITSHUFFLE
            chunks[name] = bytes(blosc.compress(flat, *how, typesize=values.dtype.itemsize))
        return chunks

    def add(self, name: str, index: int, prepared: dict[str, bytes] | None) -> dict[str, Any]:
        """Add a frame; a frame with an error is a missing chunk, which reads as NaN, False or level 0."""
        for one in self._blank:
            self._chunks.setdefault(one, []).append(b"" if prepared is None else prepared[one])
        self._count += 1
        if self._count % self._length == 0:
            self._write_shards()
        return self._row(self._target.folder, prepared)

    def _write_shards(self) -> None:
        number = (self._count - 1) // self._length
        for name, chunks in self._chunks.items():
            zeros = "/0" * self._blank[name].ndim
            path = self._target.folder / name / f"c/{number}{zeros}"
            if not any(chunks):
                path.unlink(missing_ok=True)  # frames that were readable when the part was done before
            else:
                self.files.append(self._later.write(path, shard_bytes(chunks, self._length)))
        self._chunks = {}

    def __exit__(self, *error: Any) -> None:
        if error[0] is not None:
            self._later.__exit__(*error)
            return
        target, film = self._target, self._target.part.film
        with self._later:
            if self._chunks:
                self._write_shards()
            # Every part of a sequence writes the same bytes of the arrays' metadata, and of those of the groups above.
            for name, blank in self._blank.items():
                attributes = {**attributes_of(name, target.settings), **target.facts}
                node = _array_node(blank, film.count or self._count, self._length, attributes)
                self.files.append(self._later.write(target.folder / name / NODE, _json(node)))
            group = _json({"zarr_format": 3, "node_type": "group", "attributes": {}})
            for above in (film.name, *map(str, PurePosixPath(film.name).parents)):
                self.files.append(self._later.write(target.output / FRAMES / above / NODE, group))


def shard_frames(part_frames: int) -> int:
    """Frames in a shard: the largest divisor of the part's frames up to 64, so that no shard belongs to two parts."""
    return max(n for n in range(1, 65) if part_frames % n == 0)


def shard_bytes(chunks: list[bytes], length: int) -> bytes:
    """A shard with `length` places; empty chunks, and places after the last chunk, are missing: the fill value."""
    import google_crc32c

    index = np.full((length, 2), 2**64 - 1, dtype="<u8")
    offset = 0
    for k, chunk in enumerate(chunks):
        if chunk:
            index[k] = offset, len(chunk)
            offset += len(chunk)
    trailer = index.tobytes()
    return b"".join([*chunks, trailer, google_crc32c.value(trailer).to_bytes(4, "little")])


def _array_node(blank: NDArray[Any], frames: int, length: int, attributes: dict[str, Any]) -> dict[str, Any]:
    shape = list(blank.shape)
    order = {"name": "bytes", "configuration": {"endian": "little"}}
    blosc = {"name": "blosc", "configuration": {**BLOSC, "typesize": blank.dtype.itemsize}}
    sharding = {
        "chunk_shape": [1, *shape],
        "codecs": [order, blosc],
        "index_codecs": [order, {"name": "crc32c"}],
        "index_location": "end",
    }
    return {
        "zarr_format": 3,
        "node_type": "array",
        "shape": [frames, *shape],
        "data_type": blank.dtype.name,
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [length, *shape]}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
        "fill_value": {"f": "NaN", "b": False, "u": 0}[blank.dtype.kind],
        "codecs": [{"name": "sharding_indexed", "configuration": sharding}],
        "dimension_names": ["frame", "y", "x", "axis"][: len(shape) + 1],
        "attributes": attributes,
    }


def _json(content: dict[str, Any]) -> bytes:
    return (json.dumps(content, indent=1) + "\n").encode()


def read_zarr(path: Path, index: int) -> NDArray[Any] | None:
    """Depth of a frame, or its levels, read back through the shard's index."""
    folder = path / "depth_mm"
    if not folder.is_dir():
        return None
    node = json.loads((folder / NODE).read_bytes())
    length, height, width = node["chunk_grid"]["configuration"]["chunk_shape"]
    content = (folder / f"c/{index // length}/0/0").read_bytes()
    index_in_file = np.frombuffer(content[-16 * length - 4 : -4], "<u8").reshape(length, 2)
    offset, size = map(int, index_in_file[index % length])
    values = needed("numcodecs.blosc", "data", "Zarr").decompress(content[offset : offset + size])
    return np.frombuffer(values, node["data_type"]).reshape(height, width)
