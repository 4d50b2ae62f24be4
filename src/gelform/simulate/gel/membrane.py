"""A membrane on an elastic bed over an obstacle: projected multigrid, coarse to fine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.fft import dctn, idctn

from gelform.errors import ConvergenceError

TOLERANCE = 1e-5  # of the deepest point
DRAG_TOLERANCE = 1e-3
MAX_CYCLES = 100
GUESS_CYCLES = 25
SWEEPS = 2
COARSEST_SWEEPS = 20
BULGE_SAMPLES = 12  # samples per length on the grid on which the smooth bulge is computed
Map = NDArray[np.float64]


def membrane_over(obstacle: NDArray[Any], *, relaxation_px: float) -> NDArray[np.float64]:
    """The surface of least energy over an obstacle; no force across the border.

    Solves `u >= g`, `4 u - sum of neighbours + u/L^2 >= 0`, one of the two an equality at every sample.

    Parameters
    ----------
    obstacle : (H, W), >= 0
    relaxation_px : float
        The length L in samples.

    Returns
    -------
    surface : (H, W) float64, the obstacle itself bit for bit where they touch

    Raises
    ------
    ConvergenceError
        The cycles did not settle.

    Notes
    -----
    R. Kornhuber, Monotone multigrid methods for elliptic variational inequalities I, Numer. Math. 69, 1994,
    truncated: coarse grids correct only what does not touch. The smoother is C. W. Cryer's projected
    relaxation (SIAM J. Control 9(3), 1971), red-black.
    """
    g = np.ascontiguousarray(obstacle, dtype=np.float64)
    return _solved(g, relaxation_px, bulge=0.0, bulge_px=1.0)[0]


def bulging_membrane_over(
    obstacle: NDArray[Any], *, relaxation_px: float, bulge: float, bulge_px: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The membrane w and the bulge b of a gel that gives back the part `bulge` of what it is displaced by.

    w is the membrane over `obstacle + b`, and b is `bulge` times w spread over the length `bulge_px` by the
    kernel K0(r/h)/(2 pi h^2), whose integral is 1: `b - h^2 laplace(b) = bulge w`. The surface is w - b: the
    obstacle where they touch, and its volume over the whole grid is (1 - bulge) times that of w.

    Parameters
    ----------
    obstacle : (H, W); below 0 where the gel would be touched only if it rises
    relaxation_px, bulge_px : lengths in samples
    bulge : 0 (compressible) to 1 (incompressible), 1 excluded

    Returns
    -------
    membrane, bulge : (H, W) float64 each
    """
    g = np.ascontiguousarray(obstacle, dtype=np.float64)
    return _solved(g, relaxation_px, bulge=bulge, bulge_px=bulge_px)


@dataclass(frozen=True)
class _Level:
    """One grid of the multigrid cycle.

    u is the unknown with a border of ghosts, g its lower bound, f the right-hand side, r the residual, `free`
    where u may move, `spring` the bed's stiffness per sample, 1/L^2.
    """

    u: Map
    g: Map
    f: Map
    r: Map
    free: NDArray[np.bool_]
    spring: float


def _solved(
    g: Map, relaxation_px: float, *, bulge: float, bulge_px: float, guess: bool = False
) -> tuple[Map, Map]:
    """First guess from the grid of half the resolution, then cycles until the change is below the tolerance.

    A first guess may stop short of that: on a coarse relief two contacts can take turns for ever.
    """
    u, b = _coarse_guess(g, relaxation_px, bulge, bulge_px)
    levels = _levels(g.shape, relaxation_px)
    top = levels[0]
    np.maximum(g + b, 0, out=top.g)
    top.u[1:-1, 1:-1] = np.maximum(u, top.g)
    target = TOLERANCE * max(float(g.max()), 1e-12)
    before, change = np.empty_like(top.u), np.inf
    for _ in range(GUESS_CYCLES if guess else MAX_CYCLES):
        before[:] = top.u
        _cycle(levels, 0)
        change = float(_largest_change(before, top.u))
        if bulge > 0:
            risen = spread(top.u[1:-1, 1:-1], bulge_px) * bulge
            change = max(change, float(np.abs(risen - b).max()))
            b = risen
            np.maximum(g + b, 0, out=top.g)
        if change <= target:
            return np.maximum(top.u[1:-1, 1:-1], top.g), b
    if guess:
        return np.maximum(top.u[1:-1, 1:-1], top.g), b
    raise ConvergenceError(
        f"The gel's surface did not settle in {MAX_CYCLES} cycles (change {change:.3g}). "
        f"Its relaxation length is {relaxation_px:.3g} samples: simulate with another oversample."
    )


def spread(values: Map, length_px: float) -> Map:
    """Values smoothed by K0(r/h)/(2 pi h^2), mirrored at the border, so that their sum stays.

    By cosine transform on a coarser grid: the result is smooth over the length.
    """
    factor = max(1, int(length_px / BULGE_SAMPLES))
    height, width = values.shape
    small = cv2.resize(
        values, (max(2, width // factor), max(2, height // factor)), interpolation=cv2.INTER_AREA
    )
    rows, columns = small.shape
    ky = 2 - 2 * np.cos(np.pi * np.arange(rows) / rows)
    kx = 2 - 2 * np.cos(np.pi * np.arange(columns) / columns)
    hy, hx = length_px * rows / height, length_px * columns / width
    smooth = idctn(dctn(small, type=2) / (1 + hy**2 * ky[:, None] + hx**2 * kx[None, :]), type=2)
    if smooth.shape == values.shape:
        return np.asarray(smooth, dtype=np.float64)
    return np.asarray(cv2.resize(smooth, (width, height), interpolation=cv2.INTER_CUBIC), dtype=np.float64)


def carried_along(values: Map, fixed: NDArray[np.bool_], length_px: float) -> Map:
    """Values kept where `fixed` and falling off over a length beside: v = h^2 laplace(v), no flux at the border.

    The values that are not fixed are the first guess; the result is good to a thousandth of the largest value.
    """
    levels = _levels(values.shape, length_px)
    top = levels[0]
    top.u[1:-1, 1:-1] = values
    top.free[:] = ~fixed
    target = DRAG_TOLERANCE * max(float(np.abs(top.u).max()), 1e-9)
    before = np.empty_like(top.u)
    for _ in range(MAX_CYCLES):
        before[:] = top.u
        _cycle(levels, 0)
        if _largest_change(before, top.u) <= target:
            return top.u[1:-1, 1:-1].copy()
    raise ConvergenceError(f"The gel's drag did not settle in {MAX_CYCLES} cycles.")


def _coarse_guess(g: Map, relaxation_px: float, bulge: float, bulge_px: float) -> tuple[Map, Map]:
    """The solution on a grid of half the resolution, brought to this one."""
    if relaxation_px < 2 or min(g.shape) < 8:
        return np.zeros(g.shape), np.zeros(g.shape)
    height, width = g.shape
    even = np.pad(g, ((0, height % 2), (0, width % 2)), mode="edge")
    halved = even.reshape(even.shape[0] // 2, 2, even.shape[1] // 2, 2).max(axis=(1, 3))
    coarse = _solved(halved, relaxation_px / 2, bulge=bulge, bulge_px=bulge_px / 2, guess=True)
    fine = [cv2.resize(part, even.shape[::-1], interpolation=cv2.INTER_LINEAR) for part in coarse]
    return np.asarray(fine[0][:height, :width]), np.asarray(fine[1][:height, :width])


def _levels(shape: tuple[int, ...], relaxation_px: float) -> list[_Level]:
    """Grids from fine to coarse, until the bed or the size makes relaxation alone quick."""
    levels = []
    height, width = shape
    spring = relaxation_px**-2
    while True:
        size = (height, width)
        u, lowest = np.zeros((height + 2, width + 2)), np.full(size, -np.inf)
        levels.append(_Level(u, lowest, np.zeros(size), np.zeros(size), np.ones(size, dtype=bool), spring))
        if min(size) < 5 or spring > 2:
            return levels
        height, width, spring = (height + 1) // 2, (width + 1) // 2, 4 * spring


def _cycle(levels: list[_Level], k: int) -> None:
    """One V-cycle: relax, correct by the next coarser grid what does not touch, relax."""
    level = levels[k]
    if k == len(levels) - 1:
        _relax(level.u, level.g, level.f, level.free, level.spring, COARSEST_SWEEPS)
        return
    _relax(level.u, level.g, level.f, level.free, level.spring, SWEEPS)
    _residual(level.u, level.g, level.f, level.free, level.spring, level.r)
    moves = level.free & (level.u[1:-1, 1:-1] > level.g)
    coarse = levels[k + 1]
    _restrict(level.r, moves, coarse.f, coarse.free)
    coarse.u[:] = 0
    _cycle(levels, k + 1)
    _correct(level.u, level.g, moves, coarse.u)
    _relax(level.u, level.g, level.f, level.free, level.spring, SWEEPS)


@njit(cache=True)  # type: ignore[untyped-decorator]
def _largest_change(before: Any, after: Any) -> float:
    largest = 0.0
    for i in range(1, after.shape[0] - 1):
        for j in range(1, after.shape[1] - 1):
            largest = max(largest, abs(after[i, j] - before[i, j]))
    return largest


@njit(cache=True)  # type: ignore[untyped-decorator]
def _ghosts(u: Any) -> None:
    for j in range(u.shape[1]):
        u[0, j], u[-1, j] = u[1, j], u[-2, j]
    for i in range(u.shape[0]):
        u[i, 0], u[i, -1] = u[i, 1], u[i, -2]


@njit(cache=True)  # type: ignore[untyped-decorator]
def _relax(u: Any, g: Any, f: Any, free: Any, spring: float, sweeps: int) -> None:
    """Projected Gauss-Seidel, red-black; only the finest grid has an obstacle, only coarser ones a mask."""
    factor = 1 / (4 + spring)
    for half in range(2 * sweeps):
        _ghosts(u)
        for i in range(g.shape[0]):
            for j in range((i + half) % 2, g.shape[1], 2):
                if free[i, j]:
                    total = u[i, j + 1] + u[i + 2, j + 1] + u[i + 1, j] + u[i + 1, j + 2] + f[i, j]
                    u[i + 1, j + 1] = max(factor * total, g[i, j])


@njit(cache=True)  # type: ignore[untyped-decorator]
def _residual(u: Any, g: Any, f: Any, free: Any, spring: float, r: Any) -> None:
    """The residual at samples that are free and do not touch; 0 elsewhere."""
    _ghosts(u)
    for i in range(f.shape[0]):
        for j in range(f.shape[1]):
            r[i, j] = 0
            if free[i, j] and u[i + 1, j + 1] > g[i, j]:
                total = u[i, j + 1] + u[i + 2, j + 1] + u[i + 1, j] + u[i + 1, j + 2] + f[i, j]
                r[i, j] = total - (4 + spring) * u[i + 1, j + 1]


@njit(cache=True)  # type: ignore[untyped-decorator]
def _restrict(r: Any, moves: Any, coarse: Any, coarse_moves: Any) -> None:
    """Four times the mean of 2x2 residuals (the spacing doubles); a sample moves if all its four do."""
    height, width = r.shape
    for i in range(coarse.shape[0]):
        i0, i1 = 2 * i, min(2 * i + 1, height - 1)
        for j in range(coarse.shape[1]):
            j0, j1 = 2 * j, min(2 * j + 1, width - 1)
            coarse[i, j] = r[i0, j0] + r[i1, j0] + r[i0, j1] + r[i1, j1]
            coarse_moves[i, j] = moves[i0, j0] and moves[i1, j0] and moves[i0, j1] and moves[i1, j1]


@njit(cache=True)  # type: ignore[untyped-decorator]
def _correct(u: Any, g: Any, moves: Any, coarse: Any) -> None:
    """Add the coarse correction, bilinear between coarse centres, to what does not touch."""
    _ghosts(coarse)
    for i in range(g.shape[0]):
        i0 = i // 2 + 1
        i1 = i0 - 1 if i % 2 == 0 else i0 + 1
        for j in range(g.shape[1]):
            if moves[i, j]:
                j0 = j // 2 + 1
                j1 = j0 - 1 if j % 2 == 0 else j0 + 1
                beside = coarse[i1, j0] + coarse[i0, j1]
                change = 0.5625 * coarse[i0, j0] + 0.1875 * beside + 0.0625 * coarse[i1, j1]
                u[i + 1, j + 1] = max(u[i + 1, j + 1] + change, g[i, j])
