"""The grid that is four times coarser than a frame. Depth is smooth, so a sixteenth of the pixels will do."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.depth.solvers.dct import DctSolver

COARSER = 4  # times fewer rows and columns; the same in native/depth/coarse.c

_cell_means = Kernel("cell_means", "f32[h,w,c] values, out f32[n] work, out f32[r,k,c] cells")
_cell_shares = Kernel("cell_shares", "bool[h,w] mask, out f32[r,k] cells")


class Coarse:
    """Means of frames (H, W), least-squares depth of them, and maps at pixels again; immutable, threads can share it.

    Attributes
    ----------
    shape : (rows, columns)
    pitch_px : (x, y), distance of its cells, px
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        rows, columns = (max(2, size // COARSER) for size in shape)
        self.shape = rows, columns
        self.pitch_px = shape[1] / columns, shape[0] / rows
        self._pixels = shape[1], shape[0]
        self._whole = (COARSER * rows, COARSER * columns) == tuple(shape)
        self._solver = DctSolver(self.shape, self.pitch_px)

    def means(self, values: NDArray[Any]) -> NDArray[np.float32]:
        """Means (rows, columns, ...) over the cells of a map (H, W) or (H, W, C), float32 in C order, or bool."""
        if self._whole:
            cells = np.empty((*self.shape, *values.shape[2:]), dtype=np.float32)
            if values.dtype == np.bool_:
                _cell_shares(values, cells)
            else:
                channels = values.shape[2] if values.ndim == 3 else 1
                work = np.empty(values.shape[1] * channels, dtype=np.float32)
                _cell_means(
                    values.reshape(*values.shape[:2], channels), work, cells.reshape(*self.shape, channels)
                )
            return cells
        values = values.astype(np.float32, copy=False)
        return np.asarray(
            cv2.resize(values, self.shape[::-1], interpolation=cv2.INTER_AREA), dtype=np.float32
        )

    def depth_px(self, slopes: NDArray[np.float32]) -> NDArray[np.float32]:
        """Least-squares depth (rows, columns) of slopes there (rows, columns, 2), px; its mean is 0."""
        return self._solver(slopes).depth_mm

    def at_pixels(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """A map (rows, columns) at every pixel (H, W), linear between the cells' centers."""
        return np.asarray(cv2.resize(values, self._pixels, interpolation=cv2.INTER_LINEAR))


@lru_cache(maxsize=16)
def coarse_of(shape: tuple[int, int]) -> Coarse:
    """The grid of frames of a shape, made once."""
    return Coarse(shape)
