"""Frames in Zarr: data/CAMERA with meta/episode_ends, as diffusion policies have it, or any (N, H, W, 3)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.batch.extras import needed
from gelform.batch.inputs.containers import ContainerError, blocks, is_frames, matching
from gelform.batch.inputs.sequences import Sequence, natural
from gelform.errors import DataError

NODES = (".zgroup", ".zarray", "zarr.json")
ZIPPED = ".zarr.zip"
ENDS = "meta/episode_ends"


def is_zarr(path: Path) -> bool:
    """Whether a path is a Zarr store: a folder with its metadata, or one in a zip."""
    return path.name.endswith(ZIPPED) or any((path / name).is_file() for name in NODES)


def zarr_sequences(path: Path, name: str, wanted: str) -> list[Sequence]:
    """A sequence for each episode of each array that is meant.

    Raises
    ------
    DataError
        The store cannot be read; no array of that name: what is there is listed; its episodes are not those of the array.
    """
    group = _opened(path)
    arrays = dict(_arrays(group))
    there = {one: (a.shape, str(a.dtype)) for one, a in arrays.items() if is_frames(a.shape, a.dtype)}
    sequences: list[Sequence] = []
    for one in sorted(matching(path, there, wanted), key=natural):
        length = there[one][0][0]
        if ENDS not in arrays:
            sequences.append(Sequence(f"{name}/{one}", path, dataset=one, count=length))
            continue
        ends = np.asarray(arrays[ENDS][:]).tolist()
        starts = [0, *ends[:-1]]
        if sorted(ends) != ends or ends[-1:] != [length]:
            raise DataError(
                f"Expected {ENDS} of {path} to end at the {length} frames of {one}, got {ends[-1:]}."
            )
        sequences += [
            Sequence(f"{name}/{one}/{k:06d}", path, dataset=one, offset=a, count=b - a)
            for k, (a, b) in enumerate(zip(starts, ends))
        ]
    return sequences


def zarr_values(path: Path, dataset: str, start: int, count: int) -> Iterator[NDArray[Any] | DataError]:
    """What the array holds for each frame of a range, or why that cannot be read.

    Raises
    ------
    DataError
        The store cannot be read, or has no such array any more.
    """
    array = dict(_arrays(_opened(path))).get(dataset)
    if array is None:
        raise DataError(f"Expected {dataset} in {path}, got none.")
    yield from blocks(array, start, count, array.chunks[0])


def _opened(path: Path) -> Any:
    zarr = needed("zarr", "zarr", "Zarr")
    try:
        if path.suffix == ".zip":
            return zarr.open_group(zarr.storage.ZipStore(path, mode="r"), mode="r")
        return zarr.open_group(str(path), mode="r")
    except Exception as problem:  # of a dozen kinds, by version of zarr
        raise ContainerError(
            f"Cannot read {path} as a Zarr group: {problem}. It is damaged, or of another kind."
        ) from problem


def _arrays(group: Any, above: str = "") -> Iterator[tuple[str, Any]]:
    for name, array in group.arrays():
        yield f"{above}{name}", array
    for name, inside in group.groups():
        yield from _arrays(inside, f"{above}{name}/")
