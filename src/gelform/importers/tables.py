"""Look-up tables of gradients by colour difference, `table_smooth.npy`, in the tradition of Dong and Yuan."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from tokenize import TokenError

import numpy as np
from numpy.typing import NDArray

from gelform.checks import check_path
from gelform.color_models.lookup import LookupModel
from gelform.errors import DataError

MAX_BYTES = 256 * 2**20
MAX_BINS = 200
RANGE_LEVELS = 180.0  # the table spans -90 to 90 grey levels of difference in each channel


def read_lut(
    path: str | PathLike[str], background: NDArray[np.float32], *, depth_sign: int = 1
) -> LookupModel:
    """A table (bins, bins, bins, 2), indexed by the blue, green and red difference, of gradients (gx, gy).

    The difference is taken between images blurred by 3x3 px and multiplied by 1 + 2 (mean(I0)/I0 - 1). Values
    are those at the bins' centres, with linear interpolation between; the table's answer to no difference is
    subtracted. Its accuracy is not in the file: no deviation is claimed.

    Parameters
    ----------
    depth_sign : 1 where the table's surface rises where pressed, -1 where it falls

    Raises
    ------
    DataError
        No such file, no such table, or a damaged one.
    """
    if depth_sign not in (1, -1):
        raise ValueError(f"Expected depth_sign 1 or -1, got {depth_sign}.")
    slopes = depth_sign * _array(check_path(path)).transpose(2, 1, 0, 3)  # to red, green, blue
    unknown = np.zeros((*slopes.shape[:3], 1))
    bins = slopes.shape[0]
    step = np.full(3, RANGE_LEVELS / bins)
    table = np.concatenate([slopes, unknown], axis=-1)[None, None].astype(np.float32)
    height, width = background.shape[:2]
    low = step / 2 - RANGE_LEVELS / 2
    return LookupModel(table, low, step, (height, width), "mean_over_background", background)


def _array(path: Path) -> NDArray[np.float64]:
    if not path.is_file():
        raise DataError(f"No file {path}: expected a look-up table (.npy).")
    if path.stat().st_size > MAX_BYTES:
        raise DataError(f"Expected a table of at most {MAX_BYTES >> 20} MB, got {path}.")
    try:
        array = np.load(path, allow_pickle=False)
    except (ValueError, EOFError, OSError, SyntaxError, TokenError) as problem:
        raise DataError(
            f"{path} is no array file (.npy) of numbers, or a damaged one: {problem}."
        ) from problem
    shape: tuple[int, ...] = getattr(array, "shape", ())
    if len(shape) != 4 or shape[3] != 2 or len(set(shape[:3])) != 1 or not 4 <= shape[0] <= MAX_BINS:
        raise DataError(f"Expected a table of shape (bins, bins, bins, 2) in {path}, got {shape}.")
    if not np.issubdtype(array.dtype, np.floating) or not np.isfinite(array).all():
        raise DataError(f"Expected finite floats in {path}, got {array.dtype} or NaN.")
    return np.asarray(array, dtype=np.float64)
