"""One V-cycle of the multigrid hierarchy: numba kernels, float32.

All levels live in one array `data[plane, row, column]`: a level's frame pixel (i, j) is at row
`top + 1 + i`, column `1 + j`, between zeros (one row and column before, two after), so that no loop asks
where the border is. A level is given by `(top, height, width)`, a row of the table `levels`. The coarse point
(I, J) is the fine point (2I, 2J). Couplings are the positive off-diagonals of the operator: EAST ties (i, j)
to (i, j+1), SOUTH to (i+1, j), SOUTHEAST to (i+1, j+1), SOUTHWEST to (i+1, j-1).

The kernels use plain loops over few arrays each: that is what compiles quickly and uses the vector unit.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

# Kernels that Python calls. Sums may be reordered, so that those of a row use the vector unit.
KERNEL: dict[str, Any] = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract", "reassoc", "nsz", "nnan"},
}
# Kernels that kernels call: no way in from Python, and cached inside their callers. The small ones become a
# part of their callers. (Compiling takes 0.2 s a function, or more where what is inlined inlines in turn.)
INNER: dict[str, Any] = {**KERNEL, "cache": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
LEAF: dict[str, Any] = {"inline": "always"}

EAST, SOUTH, SOUTHEAST, SOUTHWEST, ANCHOR, INVERSE, RIGHT_SIDE, GUESS, ANSWER = range(9)
# The finest level's own: the depth, the search direction, the operator times it.
DEPTH, SEARCH, PRODUCT = range(9, 12)
# A coarse level's own: how much of it each fine point between is made of. LEFT and RIGHT belong to the point
# right of (I, J); UP and DOWN to the point below it; the last four to the point in the middle of four.
LEFT, RIGHT, UP, DOWN, FROM_NW, FROM_NE, FROM_SW, FROM_SE = range(9, 17)
PLANES = 17

JACOBI = np.float32(0.8)
REST = np.float32(0.2)


@njit(**LEAF)  # type: ignore[misc]
def cycle(data: Any, levels: Any, dense: Any, line: Any) -> Any:
    """Answer of the finest level, nearly the operator's inverse times its right side; returns their product.

    Symmetric and positive, so that conjugate gradients may be preconditioned with it. `line` is scratch,
    (3, W + 3).
    """
    last = levels.shape[0] - 1
    for level in range(last):
        descend(data, levels, level, line)
    product = solve_coarsest(data, levels[last, 0], levels[last, 1], levels[last, 2], dense)
    for level in range(last - 1, -1, -1):
        product = ascend(data, levels, level, line)
    return product


@njit(**INNER)  # type: ignore[misc]
def descend(data: Any, levels: Any, level: int, line: Any) -> None:
    """One Jacobi step from zero; the residual goes to the right side of the coarser level."""
    top, height, width = levels[level, 0], levels[level, 1], levels[level, 2]
    coarse_top, coarse_width = levels[level + 1, 0], levels[level + 1, 2]
    for j in range(1, coarse_width + 1):
        data[RIGHT_SIDE, coarse_top + 1, j] = 0
    for i in range(top + 1, top + height + 2):
        if i <= top + height:
            for j in range(1, width + 1):
                data[GUESS, i, j] = JACOBI * data[INVERSE, i, j] * data[RIGHT_SIDE, i, j]
        if i > top + 1:
            neighbours(data, level, i - 1, width, line)
            restrict(data, i - 1 - top, coarse_top, coarse_width, line)


@njit(**INNER)  # type: ignore[misc]
def ascend(data: Any, levels: Any, level: int, line: Any) -> Any:
    """Add the coarser level's answer, then one Jacobi step; returns right side times answer."""
    top, height, width = levels[level, 0], levels[level, 1], levels[level, 2]
    coarse_top, coarse_width = levels[level + 1, 0], levels[level + 1, 2]
    product = 0.0
    for i in range(top + 1, top + height + 2):
        if i <= top + height:
            interpolate(data, i, i - top, coarse_top, coarse_width, line)
        if i > top + 1:
            k = i - 1
            neighbours(data, level, k, width, line)
            part: Any = np.float32(0)
            for j in range(1, width + 1):
                step = JACOBI * data[INVERSE, k, j] * (line[0, j] + JACOBI * data[RIGHT_SIDE, k, j])
                data[ANSWER, k, j] = REST * data[GUESS, k, j] + step
            for j in range(1, width + 1):
                part += data[ANSWER, k, j] * data[RIGHT_SIDE, k, j]
            product += part
    return product


@njit(**LEAF)  # type: ignore[misc]
def neighbours(data: Any, level: int, i: int, width: int, line: Any) -> None:
    """Into line 0: what Jacobi leaves of the right side, and coupling times guess of all neighbours."""
    for j in range(1, width + 1):
        line[0, j] = (
            REST * data[RIGHT_SIDE, i, j]
            + data[EAST, i, j] * data[GUESS, i, j + 1]
            + data[EAST, i, j - 1] * data[GUESS, i, j - 1]
            + data[SOUTH, i, j] * data[GUESS, i + 1, j]
            + data[SOUTH, i - 1, j] * data[GUESS, i - 1, j]
        )
    if level > 0:
        for j in range(1, width + 1):
            line[0, j] += (
                data[SOUTHEAST, i, j] * data[GUESS, i + 1, j + 1]
                + data[SOUTHEAST, i - 1, j - 1] * data[GUESS, i - 1, j - 1]
                + data[SOUTHWEST, i, j] * data[GUESS, i + 1, j - 1]
                + data[SOUTHWEST, i - 1, j + 1] * data[GUESS, i - 1, j + 1]
            )


@njit(**LEAF)  # type: ignore[misc]
def restrict(data: Any, row: int, coarse_top: int, coarse_width: int, line: Any) -> None:
    """Add line 0, the residual of fine row `row` (from 1), to the coarse rows it is interpolated from."""
    i = coarse_top + (row + 1) // 2
    for j in range(coarse_width + 1):
        line[1, j] = line[0, 2 * j]
    if row % 2:
        for j in range(1, coarse_width + 1):
            data[RIGHT_SIDE, i, j] += line[0, 2 * j - 1]
        for j in range(1, coarse_width + 1):
            data[RIGHT_SIDE, i, j] += data[LEFT, i, j] * line[1, j] + data[RIGHT, i, j - 1] * line[1, j - 1]
        return
    for j in range(1, coarse_width + 1):
        line[2, j] = line[0, 2 * j - 1]
    for j in range(1, coarse_width + 1):
        data[RIGHT_SIDE, i, j] += (
            data[UP, i, j] * line[2, j]
            + data[FROM_NW, i, j] * line[1, j]
            + data[FROM_NE, i, j - 1] * line[1, j - 1]
        )
    for j in range(1, coarse_width + 1):
        data[RIGHT_SIDE, i + 1, j] = (
            data[DOWN, i, j] * line[2, j]
            + data[FROM_SW, i, j] * line[1, j]
            + data[FROM_SE, i, j - 1] * line[1, j - 1]
        )


@njit(**LEAF)  # type: ignore[misc]
def interpolate(data: Any, fine: int, row: int, coarse_top: int, coarse_width: int, line: Any) -> None:
    """Add the coarse answer to the guess of fine row `row` (from 1), which lies at `fine`."""
    i = coarse_top + (row + 1) // 2
    if row % 2:
        for j in range(1, coarse_width + 1):
            line[1, j] = data[LEFT, i, j] * data[ANSWER, i, j] + data[RIGHT, i, j] * data[ANSWER, i, j + 1]
        for j in range(1, coarse_width + 1):
            data[GUESS, fine, 2 * j - 1] += data[ANSWER, i, j]
            data[GUESS, fine, 2 * j] += line[1, j]
        return
    for j in range(1, coarse_width + 1):
        line[1, j] = (
            data[FROM_NW, i, j] * data[ANSWER, i, j]
            + data[FROM_NE, i, j] * data[ANSWER, i, j + 1]
            + data[FROM_SW, i, j] * data[ANSWER, i + 1, j]
            + data[FROM_SE, i, j] * data[ANSWER, i + 1, j + 1]
        )
    for j in range(1, coarse_width + 1):
        line[2, j] = data[UP, i, j] * data[ANSWER, i, j] + data[DOWN, i, j] * data[ANSWER, i + 1, j]
    for j in range(1, coarse_width + 1):
        data[GUESS, fine, 2 * j - 1] += line[2, j]
        data[GUESS, fine, 2 * j] += line[1, j]


@njit(**LEAF)  # type: ignore[misc]
def solve_coarsest(data: Any, top: int, height: int, width: int, dense: Any) -> Any:
    product = 0.0
    for row in range(height * width):
        value = np.float32(0)
        for column in range(height * width):
            value += dense[row, column] * data[RIGHT_SIDE, top + 1 + column // width, 1 + column % width]
        data[ANSWER, top + 1 + row // width, 1 + row % width] = value
        product += value * data[RIGHT_SIDE, top + 1 + row // width, 1 + row % width]
    return product
