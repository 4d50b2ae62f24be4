"""The V-cycle for many right sides at once: numba kernels, float32.

The couplings are those of `hierarchy`; what belongs to a right side has the right sides as its last axis,
`r[row, column, lane]`, so that every coupling is read once for all of them, and the small frames of coarse
levels use the vector unit as well as large ones do. The loops over lanes read few places each: the compiler
makes sure that they do not overlap with what is written, and gives up vectors where it would take too much.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from gelform.solvers.multigrid.cycle import (
    ANCHOR,
    DOWN,
    EAST,
    FROM_NE,
    FROM_NW,
    FROM_SE,
    FROM_SW,
    INNER,
    INVERSE,
    JACOBI,
    KERNEL,
    LEAF,
    LEFT,
    REST,
    RIGHT,
    SOUTH,
    SOUTHEAST,
    SOUTHWEST,
    UP,
)


@njit(**KERNEL)  # type: ignore[misc]
def solve_lanes(data: Any, levels: Any, dense: Any, r: Any, g: Any, a: Any, depths: Any) -> None:
    """Depths (H, W, lanes) of the right sides in `r`, to some percent: two V-cycles.

    The first is scaled as one step of conjugate gradients would be. `g` and `a` are scratch of the shape of
    `r`: (rows of all levels, W + 3, lanes).
    """
    height, width, lanes = depths.shape
    up = np.zeros(lanes, dtype=np.float32)
    down = np.zeros(lanes, dtype=np.float32)
    cycle(data, levels, dense, r, g, a)
    for i in range(1, height + 1):
        for j in range(1, width + 1):
            anchor, east, west = data[ANCHOR, i, j], data[EAST, i, j], data[EAST, i, j - 1]
            south, north = data[SOUTH, i, j], data[SOUTH, i - 1, j]
            for m in range(lanes):
                here = a[i, j, m]
                g[i, j, m] = (
                    anchor * here
                    + east * (here - a[i, j + 1, m])
                    + west * (here - a[i, j - 1, m])
                    + south * (here - a[i + 1, j, m])
                    + north * (here - a[i - 1, j, m])
                )
            for m in range(lanes):
                up[m] += a[i, j, m] * r[i, j, m]
            for m in range(lanes):
                down[m] += a[i, j, m] * g[i, j, m]
    for m in range(lanes):
        up[m] = up[m] / down[m] if down[m] > 0 else np.float32(0)
    for i in range(1, height + 1):
        for j in range(1, width + 1):
            for m in range(lanes):
                depths[i - 1, j - 1, m] = up[m] * a[i, j, m]
                r[i, j, m] -= up[m] * g[i, j, m]
    cycle(data, levels, dense, r, g, a)
    for i in range(1, height + 1):
        for j in range(1, width + 1):
            for m in range(lanes):
                depths[i - 1, j - 1, m] += a[i, j, m]


@njit(**INNER)  # type: ignore[misc]
def cycle(data: Any, levels: Any, dense: Any, r: Any, g: Any, a: Any) -> None:
    """Answers `a` of the finest level to the right sides `r`; see `gelform.solvers.multigrid.cycle.cycle`."""
    last = levels.shape[0] - 1
    for level in range(last):
        descend(data, levels, level, r, g, a)
    solve_coarsest(levels[last, 0], levels[last, 1], levels[last, 2], dense, r, a)
    for level in range(last - 1, -1, -1):
        ascend(data, levels, level, r, g, a)


@njit(**INNER)  # type: ignore[misc]
def descend(data: Any, levels: Any, level: int, r: Any, g: Any, a: Any) -> None:
    """One Jacobi step from zero; the residual, kept in `a` for a moment, goes to the coarser level."""
    top, height, width = levels[level, 0], levels[level, 1], levels[level, 2]
    lanes = r.shape[2]
    for i in range(top + 1, top + height + 1):
        for j in range(1, width + 1):
            scale = JACOBI * data[INVERSE, i, j]
            for m in range(lanes):
                g[i, j, m] = scale * r[i, j, m]
    for i in range(top + 1, top + height + 1):
        for j in range(1, width + 1):
            tied(data, level, i, j, REST, r, g, a)
    coarse_top, coarse_height, coarse_width = levels[level + 1, 0], levels[level + 1, 1], levels[level + 1, 2]
    for row in range(1, coarse_height + 1):
        i, k = coarse_top + row, top + 2 * row - 1
        for j in range(1, coarse_width + 1):
            c = 2 * j - 1
            right, left, low, high = (
                data[LEFT, i, j],
                data[RIGHT, i, j - 1],
                data[UP, i, j],
                data[DOWN, i - 1, j],
            )
            se, sw = data[FROM_NW, i, j], data[FROM_NE, i, j - 1]
            ne, nw = data[FROM_SW, i - 1, j], data[FROM_SE, i - 1, j - 1]
            for m in range(lanes):
                r[i, j, m] = a[k, c, m] + right * a[k, c + 1, m] + left * a[k, c - 1, m]
            for m in range(lanes):
                r[i, j, m] += low * a[k + 1, c, m] + se * a[k + 1, c + 1, m] + sw * a[k + 1, c - 1, m]
            for m in range(lanes):
                r[i, j, m] += high * a[k - 1, c, m] + ne * a[k - 1, c + 1, m] + nw * a[k - 1, c - 1, m]


@njit(**INNER)  # type: ignore[misc]
def ascend(data: Any, levels: Any, level: int, r: Any, g: Any, a: Any) -> None:
    """Add the coarser level's answer, then one Jacobi step."""
    top, height, width = levels[level, 0], levels[level, 1], levels[level, 2]
    coarse_top, coarse_height, coarse_width = levels[level + 1, 0], levels[level + 1, 1], levels[level + 1, 2]
    lanes = r.shape[2]
    for row in range(1, coarse_height + 1):
        i, k = coarse_top + row, top + 2 * row - 1
        for j in range(1, coarse_width + 1):
            c = 2 * j - 1
            left, right, up, down = data[LEFT, i, j], data[RIGHT, i, j], data[UP, i, j], data[DOWN, i, j]
            nw, ne = data[FROM_NW, i, j], data[FROM_NE, i, j]
            sw, se = data[FROM_SW, i, j], data[FROM_SE, i, j]
            for m in range(lanes):
                g[k, c, m] += a[i, j, m]
            for m in range(lanes):
                g[k, c + 1, m] += left * a[i, j, m] + right * a[i, j + 1, m]
            for m in range(lanes):
                g[k + 1, c, m] += up * a[i, j, m] + down * a[i + 1, j, m]
            for m in range(lanes):
                g[k + 1, c + 1, m] += (
                    nw * a[i, j, m] + ne * a[i, j + 1, m] + sw * a[i + 1, j, m] + se * a[i + 1, j + 1, m]
                )
    one = np.float32(1)
    for i in range(top + 1, top + height + 1):
        for j in range(1, width + 1):
            tied(data, level, i, j, one, r, g, a)
            scale = JACOBI * data[INVERSE, i, j]
            for m in range(lanes):
                a[i, j, m] = REST * g[i, j, m] + scale * a[i, j, m]


@njit(**LEAF)  # type: ignore[misc]
def tied(data: Any, level: int, i: int, j: int, share: Any, r: Any, g: Any, a: Any) -> None:
    """Into `a`: a share of the right side, and coupling times guess of all neighbours."""
    east, west, south, north = (
        data[EAST, i, j],
        data[EAST, i, j - 1],
        data[SOUTH, i, j],
        data[SOUTH, i - 1, j],
    )
    for m in range(r.shape[2]):
        a[i, j, m] = (
            share * r[i, j, m]
            + east * g[i, j + 1, m]
            + west * g[i, j - 1, m]
            + south * g[i + 1, j, m]
            + north * g[i - 1, j, m]
        )
    if level > 0:
        se, nw = data[SOUTHEAST, i, j], data[SOUTHEAST, i - 1, j - 1]
        sw, ne = data[SOUTHWEST, i, j], data[SOUTHWEST, i - 1, j + 1]
        for m in range(r.shape[2]):
            a[i, j, m] += (
                se * g[i + 1, j + 1, m]
                + nw * g[i - 1, j - 1, m]
                + sw * g[i + 1, j - 1, m]
                + ne * g[i - 1, j + 1, m]
            )


@njit(**INNER)  # type: ignore[misc]
def solve_coarsest(top: int, height: int, width: int, dense: Any, r: Any, a: Any) -> None:
    for row in range(height * width):
        i, j = top + 1 + row // width, 1 + row % width
        for m in range(r.shape[2]):
            a[i, j, m] = 0
        for column in range(height * width):
            k, c = top + 1 + column // width, 1 + column % width
            share = dense[row, column]
            for m in range(r.shape[2]):
                a[i, j, m] += share * r[k, c, m]
