"""The depth of a row of the table, read back from what was written."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.batch.extras import needed
from gelform.batch.outputs.depth_video import RATE_HZ
from gelform.batch.outputs.lerobot_video import CODEC
from gelform.exporters.quantised import depth_from_levels
from gelform.robots.lerobot_depth import depth_from_lerobot_levels

Row = Mapping[str, Any]


def depth_of_row(output: Path, form: str, row: Row) -> NDArray[np.float32] | None:
    """Depth (H, W), mm, NaN or 0 where it is not known; None where the frame has an error or depth was not kept."""
    if not row["output"]:
        return None
    values = READERS[form](output / row["output"], int(row["index"]))
    if values is not None and values.dtype == np.uint16:
        return depth_from_levels(values)[0]
    return values


def _npz(path: Path, index: int) -> NDArray[Any] | None:
    with np.load(path) as file:
        return np.asarray(file["depth_mm"]) if "depth_mm" in file else None


def _png(path: Path, index: int) -> NDArray[Any]:
    return np.asarray(cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_UNCHANGED))


def _zarr(path: Path, index: int) -> NDArray[Any] | None:
    """By the shard's own index (see `zarr_arrays`)."""
    folder = path / "depth_mm"
    if not folder.is_dir():
        return None
    node = json.loads((folder / "zarr.json").read_bytes())
    length, height, width = node["chunk_grid"]["configuration"]["chunk_shape"]
    content = (folder / f"c/{index // length}/0/0").read_bytes()
    places = np.frombuffer(content[-16 * length - 4 : -4], "<u8").reshape(length, 2)
    offset, size = map(int, places[index % length])
    values = needed("numcodecs.blosc", "zarr", "Zarr").decompress(content[offset : offset + size])
    return np.frombuffer(values, node["data_type"]).reshape(height, width)


def _hdf5(path: Path, index: int) -> NDArray[Any] | None:
    with needed("h5py", "hdf5", "HDF5").File(path, "r") as file:
        return np.asarray(file["depth_mm"][index - int(path.stem)]) if "depth_mm" in file else None


def _ffv1(path: Path, index: int) -> NDArray[Any]:
    with needed("av", "ffv1", "FFV1").open(str(path)) as file:
        stream = file.streams.video[0]
        file.seek(int(index / RATE_HZ / stream.time_base), stream=stream)
        frames = (one for one in file.decode(stream) if round(one.time * RATE_HZ) >= index)
        return np.asarray(next(frames).to_ndarray(format="gray16le"))


def _lerobot(path: Path, index: int) -> NDArray[Any]:
    """As depth: the codes are not those of `exporters.quantised`."""
    with needed("av", "lerobot", "LeRobot").open(str(path)) as file:
        frames = file.decode(file.streams.video[0])
        codes = next(islice(frames, index, None)).to_ndarray(format=CODEC.pix_fmt)
    return depth_from_lerobot_levels(codes)


READERS: dict[str, Callable[[Path, int], NDArray[Any] | None]] = {
    "npz": _npz,
    "png": _png,
    "zarr": _zarr,
    "hdf5": _hdf5,
    "ffv1": _ffv1,
    "lerobot": _lerobot,
}
