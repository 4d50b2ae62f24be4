"""Images from numbers: the values of a data set, and arrays of numpy (`.npy`)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.errors import DataError, said
from gelform.image.view.view import MAX_PIXELS
from gelform.sensors.declared import check_declared

SAME_LEVEL = 0.13  # gray levels by which a level over 255 is off in float16


def image_from_values(values: NDArray[Any] | DataError, most_pixels: float = MAX_PIXELS) -> NDArray[np.uint8]:
    """An RGB image (H, W, 3) uint8 from a dataset's values for one frame; DataError if they are no image.

    The values are (H, W, 3) or (3, H, W): uint8, whole numbers 0-255 as floats, or 0-1 as floats of such levels. Or (L,)
    uint8: a JPEG or PNG, padded with zeros.
    """
    if isinstance(values, DataError):
        raise values
    if values.ndim == 1 and values.dtype == np.uint8:
        try:
            check_declared(values.tobytes(), most_pixels)
        except ValueError as problem:
            raise DataError(f"{problem}.") from problem
        decoded = cv2.imdecode(values, cv2.IMREAD_COLOR) if len(values) else None
        if decoded is None:
            raise DataError("Expected a JPEG or PNG, got bytes that are no image.")
        return np.ascontiguousarray(decoded[..., ::-1], dtype=np.uint8)
    if values.ndim == 3 and values.shape[2] != 3 and values.shape[0] == 3:
        values = np.ascontiguousarray(np.moveaxis(values, 0, 2))
    if values.ndim != 3 or values.shape[2] != 3:
        raise DataError(f"Expected frames (H, W, 3) or (3, H, W), got {values.shape}.")
    if values.dtype == np.uint8:
        return values
    with np.errstate(invalid="ignore"):
        whole = values.astype(np.uint8)
    if np.array_equal(whole, values):
        return whole
    levels = np.rint(255 * values.astype(np.float64))
    if values.min() >= 0 and values.max() <= 1 and np.abs(levels - 255.0 * values).max() <= SAME_LEVEL:
        return levels.astype(np.uint8)
    raise DataError(
        f"Expected whole numbers from 0 to 255, or such levels over 255, got {values.dtype} "
        f"{values.shape} from {values.min()} to {values.max()}. Write it as uint8."
    )


def is_npy(path: Path) -> bool:
    """Whether a path is an array file, by its name."""
    return path.suffix.lower() == ".npy"


def npy_values(path: Path, most_pixels: float = MAX_PIXELS) -> NDArray[Any]:
    """The array (H, W, 3) or (N, H, W, 3) of a `.npy` file, read from the disk where it is used; nothing is unpickled.

    DataError: it is missing, damaged, of another shape, or of larger frames.
    """
    if not path.is_file():
        raise DataError(f"No file {path}. Check the path.")
    try:
        values = np.load(path, mmap_mode="r", allow_pickle=False)
        shape = values.shape
    except Exception as problem:  # a damaged header fails in numpy's tokenizer in a dozen ways
        raise DataError(
            f"{path} is no array file (.npy) of numbers, or a damaged one: {said(problem)}."
        ) from problem
    if len(shape) not in (3, 4) or shape[-1] != 3 or 0 in shape or shape[-3] * shape[-2] > most_pixels:
        raise DataError(
            f"Expected RGB frames in {path}, an array (N, H, W, 3) or one image (H, W, 3) of at most "
            f"{most_pixels / 1e6:.4g} megapixels, got {shape}. Move the axis of the colors last."
        )
    return values


def image_of_npy(values: NDArray[Any], where: str) -> NDArray[np.uint8]:
    """An image (H, W, 3) uint8 from an array's values; DataError, naming `where`, if they are none."""
    try:
        return np.ascontiguousarray(image_from_values(np.asarray(values)))
    except DataError as problem:
        raise DataError(f"{where}: {problem}") from problem
