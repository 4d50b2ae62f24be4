"""Frames in HDF5: robomimic's data/demo_0/obs/CAMERA, ALOHA's observations/images/CAMERA, or any (N, H, W, 3)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from gelform.batch.extras import needed
from gelform.batch.inputs.containers import BLOCK_FRAMES, ContainerError, blocks, is_frames, matching
from gelform.batch.inputs.sequences import Sequence, natural
from gelform.errors import DataError

HDF5_SUFFIXES = (".h5", ".hdf5")


def hdf5_sequences(path: Path, name: str, wanted: str) -> list[Sequence]:
    """A sequence for each dataset of the file that is meant, in natural order.

    Raises
    ------
    DataError
        The file cannot be read; no dataset of that name: what is there is listed.
    """
    there: dict[str, tuple[tuple[int, ...], str]] = {}
    with _opened(path) as file:

        def look(inside: str, one: Any) -> None:
            if hasattr(one, "shape") and is_frames(one.shape, one.dtype):
                there[inside] = (one.shape, str(one.dtype))

        file.visititems(look)
    found = sorted(matching(path, there, wanted), key=natural)
    return [Sequence(f"{name}/{one}", path, dataset=one, count=there[one][0][0]) for one in found]


def hdf5_values(path: Path, dataset: str, start: int, count: int) -> Iterator[NDArray[Any] | DataError]:
    """What the dataset holds for each frame of a range, or why that cannot be read.

    Raises
    ------
    DataError
        The file cannot be read, or has no such dataset any more.
    """
    with _opened(path) as file:
        if dataset not in file:
            raise DataError(f"Expected {dataset} in {path}, got none.")
        values = file[dataset]
        yield from blocks(values, start, count, (values.chunks or (BLOCK_FRAMES,))[0])


def _opened(path: Path) -> Any:
    h5py = needed("h5py", "hdf5", "HDF5")
    try:
        return h5py.File(path, "r")
    except OSError as problem:
        raise ContainerError(
            f"Cannot read {path} as HDF5: {problem}. It is damaged, cut off, or of another kind."
        ) from problem
