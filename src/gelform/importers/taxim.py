"""Taxim's `polycalib.npz`: a forward table, made into a color model by inverting it."""

from __future__ import annotations

import zipfile
import zlib
from os import PathLike
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.checks import check_path
from gelform.color_models.slope_table import SlopeTableModel
from gelform.errors import DataError

MAX_BYTES = 256 * 2**20
MAX_BINS = 1000
TABLE_SHAPE = (480, 640)  # of the images that the place is a pixel position in


def read_taxim(path: str | PathLike[str], background: NDArray[np.float32]) -> SlopeTableModel:
    """Taxim's table; `grad_r` is channel 0 of an image as OpenCV holds it, which is blue.

    Parameters
    ----------
    background : (H, W, 3), of the table's 480x640 px or of its proportions

    Raises
    ------
    DataError
        No such file, another one, a damaged one, or a background of other proportions.
    """
    path = check_path(path)
    arrays = _arrays(path)
    missing = {"bins", "grad_r", "grad_g", "grad_b"} - arrays.keys()
    if missing:
        raise DataError(
            f"Expected bins, grad_r, grad_g and grad_b in {path}, got {', '.join(arrays) or 'none'}."
        )
    bins = int(arrays["bins"]) if arrays["bins"].size == 1 else 0
    tables = [np.asarray(arrays[name], dtype=np.float64) for name in ("grad_b", "grad_g", "grad_r")]
    if not 4 <= bins <= MAX_BINS or any(table.shape != (bins, bins, 6) for table in tables):
        raise DataError(
            f"Expected three tables of shape (bins, bins, 6) in {path}, got {[t.shape for t in tables]}, bins {bins}."
        )
    height, width = background.shape[:2]
    if abs(height * TABLE_SHAPE[1] / (width * TABLE_SHAPE[0]) - 1) > 0.02:
        raise DataError(
            f"Expected a background of 480x640 px or its proportions, as Taxim's tables have them, got {height}x{width}. "
            "Turn or crop the images as Taxim does."
        )
    rows, columns = TABLE_SHAPE
    units = np.array([columns**2, rows**2, columns * rows, columns, rows, 1]) / 255  # places 0-1, change /255
    try:
        return SlopeTableModel((np.stack(tables, axis=2) * units).astype(np.float32), (height, width))
    except ValueError as problem:
        raise DataError(f"{path}: {problem}") from problem


def _arrays(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of an .npz without pickles, after a look at the sizes that it declares."""
    if not path.is_file():
        raise DataError(f"No file {path}: expected Taxim's polycalib.npz.")
    try:
        with zipfile.ZipFile(path) as archive:
            declared = sum(member.file_size for member in archive.infolist())
        if declared > MAX_BYTES:
            raise DataError(f"{path} declares {declared / 1e6:.3g} MB; Taxim's tables have a few.")
        with path.open("rb") as handle, np.load(handle, allow_pickle=False) as file:
            return {name: file[name] for name in file.files}
    except (
        OSError,
        EOFError,
        RuntimeError,
        SyntaxError,
        ValueError,
        TokenError,
        zipfile.BadZipFile,
        zlib.error,
    ) as problem:
        raise DataError(f"{path} is truncated or damaged, or no polycalib.npz: {problem}.") from problem
