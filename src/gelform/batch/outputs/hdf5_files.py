"""HDF5: one file per part, and one file that presents each sequence as a whole.

`frames/<sequence>/<first frame>.h5` has a dataset per map, with one compressed chunk per frame. `frames.h5` is written when
all parts are done. It has a group per sequence with virtual datasets that refer to the parts' files.
"""

from __future__ import annotations

import io
from contextlib import ExitStack
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.batch.outputs.files import (
    FRAMES,
    Maps,
    OutputFile,
    PartTarget,
    PartWriter,
    RememberingFile,
    attributes_of,
    blank_maps,
    output_file,
    write_output,
)
from gelform.errors import needed
from gelform.foundations.npz_files import written_file

INDEX = "frames.h5"
COMPRESSION = {"compression": "gzip", "compression_opts": 1, "shuffle": True}  # every HDF5 reader knows it


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
                shape=(self._target.part.frames, *blank.shape),
                maxshape=(None, *blank.shape),
                chunks=(1, *blank.shape),
                dtype=blank.dtype,
                fillvalue=blank.flat[0],
                **COMPRESSION,
            )
            dataset.attrs.update({**attributes_of(name, self._target.settings), **self._target.facts})
        return self

    def __exit__(self, *error: Any) -> None:
        self._open.__exit__(*error)  # a full disk becomes a DataError of `written_file`
        if error[0] is None:
            self.files.append(output_file(self._target.output, self._path))


def write_hdf5_index(output: Path, files: list[str], source: Path) -> list[OutputFile]:
    """Write the file of all sequences."""
    return [write_output(output, output / INDEX, hdf5_index(output, files))]


def hdf5_index(output: Path, files: list[str]) -> bytes:
    """The file of all sequences: virtual datasets with relative paths of the parts' files."""
    h5py, content = needed("h5py", "data", "HDF5"), io.BytesIO()
    sequences: dict[str, list[str]] = {}
    for name in files:
        sequences.setdefault(PurePosixPath(name).parent.relative_to(FRAMES).as_posix(), []).append(name)
    with h5py.File(content, "w") as file:
        for sequence, parts in sequences.items():
            _add_sequence(h5py, file.require_group("/" if sequence == "." else sequence), output, parts)
    return content.getvalue()


def _add_sequence(h5py: Any, group: Any, output: Path, files: list[str]) -> None:
    lengths, kinds = [], {}
    for name in files:
        with h5py.File(output / name, "r") as part:
            kinds = {one: (d.shape, d.dtype, d.fillvalue, dict(d.attrs)) for one, d in part.items()}
            lengths.append(max((len(dataset) for dataset in part.values()), default=0))
    for one, (shape, dtype, fill, attributes) in kinds.items():
        layout, begin = h5py.VirtualLayout((sum(lengths), *shape[1:]), dtype), 0
        layout.dcpl.set_obj_track_times(False)  # the same bytes at any time
        for name, length in zip(files, lengths):
            layout[begin : begin + length] = h5py.VirtualSource(name, one, (length, *shape[1:]))
            begin += length
        group.create_virtual_dataset(one, layout, fillvalue=fill).attrs.update(attributes)


def read_hdf5(path: Path, index: int) -> NDArray[Any] | None:
    """Depth of a frame, or its levels, read back from the part's file."""
    with needed("h5py", "data", "HDF5").File(path, "r") as file:
        return np.asarray(file["depth_mm"][index - int(path.stem)]) if "depth_mm" in file else None
