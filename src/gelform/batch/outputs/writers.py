"""The seam of outputs: what a writer of a part is, and the forms that there are."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Protocol

from gelform.batch.outputs.depth_video import DepthVideo
from gelform.batch.outputs.frame_files import FrameFiles
from gelform.batch.outputs.hdf5_files import Hdf5Files, no_hdf5_index, write_hdf5_index, wrong_hdf5_index
from gelform.batch.outputs.lerobot_out import (
    names_of_set,
    set_is_missing,
    write_lerobot_set,
    wrong_file_of_set,
)
from gelform.batch.outputs.lerobot_video import LerobotVideo
from gelform.batch.outputs.places import OutputFile, Place
from gelform.batch.outputs.zarr_arrays import ZarrArrays
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
    "lerobot": LerobotVideo,
}


class Finish(NamedTuple):
    """What a form has beside the parts' files, made when all of them are done.

    Attributes
    ----------
    write : takes the output, the files that the parts wrote, and the input's folder
    missing : takes the output; whether a file of it is not there, at a glance
    wrong : takes the output and the parts' files; the first file of it that is missing or has other bytes now
    names : takes the output; the paths below it of what was written among the frames
    """

    write: Callable[[Path, list[str], Path], None]
    missing: Callable[[Path], bool]
    wrong: Callable[[Path, list[str]], Path | None]
    names: Callable[[Path], set[str]] = lambda _: set()


FINISHED: dict[str, Finish] = {
    "hdf5": Finish(write_hdf5_index, no_hdf5_index, wrong_hdf5_index),
    "lerobot": Finish(write_lerobot_set, set_is_missing, wrong_file_of_set, names_of_set),
}
NO_FINISH = Finish(lambda *_: None, lambda _: False, lambda *_: None)


def finish_of(form: str) -> Finish:
    """That of a form; one that does nothing where the parts' files are all."""
    return FINISHED.get(form, NO_FINISH)
