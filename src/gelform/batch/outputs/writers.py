"""The table of output forms: the writer of a part, the reader of a frame, and the files written at the end."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gelform.batch.outputs.files import PartTarget, PartWriter
from gelform.batch.outputs.frame_files import FrameFiles, read_npz, read_png
from gelform.batch.outputs.hdf5_files import (
    Hdf5Files,
    no_hdf5_index,
    read_hdf5,
    write_hdf5_index,
    wrong_hdf5_index,
)
from gelform.batch.outputs.lerobot import (
    LerobotVideo,
    names_of_set,
    read_lerobot,
    set_is_missing,
    write_lerobot_set,
    wrong_file_of_set,
)
from gelform.batch.outputs.zarr_arrays import ZarrArrays, read_zarr
from gelform.exchange.exporters.quantised import depth_from_levels


class Finish(NamedTuple):
    """The additional files of a form, made when all parts are done; none by default.

    Attributes
    ----------
    write : takes the output, the files that the parts wrote, and the input's folder
    missing : takes the output; quick check whether one of its files is missing
    wrong : takes the output and the parts' files; the first of its files that is missing or has changed
    names : takes the output; paths below it of its files among the frames
    """

    write: Callable[[Path, list[str], Path], None] = lambda *_: None
    missing: Callable[[Path], bool] = lambda _: False
    wrong: Callable[[Path, list[str]], Path | None] = lambda *_: None
    names: Callable[[Path], set[str]] = lambda _: set()


class Form(NamedTuple):
    """A form of outputs.

    Attributes
    ----------
    writer : of a part
    read : takes a row's output and index; returns the frame's depth, mm, or its levels; None if it was not kept
    finish : its additional files
    """

    writer: Callable[[PartTarget], PartWriter]
    read: Callable[[Path, int], NDArray[Any] | None]
    finish: Finish = Finish()


HDF5_FINISH = Finish(write_hdf5_index, no_hdf5_index, wrong_hdf5_index)
LEROBOT_FINISH = Finish(write_lerobot_set, set_is_missing, wrong_file_of_set, names_of_set)
WRITERS: dict[str, Form] = {
    "npz": Form(FrameFiles, read_npz),
    "png": Form(FrameFiles, read_png),
    "zarr": Form(ZarrArrays, read_zarr),
    "hdf5": Form(Hdf5Files, read_hdf5, HDF5_FINISH),
    "lerobot": Form(LerobotVideo, read_lerobot, LEROBOT_FINISH),
}


def depth_of_row(output: Path, form: str, row: Mapping[str, Any]) -> NDArray[np.float32] | None:
    """Depth (H, W), mm, NaN or 0 where unknown; None if the frame has an error or depth was not kept."""
    if not row["output"]:
        return None
    values = WRITERS[form].read(output / row["output"], int(row["index"]))
    if values is not None and values.dtype == np.uint16:
        return depth_from_levels(values)[0]
    return values
