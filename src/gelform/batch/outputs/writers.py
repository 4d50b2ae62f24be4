"""The table of output forms: the writer of a part, the reader of a frame, the files at the end; one file per frame."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.batch.outputs.files import (
    FlushedLater,
    Hdf5Files,
    OutputFile,
    PartTarget,
    PartWriter,
    ZarrArrays,
    maps_of,
    output_file,
    read_hdf5,
    read_zarr,
    write_hdf5_index,
)
from gelform.batch.outputs.lerobot import LerobotVideo, read_lerobot, write_lerobot_set
from gelform.exchange.exporters.surface import depth_from_levels
from gelform.foundations.files import FAST_PNG, npz_bytes, picture_bytes
from gelform.result import Reconstruction, save_result


class FrameFiles(PartWriter):
    """Writes frames/<sequence>/<frame>.npz or .png."""

    def __init__(self, target: PartTarget) -> None:
        super().__init__(target)
        self._later = FlushedLater(target.output)

    def prepared(self, result: Reconstruction) -> bytes | Reconstruction:
        """The file's bytes; the whole result if everything is kept."""
        settings = self._target.settings
        if settings.form == "png":
            # 10 % faster and 5 % smaller than other PNG: the low bits of depth are noise without patterns longer than a run.
            return picture_bytes(maps_of(result, settings)["depth_mm"], settings=FAST_PNG)
        if settings.keep == ("all",):
            return result
        # Without a digest: the part's record has the file's.
        meta = {"calibration_digest": result.calibration_digest, "index": result.index}
        scale = np.asarray(result.mm_per_px, dtype=np.float64)
        maps = {**maps_of(result, settings), "mm_per_px": scale}
        return npz_bytes(maps, meta, kind="gelform maps", version=1)

    def add(self, name: str, index: int, prepared: bytes | Reconstruction | None) -> dict[str, Any]:
        """Write the frame's file; nothing for a frame with an error."""
        if prepared is None:
            return {}
        path = self._target.folder / f"{name}.{self._target.settings.form}"
        if isinstance(prepared, bytes):
            file = self._later.write(path, prepared)
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            save_result(prepared, path, overwrite=True)
            file = output_file(self._target.output, path)
        return {"output": file.path, "bytes": file.bytes, "sha256": file.sha256}

    def __exit__(self, *error: Any) -> None:
        self._later.__exit__(*error)


def read_npz(path: Path, index: int) -> NDArray[Any] | None:
    """Depth of a frame, read back from its file."""
    with np.load(path) as file:
        return np.asarray(file["depth_mm"]) if "depth_mm" in file else None


def read_png(path: Path, index: int) -> NDArray[Any]:
    """Levels of a frame, read back from its file."""
    return np.asarray(cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_UNCHANGED))


class Form(NamedTuple):
    """A form of outputs."""

    writer: Callable[[PartTarget], PartWriter]
    # Takes a row's output and index; returns the frame's depth, mm, or its levels; None if it was not kept.
    read: Callable[[Path, int], NDArray[Any] | None]
    # Writes additional files when all parts are done; takes the output, the files of the parts, and the input's folder.
    finish: Callable[[Path, list[str], Path], list[OutputFile]] = lambda *_: []


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
