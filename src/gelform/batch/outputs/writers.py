"""The table of output forms: the writer of a part, the reader of a frame, and the files written at the end."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gelform.batch.outputs.files import OutputFile, PartTarget, PartWriter
from gelform.batch.outputs.frame_files import FrameFiles, read_npz, read_png
from gelform.batch.outputs.hdf5_files import (
    Hdf5Files,
    read_hdf5,
    write_hdf5_index,
)
from gelform.batch.outputs.lerobot import (
    LerobotVideo,
    read_lerobot,
    write_lerobot_set,
)
from gelform.batch.outputs.zarr_arrays import ZarrArrays, read_zarr
from gelform.exchange.exporters.quantised import depth_from_levels

Finish = Callable[[Path, list[str], Path], list[OutputFile]]


class Form(NamedTuple):
    """A form of outputs.

    Attributes
    ----------
    writer : of a part
    read : takes a row's output and index; returns the frame's depth, mm, or its levels; None if it was not kept
    finish : writes its additional files when all parts are done; takes the output, the files that the parts wrote, and
        the input's folder
    """

    writer: Callable[[PartTarget], PartWriter]
    read: Callable[[Path, int], NDArray[Any] | None]
    finish: Finish = lambda *_: []


WRITERS: dict[str, Form] = {
    "npz": Form(FrameFiles, read_npz),
    "png": Form(FrameFiles, read_png),
    "zarr": Form(ZarrArrays, read_zarr),
    "hdf5": Form(Hdf5Files, read_hdf5, write_hdf5_index),
    "lerobot": Form(LerobotVideo, read_lerobot, write_lerobot_set),
}


def depth_of_row(output: Path, form: str, row: Mapping[str, Any]) -> NDArray[np.float32] | None:
    """Depth (H, W), mm, NaN or 0 where unknown; None if the frame has an error or depth was not kept."""
    if not row["output"]:
        return None
    values = WRITERS[form].read(output / row["output"], int(row["index"]))
    if values is not None and values.dtype == np.uint16:
        return depth_from_levels(values)[0]
    return values
