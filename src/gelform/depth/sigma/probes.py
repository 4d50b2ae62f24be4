"""Probes: many random slope errors that are integrated together; the spread of their depths gives sigma.

Independent draws would leave a relative error of 1/sqrt(2 n) in a standard deviation from n probes. Here the
draws of neighboring places are orthogonal over the probes instead, as in probing for the diagonal of an
inverse (J. Tang and Y. Saad, A probing method for computing the diagonal of a matrix inverse, Numer. Linear
Algebra Appl. 19, 2012): places of one color share a row of an orthogonal matrix, up to sign, and are far
apart. Depth depends far more on near slopes than on distant ones, so the remaining error is half as large.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform._native import Handle, Kernel
from gelform.depth.solvers.multigrid import Grid
from gelform.depth.solvers.system import LinearSystem
from gelform.foundations.pool import Pool

_probe_depths = Kernel(
    "probe_depths",
    "multigrid* grid, batch* batch, f32[h,w,2,n] white_draws, f32[h,w,2,n] common_draws, f32[h,w,2] white, "
    "f32[h,w,2] common, f32[2,n] bias, f32 scale_x, f32 scale_y, out f32[h,w,n] depths",
)


def white_draws(count: int, shape: tuple[int, int], rng: np.random.Generator) -> NDArray[np.float32]:
    """Fields (count, H, W, 2) of variance 1, independent from place to place."""
    return np.ascontiguousarray(_placed(count, shape, rng), dtype=np.float32)


def correlated_draws(
    count: int, shape: tuple[int, int], length: float, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Fields (count, H, W, 2) of variance 1 and correlation exp(-d^2/(2 length^2)).

    The first is half a place to the right, the second half a place down, that is, on the edges. The sum of Gaussians on
    a lattice of spacing `length` has that correlation within 1.4 %.
    """
    parts = []
    for down, right in ((0.0, 0.5), (0.5, 0.0)):
        rows, columns = _gaussians(shape[0], length, down), _gaussians(shape[1], length, right)
        parts.append((rows, columns))
    heights = _placed(count, (parts[0][0].shape[1], parts[0][1].shape[1]), rng)
    fields = [
        np.einsum("ay,kyx,bx->kab", rows, heights[..., c], columns, optimize=True)
        for c, (rows, columns) in enumerate(parts)
    ]
    return np.ascontiguousarray(np.stack(fields, axis=-1), dtype=np.float32)


def _gaussians(count: int, length: float, offset: float) -> NDArray[Any]:
    """Gaussians (places, lattice points) whose squares add up to 1 at every place."""
    half = int(np.ceil((count / 2) / length)) + 3
    centers = np.arange(-half, half + 1) * length
    places = np.arange(count) - (count - 1) / 2 + offset
    bells = np.exp(-((places[:, None] - centers) ** 2) / length**2)
    return np.asarray(bells / np.sqrt(np.sum(bells**2, axis=1, keepdims=True)))


def _placed(count: int, shape: tuple[int, int], rng: np.random.Generator) -> NDArray[Any]:
    """Values (count, H, W, 2) of variance 1 over the probes, orthogonal where colors differ."""
    rows = _cosines(count)
    color = _colors(max(count // 2, 1), shape)
    columns = rng.permutation(count)[np.stack([2 * color % count, (2 * color + 1) % count], axis=-1)]
    return np.asarray(rows[:, columns] * rng.choice([-1.0, 1.0], size=(*shape, 2)))


def _cosines(count: int) -> NDArray[Any]:
    """The orthogonal cosines (place, mode) of mean square 1."""
    k = np.arange(count)
    return np.asarray(np.cos(np.pi * k * (k[:, None] + 0.5) / count) * np.where(k == 0, 1, np.sqrt(2)))


def _colors(count: int, shape: tuple[int, int]) -> NDArray[np.int64]:
    """Color (H, W) of each place: `column + turn row` modulo the count; places of the same color are far apart."""
    rows, cols = np.mgrid[: shape[0], : shape[1]]
    return np.asarray((cols + _turn(count) * rows) % count)


@lru_cache(maxsize=32)
def _turn(count: int) -> int:
    reach = np.arange(-count, count + 1)
    y, x = np.meshgrid(reach, reach, indexing="ij")
    away = (x**2 + y**2).astype(float)
    away[(x == 0) & (y == 0)] = np.inf
    nearest = [away[(x + turn * y) % count == 0].min() for turn in range(count)]
    return int(np.argmax(nearest))


class ProbeSolver:
    """Solves for the depths of draws of slope errors, all with the same couplings; prepared once.

    Parameters
    ----------
    white, common : (N, H, W, 2), from `white_draws` and `correlated_draws`
        If H or W is even, depths are less exact along the last row or column.
    mm_per_px : (x, y), mm
    """

    def __init__(
        self, white: NDArray[np.float32], common: NDArray[np.float32], mm_per_px: tuple[float, float]
    ) -> None:
        self._white, self._common = (
            np.ascontiguousarray(np.moveaxis(draws, 0, -1)) for draws in (white, common)
        )
        self.mm_per_px = mm_per_px
        shape = white.shape[1:3]
        self._pool = Pool(lambda: (Grid(shape), Handle("batch", *shape)))

    def __call__(
        self,
        white: NDArray[np.float32],
        common: NDArray[np.float32],
        problem: LinearSystem,
        median: NDArray[np.float32] | None = None,
    ) -> NDArray[np.float32]:
        """Depths (H, W, N) within some percent, up to a constant without an anchor; the problem's slopes do not count.

        The slopes' standard deviations (H, W, 2) belong to white errors and to correlated ones. `median` (H, W, 2) is the
        weight of each slope in the median that is subtracted from all.
        """
        bias = np.zeros((2, self._white.shape[-1]), dtype=np.float32)
        if median is not None:
            bias += np.einsum("ijck,ijc->ck", self._white, white * median)
            bias += np.einsum("ijck,ijc->ck", self._common, common * median)
        depths = np.empty((*white.shape[:2], self._white.shape[-1]), dtype=np.float32)
        x_mm, y_mm = self.mm_per_px
        with self._pool.one() as (grid, batch):
            grid.load(problem, self.mm_per_px)
            _probe_depths(
                grid.handle, batch, white_draws=self._white, common_draws=self._common, white=white, common=common,
                bias=bias, scale_x=0.5 * x_mm, scale_y=0.5 * y_mm, depths=depths,
            )  # fmt: skip
        return depths
