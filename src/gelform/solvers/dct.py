"""Exact uniform least squares with a free border: cosine transform along rows, elimination along columns.

Each edge between two neighbouring pixels says that their difference of depth is the pixel pitch times the
mean of their two slopes (trapezoid rule). The normal equations are a Poisson equation with a free border.
The DCT-II along rows, with eigenvalues 4 sin^2(pi k/2W), k from 0 (Strang, The discrete cosine transform,
SIAM Review 41, 1999), leaves one tridiagonal system per column, which is eliminated without pivoting
(Hockney, A fast direct solution of Poisson's equation using Fourier analysis, J. ACM 12, 1965).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, ClassVar

import numpy as np
import scipy  # its parts load at first use: a weighted solve needs none of them
from numba import njit
from numpy.typing import NDArray

from gelform.pool import Pool
from gelform.solvers.edges import divergence, edges_from_gradients
from gelform.solvers.seam import Solution, Weights

# A row stride of a large power of two maps a whole column onto a few cache lines.
ALIASING_BYTES = 1024
STRIDE_PAD = 16


class DctSolver:
    """Prepared once for a shape and a pitch; gives depth of mean 0.

    An edge's slope is the mean of its two pixels': exact on quadratics, best under noise.

    Parameters
    ----------
    shape : (H, W)
    mm_per_px : (x, y), mm
    """

    takes_weights: ClassVar[bool] = False

    def __init__(self, shape: tuple[int, int], mm_per_px: tuple[float, float]) -> None:
        self.shape = shape
        self.mm_per_px = mm_per_px
        self._pivots, self._splits, self._last = _elimination(shape, mm_per_px)
        self._pool = Pool(lambda: _scratch(shape))

    def __call__(
        self,
        gradients: NDArray[Any],
        weights: Weights = None,
        mask: NDArray[np.bool_] | None = None,
        anchor: NDArray[Any] | None = None,
    ) -> Solution:
        """Depth of one frame of slopes (H, W, 2), mean 0.

        Raises
        ------
        ValueError
            Weights, a mask or an anchor were given.
        """
        if not (weights is None and mask is None and anchor is None):
            raise ValueError(
                "Expected no weights, mask or anchor for a dct solver, which treats all slopes alike, got some. "
                "Leave them out, or use solver 'auto' or 'multigrid'."
            )
        frame = np.ascontiguousarray(gradients, dtype=np.float32)
        depth = np.empty(self.shape, dtype=np.float32)
        with self._pool.one() as scratch:
            work = depth if scratch is None else scratch
            self._write_right_side(frame, work)
            spectrum = scipy.fft.dct(work, axis=-1, overwrite_x=True)
            _sweep(spectrum, self._pivots, self._splits, self._last)
            solved = scipy.fft.idct(spectrum, axis=-1, overwrite_x=True)
            if solved is not depth:
                depth[...] = solved
        return Solution(depth, _all_known(self.shape))

    def _write_right_side(self, frame: NDArray[np.float32], work: NDArray[np.float32]) -> None:
        hx, hy = self.mm_per_px
        _right_side(frame, work, 0.5 * hy * hy / hx, 0.5 * hy)


class Dct4Solver(DctSolver):
    """The same with an edge's slope from four pixels.

    Exact on quartics: for fine texture where the slope noise is under 0.02.
    """

    def _write_right_side(self, frame: NDArray[np.float32], work: NDArray[np.float32]) -> None:
        hy = self.mm_per_px[1]
        work[...] = divergence(edges_from_gradients(frame, order=4), self.mm_per_px) * np.float32(hy * hy)


@lru_cache(maxsize=16)
def _all_known(shape: tuple[int, int]) -> NDArray[np.bool_]:
    """A map of True, shared: nobody can write to it."""
    known = np.ones(shape, dtype=bool)
    known.flags.writeable = False
    return known


def _scratch(shape: tuple[int, int]) -> NDArray[np.float32] | None:
    """Rows with a padded stride where the frame's own stride would alias in the cache."""
    height, width = shape
    if (width * 4) % ALIASING_BYTES:
        return None
    return np.empty((height, width + STRIDE_PAD), dtype=np.float32)[:, :width]


def _elimination(
    shape: tuple[int, int], mm_per_px: tuple[float, float]
) -> tuple[NDArray[np.float32], NDArray[np.int64], NDArray[np.float32]]:
    """Inverse pivots of the tridiagonal systems `-z[i-1] + (2 + lambda_k) z[i] - z[i+1]`, free at both ends.

    From row to row they settle at a limit, the sooner the higher the frequency; `splits[i]` counts the
    columns that have not settled at row i, so the sweeps read little more than one row of them.
    """
    height, width = shape
    eigenvalues = (2 * np.sin(np.pi * np.arange(width) / (2 * width)) * mm_per_px[1] / mm_per_px[0]) ** 2
    pivots = np.ones((height + 1, width))
    pivots[0] = 1 / (1 + eigenvalues)
    for row in range(1, height):
        pivots[row] = 1 / (2 + eigenvalues - pivots[row - 1])
    half = 1 + eigenvalues / 2
    limit = 1 / (half + np.sqrt(half**2 - 1))
    last = pivots[height - 2] if height > 1 else np.zeros(width)
    end = np.ones(width)
    end[1:] = 1 / ((1 if height > 1 else 0) + eigenvalues[1:] - last[1:])
    unsettled = np.abs(pivots[:height] - limit) > 1e-8 * limit
    columns = np.arange(1, width + 1)
    splits = np.max(np.where(unsettled, columns, 1), axis=1)
    pivots[height] = limit
    return pivots.astype(np.float32), splits.astype(np.int64), end.astype(np.float32)


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})  # type: ignore[misc]
def _right_side(g: NDArray[Any], out: NDArray[Any], scale_x: float, scale_y: float) -> None:
    """`D^T e` of the edge slopes; beyond the border the slope is mirrored with its sign turned."""
    height, width = out.shape
    right = width - 1
    sx = np.float32(scale_x)
    sy = np.float32(scale_y)
    line = np.empty(max(2 * width - 4, 0), dtype=np.float32)
    for i in range(height):
        row = g[i].reshape(2 * width)
        up = g[max(i - 1, 0)].reshape(2 * width)
        down = g[min(i + 1, height - 1)].reshape(2 * width)
        s_up = np.float32(-1 if i == 0 else 1) * sy
        s_down = np.float32(-1 if i == height - 1 else 1) * sy
        out[i, 0] = s_up * up[1] - s_down * down[1]
        if width > 1:
            out[i, 0] -= sx * (row[0] + row[2])
            out[i, right] = s_up * up[-1] - s_down * down[-1] + sx * (row[2 * width - 4] + row[2 * width - 2])
        _inner_row(line, row, up[3:], down[3:], sx, s_up, s_down)
        inner = out[i, 1:]
        for j in range(width - 2):
            inner[j] = line[2 * j]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})  # type: ignore[misc]
def _inner_row(line: Any, row: Any, up: Any, down: Any, sx: float, s_up: float, s_down: float) -> None:
    """Both components as they lie in memory, every second value unused: faster than picking p and q."""
    for m in range(line.size):
        line[m] = sx * (row[m] - row[m + 4]) + (s_up * up[m] - s_down * down[m])


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})  # type: ignore[misc]
def _sweep(v: NDArray[Any], pivots: NDArray[Any], splits: NDArray[Any], end: NDArray[Any]) -> None:
    """Solve the tridiagonal system of every column in place; column 0 gets mean 0."""
    last, width = v.shape[0] - 1, v.shape[1]
    _constant_column(v)
    for k in range(1, width):
        v[0, k] *= pivots[0, k] if last > 0 else end[k]
    for i in range(1, last):
        s = splits[i]
        _down(v[i, 1:s], v[i - 1, 1:s], pivots[i, 1:s])
        _down(v[i, s:], v[i - 1, s:], pivots[last + 1, s:])
    if last > 0:
        _down(v[last, 1:], v[last - 1, 1:], end[1:])
    for i in range(last - 1, -1, -1):
        s = splits[i]
        _up(v[i, 1:s], v[i + 1, 1:s], pivots[i, 1:s])
        _up(v[i, s:], v[i + 1, s:], pivots[last + 1, s:])


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})  # type: ignore[misc]
def _down(row: Any, above: Any, pivot: Any) -> None:
    for k in range(row.size):
        row[k] = (row[k] + above[k]) * pivot[k]


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})  # type: ignore[misc]
def _up(row: Any, below: Any, pivot: Any) -> None:
    for k in range(row.size):
        row[k] += below[k] * pivot[k]


@njit(cache=True, nogil=True, error_model="numpy")  # type: ignore[misc]
def _constant_column(v: NDArray[Any]) -> None:
    """Column 0 has eigenvalue 0: sum the right side twice, in float64, and remove the mean."""
    height = v.shape[0]
    flux = 0.0
    value = 0.0
    total = 0.0
    for i in range(height):
        flux += v[i, 0]
        v[i, 0] = value
        total += value
        value -= flux
    mean = total / height
    for i in range(height):
        v[i, 0] -= mean
