"""Maps as arrays: HDF5, one file per part and one that presents each sequence as a whole; Zarr, one array per map.

`frames/<sequence>/<first frame>.h5` has a dataset per map, with one compressed chunk per frame. `frames.h5` is written when
all parts are done. It has a group per sequence with virtual datasets that refer to the parts' files.

For Zarr the folder `frames/` is a version 3 group; sequences are groups below it. Each of their arrays, one per map, has one
shard file per run of frames, with one compressed chunk per frame. A shard ("sharding_indexed" of the Zarr
specification, version 3) contains the compressed frames, then (offset, size) of each as little-endian uint64, and a CRC-32C
of those numbers. This module writes the shards itself: each is one file that appears complete, and its bytes depend only on
the frames. zarr's own writer took several times as long per frame (`benchmarks/batch.py`).
"""

from __future__ import annotations

import io
import json
from contextlib import ExitStack
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.batch.outputs.files import (
    FRAMES,
    FlushedLater,
    Maps,
    OutputFile,
    PartTarget,
    PartWriter,
    RememberingFile,
    attributes_of,
    blank_maps,
    maps_of,
    output_file,
    write_output,
)
from gelform.errors import needed
from gelform.foundations.files import written_file
from gelform.result import Reconstruction

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
        with self._later:
            if self._chunks:
                self._write_shards()
            self._write_nodes()

    def _write_nodes(self) -> None:
        """Write the metadata of the arrays and of the groups above; every part of a sequence writes the same bytes."""
        target, frames = self._target, self._target.part.film.count or self._count
        for name, blank in self._blank.items():
            attributes = {**attributes_of(name, target.settings), **target.facts}
            node = _array_node(blank, frames, self._length, attributes)
            self.files.append(self._later.write(target.folder / name / NODE, _json(node)))
        group = _json({"zarr_format": 3, "node_type": "group", "attributes": {}})
        for above in (target.part.film.name, *map(str, PurePosixPath(target.part.film.name).parents)):
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
