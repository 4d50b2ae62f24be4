"""Files that hold many frames at a path inside: HDF5, Zarr, LeRobot; which sequences they have, and their frames."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.errors import DataError

BLOCK_BYTES, BLOCK_FRAMES = 1 << 26, 64
DAMAGED = (OSError, ValueError, RuntimeError)  # of h5py and zarr, where a chunk cannot be decoded
Shapes = Mapping[str, tuple[tuple[int, ...], str]]  # path inside -> (shape, dtype)


class ContainerError(DataError):
    """A file that should hold frames cannot be opened."""


def matching(path: Path, there: Shapes, wanted: str) -> list[str]:
    """The datasets of a container that a pattern such as "data/*/obs/gelsight" means; * stands for one name.

    Raises
    ------
    DataError
        None, or no pattern is given: the message lists what is there.
    """
    parts = wanted.strip("/").split("/")
    found = [one for one in there if wanted and _matches(one.split("/"), parts)]
    if found:
        return found
    said = f"Expected {wanted} in {path}, got none" if wanted else f"{path} may hold several datasets"
    raise DataError(f"{said}. Give one with --dataset; there {_listed(there)}.")


def image_from_values(values: NDArray[Any] | DataError) -> NDArray[np.uint8]:
    """An RGB image (H, W, 3) uint8 of what a dataset holds for a frame.

    Parameters
    ----------
    values : (H, W, 3) uint8; whole numbers 0-255 as floats; (L,) uint8: a JPEG or PNG, padded with zeros; or why there is
        none, which is raised

    Raises
    ------
    DataError
        Something else.
    """
    if isinstance(values, DataError):
        raise values
    if values.ndim == 1 and values.dtype == np.uint8:
        decoded = cv2.imdecode(values, cv2.IMREAD_COLOR) if len(values) else None
        if decoded is None:
            raise DataError("Expected a JPEG or PNG in the dataset, got bytes that are no image.")
        return np.ascontiguousarray(decoded[..., ::-1], dtype=np.uint8)
    if values.ndim != 3 or values.shape[2] != 3:
        raise DataError(
            f"Expected frames (H, W, 3) in the dataset, got {values.shape}. Move the channels last."
        )
    if values.dtype == np.uint8:
        return values
    with np.errstate(invalid="ignore"):
        whole = values.astype(np.uint8)
    if not np.array_equal(whole, values):
        raise DataError(
            f"Expected whole numbers from 0 to 255 in the dataset, got {values.dtype} from {values.min()} to "
            f"{values.max()}. Write it as uint8."
        )
    return whole


def blocks(dataset: Any, start: int, count: int, chunk: int) -> Iterator[NDArray[Any] | DataError]:
    """What a dataset holds for each frame of a range, or why that cannot be read.

    Read in blocks of chunks, so that no chunk is decompressed for every frame of it.
    """
    frame_bytes = max(1, int(np.prod(dataset.shape[1:])) * dataset.dtype.itemsize)
    length = max(1, min(chunk, BLOCK_FRAMES, BLOCK_BYTES // frame_bytes))
    for first in range(start, start + count, length):
        stop = min(first + length, start + count)
        try:
            yield from dataset[first:stop]
        except DAMAGED:
            yield from (_one(dataset, index) for index in range(first, stop))


def _one(dataset: Any, index: int) -> NDArray[Any] | DataError:
    try:
        return np.asarray(dataset[index])
    except DAMAGED as problem:
        return DataError(f"Cannot read frame {index} of {dataset.name}: {problem}.")


def is_frames(shape: tuple[int, ...], dtype: Any) -> bool:
    """Whether a dataset may hold frames: (N, H, W, 3), or compressed ones (N, L) or of any length."""
    kind = np.dtype(dtype)
    if kind == np.dtype(object):
        return len(shape) == 1
    if len(shape) == 4:
        return shape[3] == 3 and kind.kind in "uf"
    return len(shape) == 2 and kind == np.uint8


def _matches(names: list[str], pattern: list[str]) -> bool:
    return len(names) == len(pattern) and all(fnmatchcase(a, b) for a, b in zip(names, pattern))


def _listed(there: Shapes) -> str:
    """Like ones, which differ in a number, once."""
    if not there:
        return "is no dataset of frames (N, H, W, 3)"
    kinds = Counter(re.sub(r"\d+", "*", one) for one in there)
    first = {re.sub(r"\d+", "*", one): one for one in reversed(list(there))}
    texts = []
    for pattern, count in kinds.items():
        shape, dtype = there[first[pattern]]
        name = first[pattern] if count == 1 else pattern
        texts.append(f"{name} ({count if count > 1 else 'one'} of {dtype} {_shape(shape)})")
    return "are " + ", ".join(texts)


def _shape(shape: Iterable[int]) -> str:
    return "x".join(map(str, shape))
