"""Taxim's `polycalib.npz`: a forward table, made into a color model by inverting it."""

from __future__ import annotations

from os import PathLike

import numpy as np
from numpy.typing import NDArray

from gelform.color_models.slope_table import SlopeTableModel
from gelform.errors import DataError
from gelform.importers.taxim_forward import read_taxim_forward

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
    table = read_taxim_forward(path).table
    height, width = background.shape[:2]
    if abs(height * TABLE_SHAPE[1] / (width * TABLE_SHAPE[0]) - 1) > 0.02:
        raise DataError(
            f"Expected a background of 480x640 px or its proportions, as Taxim's tables have them, got {height}x{width}. "
            "Turn or crop the images as Taxim does."
        )
    rows, columns = TABLE_SHAPE
    units = np.array([columns**2, rows**2, columns * rows, columns, rows, 1]) / 255  # places 0-1, change /255
    try:
        return SlopeTableModel((table * units).astype(np.float32), (height, width))
    except ValueError as problem:
        raise DataError(f"{path}: {problem}") from problem
