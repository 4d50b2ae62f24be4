"""The seam of outputs: what a writer of a part is, and the forms that there are."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol

from gelform.batch.outputs.depth_video import DepthVideo
from gelform.batch.outputs.frame_files import FrameFiles
from gelform.batch.outputs.hdf5_files import INDEX, Hdf5Files, hdf5_index
from gelform.batch.outputs.places import OutputFile, Place
from gelform.batch.outputs.zarr_arrays import ZarrArrays
from gelform.npz_files import written_file
from gelform.reconstruction import Reconstruction


class PartWriter(Protocol):
    """Writes the results of a part, frame by frame; a context manager.

    Attributes
    ----------
    files : those that hold several frames, whole when the block has ended well. Where the block ends by an exception,
        nothing half-written is left under its name.
    """

    files: list[OutputFile]

    def prepared(self, result: Reconstruction) -> Any:
        """What `add` takes; raises what the result itself forbids, such as depth beyond 16 bits (DataError)."""

    def add(self, name: str, index: int, prepared: Any | None) -> dict[str, Any]:
        """Write the next frame, None where it has an error; raises DataError where it cannot be written.

        Gives what the row says: output, and bytes and sha256 where that is a file of its own.
        """

    def __enter__(self) -> PartWriter: ...

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None, /
    ) -> None: ...


WRITERS: dict[str, Callable[[Place], PartWriter]] = {
    "npz": FrameFiles,
    "png": FrameFiles,
    "zarr": ZarrArrays,
    "hdf5": Hdf5Files,
    "ffv1": DepthVideo,
}
FINISHED: dict[str, tuple[str, Callable[[Path, list[str]], bytes]]] = {"hdf5": (INDEX, hdf5_index)}


def finish_output(output: Path, form: str, files: list[str]) -> None:
    """Write what a form needs once all parts are done, from their files: HDF5's file of all sequences."""
    if form in FINISHED:
        name, content = FINISHED[form]
        with written_file(output / name, overwrite=True) as file:
            file.write(content(output, files))


def finished_problem(output: Path, form: str, files: list[str]) -> Path | None:
    """The file that `finish_output` wrote, where it is missing or has other bytes now."""
    if form not in FINISHED:
        return None
    name, content = FINISHED[form]
    path = output / name
    same = path.is_file() and path.read_bytes() == content(output, files)
    return None if same else path
