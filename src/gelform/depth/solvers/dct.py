"""Exact uniform least squares with a free border: cosine transform along rows, elimination along columns.

For each edge between two neighboring pixels, their difference of depth is the pixel pitch times the
mean of their two slopes (trapezoid rule). The normal equations are a Poisson equation with a free border.
The DCT-II along rows, with eigenvalues 4 sin^2(pi k/2W), k from 0 (Strang, The discrete cosine transform,
SIAM Review 41, 1999), leaves one tridiagonal system per column, which is eliminated without pivoting
(Hockney, A fast direct solution of Poisson's equation using Fourier analysis, J. ACM 12, 1965).
"""

from __future__ import annotations

from functools import lru_cache
from typing import ClassVar

import numpy as np
import scipy  # its parts load at first use; the usual sizes need none of them
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.arrays import Array, Floats, Map, Mask
from gelform.depth.solvers.seam import (
    Solution,
    Weights,
    check_depth,
    constant_map,
    divergence,
    edges_from_gradients,
)
from gelform.foundations.pool import Pool

ROWS = 16  # that the kernel of native/depth/solvers/cosine.c transforms side by side

_right_side = Kernel(
    "dct_right_side", "f32[h,w,2] gradients, out f32[h,stride] right, f32 scale_x, f32 scale_y"
)
_product = Kernel("dct_product", "out f32[h,stride] rows, f32[w,w] table")
_cosine_rows = Kernel(
    "cosine_rows",
    "out f32[h,stride] rows, f32[half,2] turns, f32[knots,4] twists, out f32[n] work, i32 back",
)
_passes = Kernel(
    "dct_passes",
    "out f32[h,stride] spectrum, f32[h,w,2]? gradients, f32[half,2] turns, f32[knots,4] twists, f32[rows,w] pivots, "
    "i64[h] splits, f32[w] end, out f32[n] work, f32 scale_x, f32 scale_y",
)
_cosine_filter = Kernel(
    "cosine_filter",
    "out f32[m,h,w] maps, f32[m,w,h] gains, f32[half_x,2] turns_x, f32[knots_x,4] twists_x, f32[half_y,2] turns_y, "
    "f32[knots_y,4] twists_y, out f32[n] work",
)
_sweep = Kernel("dct_sweep", "out f32[h,stride] spectrum, f32[rows,w] pivots, i64[h] splits, f32[w] end")


class DctSolver:
    """A solver for frames of one shape and pitch; its depth has mean 0.

    An edge's slope is the mean of its two pixels' slopes: exact on quadratics, best under noise.
    """

    takes_weights: ClassVar[bool] = False

    def __init__(self, shape: tuple[int, int], mm_per_px: tuple[float, float]) -> None:
        self.shape = shape
        self.mm_per_px = mm_per_px
        self._pivots, self._splits, self._last = _elimination(shape, mm_per_px)
        # Rows of a multiple of 1024 bytes map a column onto a few cache lines: work rows are longer.
        self._stride = shape[1] + (16 if shape[1] * 4 % 1024 == 0 else 0)
        self._transform = CosineRows(shape[1])
        self._pool = Pool(lambda: np.empty((shape[0], self._stride), dtype=np.float32))

    def __call__(
        self, gradients: Array, weights: Weights = None, mask: Mask | None = None, anchor: Array | None = None
    ) -> Solution:
        """Depth of one frame of slopes (H, W, 2), mean 0; ValueError: weights, a mask or an anchor were given."""
        if not (weights is None and mask is None and anchor is None):
            raise ValueError(
                "Expected no weights, mask or anchor for a dct solver, which treats all slopes alike, got some. "
                "Leave them out, or use solver 'auto' or 'multigrid'."
            )
        frame = np.ascontiguousarray(gradients, dtype=np.float32)
        width = self.shape[1]
        if self._stride == width:
            depth = np.empty(self.shape, dtype=np.float32)
            self._solve(frame, depth)
        else:
            with self._pool.one() as padded:
                self._solve(frame, padded)
                depth = padded[:, :width].copy()
        return Solution(check_depth(depth), constant_map(self.shape, True))

    def _solve(self, frame: Map | None, work: Floats) -> None:
        """Depth of a frame, or of a right side in place, in the first columns of a work array (H, stride)."""
        hx, hy = self.mm_per_px
        scales, elimination = (0.5 * hy * hy / hx, 0.5 * hy), (self._pivots, self._splits, self._last)
        if self._transform.turns is not None:
            with self._transform.work.one() as scratch:
                _passes(work, frame, *self._transform.turns, *elimination, scratch, *scales)
            return
        if frame is not None:
            _right_side(frame, work, *scales)
        self._transform(work, 0)
        _sweep(work, *elimination)
        self._transform(work, 1)


class Dct4Solver(DctSolver):
    """As `DctSolver`, with an edge's slope from four pixels.

    It is exact on quartics and suits fine texture with slope noise under 0.02.
    """

    def _solve(self, frame: Map | None, work: Floats) -> None:
        assert frame is not None
        right = divergence(edges_from_gradients(frame, order=4), self.mm_per_px)
        work[:, : self.shape[1]] = right * np.float32(self.mm_per_px[1] * self.mm_per_px[1])
        super()._solve(None, work)


class CosineRows:
    """The DCT-II of rows of one width, not normalized, and its inverse; immutable, threads can share it."""

    def __init__(self, width: int) -> None:
        self.width = width
        self.turns = _turns(width) if _is_smooth(width) else None
        # Narrow rows use a matrix product, because importing scipy.fft takes 0.3 s.
        self._tables = _cosines(width) if self.turns is None and width <= 128 else None
        self.work = Pool(lambda: np.empty((3 * width + 1) * ROWS, dtype=np.float32))

    def __call__(self, rows: Floats, inverse: int) -> None:
        """Transform the first columns of rows (N, >= width) in place; `inverse` is 0 or 1."""
        if self.turns is not None:
            with self.work.one() as scratch:
                _cosine_rows(rows, *self.turns, scratch, inverse)
            return
        if self._tables is not None:
            _product(rows, self._tables[inverse])
            return
        part = rows[:, : self.width]
        done = (scipy.fft.idct if inverse else scipy.fft.dct)(part, axis=-1, overwrite_x=True)
        if not np.may_share_memory(done, part):
            part[...] = done


class CosineFilter:
    """Multiplies the cosine modes of maps (N, h, w), as a convolution with mirrored borders does; threads can share it.

    The gains (N, h, w) are those of the modes of each map, the lowest first.
    """

    def __init__(self, gains: Floats) -> None:
        self._gains = np.ascontiguousarray(np.swapaxes(gains, 1, 2), dtype=np.float32)
        self._along, self._across = CosineRows(gains.shape[2]), CosineRows(gains.shape[1])
        size = gains[0].size + (3 * max(gains.shape[1:]) + 1) * ROWS
        self._work = Pool(lambda: np.empty(size, dtype=np.float32))

    def __call__(self, maps: Map) -> Map:
        """The filtered maps (N, h, w)."""
        modes = np.array(maps, dtype=np.float32, order="C")
        along, across = self._along.turns, self._across.turns
        if along is not None and across is not None:
            with self._work.one() as work:
                _cosine_filter(modes, self._gains, *along, *across, work)
            return modes
        self._along(modes.reshape(-1, modes.shape[2]), 0)
        turned = np.ascontiguousarray(np.swapaxes(modes, 1, 2))
        rows = turned.reshape(-1, turned.shape[2])
        self._across(rows, 0)
        turned *= self._gains
        self._across(rows, 1)
        filtered = np.ascontiguousarray(np.swapaxes(turned, 1, 2))
        self._along(filtered.reshape(-1, filtered.shape[2]), 1)
        return filtered


def _is_smooth(width: int) -> bool:
    """Whether the kernel transforms a row of that width: half of it has no prime beyond 7. It takes half of scipy's time."""
    half, odd = divmod(width, 2)
    for prime in range(2, 8):
        while half and half % prime == 0:
            half //= prime
    return not odd and half == 1


@lru_cache(maxsize=16)
def _turns(width: int) -> tuple[Floats, Floats]:
    """Roots of 1 for the kernel: of half the width (width/2, 2), of the width and of four times it (width/2 + 1, 4)."""
    k = np.arange(width // 2 + 1)
    roots = [np.exp(-2j * np.pi * k / n) for n in (width // 2, width, 4 * width)]
    parts = [np.stack([z.real, z.imag], axis=-1).astype(np.float32) for z in roots]
    return np.ascontiguousarray(parts[0][:-1]), np.concatenate(parts[1:], axis=-1)


@lru_cache(maxsize=16)
def _cosines(width: int) -> tuple[Floats, Floats]:
    """Matrices (width, width) that multiply a row for its DCT-II, not normalized, and for the inverse."""
    forward = 2 * np.cos(np.pi * np.outer(np.arange(width) + 0.5, np.arange(width)) / width)
    inverse = forward.T / (2 * width)
    inverse[0] /= 2
    return forward.astype(np.float32), np.ascontiguousarray(inverse, dtype=np.float32)


def _elimination(
    shape: tuple[int, int], mm_per_px: tuple[float, float]
) -> tuple[Floats, NDArray[np.int64], Floats]:
    """Inverse pivots of the tridiagonal systems `-z[i-1] + (2 + lambda_k) z[i] - z[i+1]`, free at both ends.

    From row to row they converge, sooner at higher frequencies; `splits[i]` counts the columns that have
    not converged at row i, so the sweeps read little more than one row of pivots.
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
