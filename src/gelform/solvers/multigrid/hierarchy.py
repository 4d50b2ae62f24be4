"""Coarse operators for the multigrid solver, computed from the fine one: numba kernels, float32.

Black-box multigrid (J. E. Dendy, Black box multigrid, J. Comput. Phys. 48, 1982): interpolation weights come
from the operator itself, so that they follow jumps of the weights by any factor. A point between two coarse
points takes its collapsed couplings to the left and right column (or the rows above and below) as weights;
the point in the middle of four is eliminated exactly. The coarse operator is P^T A P, assembled cell by cell
as in finite elements: a cell has four coarse corners, four edge points and one middle point.

The diagonal is never stored: it is the sum of the couplings and the anchor, which keeps row sums exact in
float32. Without an anchor P 1 = 1. With one, P 1 = 1 - lack, and the coarse anchor P^T A P 1 is computed from
the lacks alone, where nothing cancels.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from gelform.solvers.multigrid.cycle import (
    ANCHOR,
    EAST,
    INNER,
    INVERSE,
    KERNEL,
    LEAF,
    LEFT,
    SOUTH,
    SOUTHEAST,
    SOUTHWEST,
)

ZERO = np.float32(0)
ONE = np.float32(1)
# Added to a sum of couplings that may be 0, so that 0/0 is 0 without a branch.
TINY = np.float32(1e-30)

# A strip of cells is gathered into lines of scratch `t[LINE + j]`: contiguous, at known distances, hence
# vectorised. Lines 0 to 7: the weights of interpolation, in the order of their planes LEFT ... FROM_SE.
# Lines nearer than 1 KiB make the compiler fear for store forwarding, and halve the vectors.
N = 272
STRIP = 160
T_LEFT, T_RIGHT, T_UP, T_DOWN, T_NW, T_NE, T_SW, T_SE = (N * k for k in range(8))
LOW_LEFT, LOW_RIGHT, LACK_TOP, LACK_LOW, LACK_SIDE = (N * k for k in range(8, 13))
IN_1, IN_2, IN_3, IN_4, IN_5 = (N * k for k in range(13, 18))
# Diagonal couplings: these lines stay 0 on the finest level, which has none.
SIDE_1, SIDE_2, CORNER_1, CORNER_2, CORNER_3, CORNER_4 = (N * k for k in range(18, 24))
TIE_1, TIE_2, TIE_3, TIE_4 = (N * k for k in range(24, 28))
TO_EAST, TO_SOUTH, TO_LOW_EAST, TO_FAR_SOUTH, FALLING, RISING = (N * k for k in range(28, 34))
A_NW, A_NE, A_SW, A_SE, A_CORNER = (N * k for k in range(34, 39))
WEIGHT_1, WEIGHT_2, LACK = (N * k for k in range(39, 42))
LINES = 42

# What is gathered from the fine level: line, plane, row and column relative to the point in question, and
# whether it is added to what the line holds. The finest level skips all from the first diagonal on.
HORIZONTAL = np.array(
    [
        (IN_1, EAST, 0, -1, 0),
        (IN_2, EAST, 0, 0, 0),
        (IN_3, ANCHOR, 0, 0, 0),
        (SIDE_1, SOUTHEAST, -1, -1, 0),
        (SIDE_1, SOUTHWEST, 0, 0, 1),
        (SIDE_2, SOUTHEAST, 0, 0, 0),
        (SIDE_2, SOUTHWEST, -1, 1, 1),
    ]
)
VERTICAL = np.array(
    [
        (IN_1, SOUTH, -1, 0, 0),
        (IN_2, SOUTH, 0, 0, 0),
        (IN_3, ANCHOR, 0, 0, 0),
        (SIDE_1, SOUTHEAST, -1, -1, 0),
        (SIDE_1, SOUTHWEST, -1, 1, 1),
        (SIDE_2, SOUTHEAST, 0, 0, 0),
        (SIDE_2, SOUTHWEST, 0, 0, 1),
    ]
)
MIDDLE = np.array(
    [
        (IN_1, SOUTH, -1, 0, 0),
        (IN_2, SOUTH, 0, 0, 0),
        (IN_3, EAST, 0, -1, 0),
        (IN_4, EAST, 0, 0, 0),
        (IN_5, ANCHOR, 0, 0, 0),
        (A_CORNER, ANCHOR, -1, -1, 0),
        (CORNER_1, SOUTHEAST, -1, -1, 0),
        (CORNER_2, SOUTHWEST, -1, 1, 0),
        (CORNER_3, SOUTHWEST, 0, 0, 0),
        (CORNER_4, SOUTHEAST, 0, 0, 0),
        (TIE_1, SOUTHWEST, -1, 0, 0),
        (TIE_2, SOUTHEAST, -1, 0, 0),
        (TIE_3, SOUTHEAST, 0, -1, 0),
        (TIE_4, SOUTHWEST, 0, 1, 0),
    ]
)
# What is added to the coarse level: line, plane, row and column relative to the coarse point.
FROM_HORIZONTAL = np.array([(TO_EAST, EAST, 0, 0), (A_NW, ANCHOR, 0, 0), (A_NE, ANCHOR, 0, 1)])
FROM_VERTICAL = np.array([(TO_EAST, SOUTH, 0, 0), (A_NW, ANCHOR, 0, 0), (A_NE, ANCHOR, 1, 0)])
FROM_CELLS = np.array(
    [
        (TO_EAST, EAST, 0, 0),
        (TO_SOUTH, SOUTH, 0, 0),
        (TO_LOW_EAST, EAST, 1, 0),
        (TO_FAR_SOUTH, SOUTH, 0, 1),
        (FALLING, SOUTHEAST, 0, 0),
        (RISING, SOUTHWEST, 0, 1),
        (A_NW, ANCHOR, 0, 0),
        (A_NE, ANCHOR, 0, 1),
        (A_SW, ANCHOR, 1, 0),
        (A_SE, ANCHOR, 1, 1),
        (A_CORNER, ANCHOR, 0, 0),
    ]
    + [(N * k, LEFT + k, 0, 0) for k in range(8)]
)


@njit(**KERNEL)  # type: ignore[misc]
def build(data: Any, levels: Any, dense: Any, t: Any, a: Any) -> None:
    """All coarse levels from the couplings and the anchor of the finest, and the inverse of the coarsest.

    `t` (LINES * N,), of zeros, and `a` (40, 80) are scratch.
    """
    last = levels.shape[0] - 1
    for level in range(last):
        invert_diagonal(data, levels[level, 0], levels[level, 1], levels[level, 2], level)
        coarsen(data, levels, level, t)
    invert(data, levels[last, 0], levels[last, 1], levels[last, 2], last, dense, a)


@njit(**LEAF)  # type: ignore[misc]
def invert_diagonal(data: Any, top: int, height: int, width: int, level: int) -> None:
    for i in range(top + 1, top + height + 1):
        for j in range(1, width + 1):
            total = data[EAST, i, j] + data[EAST, i, j - 1] + data[SOUTH, i, j] + data[SOUTH, i - 1, j]
            # An anchor that rounding made negative counts as none.
            anchor = data[ANCHOR, i, j]
            data[INVERSE, i, j] = total + (anchor if anchor > ZERO else ZERO)
        if level > 0:
            for j in range(1, width + 1):
                data[INVERSE, i, j] += (
                    data[SOUTHEAST, i, j]
                    + data[SOUTHEAST, i - 1, j - 1]
                    + data[SOUTHWEST, i, j]
                    + data[SOUTHWEST, i - 1, j + 1]
                )
        for j in range(1, width + 1):
            total = data[INVERSE, i, j]
            data[INVERSE, i, j] = ONE / total if total > ZERO else ZERO


@njit(**INNER)  # type: ignore[misc]
def coarsen(data: Any, levels: Any, level: int, t: Any) -> None:
    """Interpolation weights and couplings of the next coarser level, in strips of cells, downwards."""
    top, coarse_top = levels[level, 0], levels[level + 1, 0]
    height, width = levels[level + 1, 1], levels[level + 1, 2]
    for plane in range(LEFT + 8):
        if plane <= ANCHOR or plane >= LEFT:
            for i in range(coarse_top + 1, coarse_top + height + 1):
                for j in range(1, width + 1):
                    data[plane, i, j] = 0
    for start in range(1, width + 1, STRIP):
        n = width + 1 - start
        n = n if n < STRIP else STRIP
        for row in range(height + 1):
            i, k = coarse_top + row, top + 2 * row
            for j in range(n):
                t[T_LEFT + j], t[T_RIGHT + j], t[LACK_TOP + j] = (
                    t[LOW_LEFT + j],
                    t[LOW_RIGHT + j],
                    t[LACK_LOW + j],
                )
                t[LOW_LEFT + j] = t[LOW_RIGHT + j] = t[LACK_LOW + j] = 0
            if row < height:
                # Points between two coarse points of the row below: the lower sides of a row of cells.
                gather(data, HORIZONTAL, k + 1, 2 * start, n, level, t)
                between(t, n)
                scatter(data, FROM_HORIZONTAL, i + 1, start, n, t)
                for j in range(n):
                    t[LOW_LEFT + j], t[LOW_RIGHT + j], t[LACK_LOW + j] = (
                        t[WEIGHT_1 + j],
                        t[WEIGHT_2 + j],
                        t[LACK + j],
                    )
            if row > 0:
                # Points below a coarse point: the left sides of the cells, and the right side of the last.
                gather(data, VERTICAL, k, 2 * start - 1, n + 1, level, t)
                between(t, n + 1)
                scatter(data, FROM_VERTICAL, i, start, n, t)
                for j in range(n + 1):
                    t[T_UP + j], t[T_DOWN + j], t[LACK_SIDE + j] = (
                        t[WEIGHT_1 + j],
                        t[WEIGHT_2 + j],
                        t[LACK + j],
                    )
                gather(data, MIDDLE, k, 2 * start, n, level, t)
                cells(t, n)
                if level > 0:
                    diagonals(t, n)
                scatter(data, FROM_CELLS, i, start, n, t)


@njit(**INNER)  # type: ignore[misc]
def gather(data: Any, table: Any, k: int, c: int, n: int, level: int, t: Any) -> None:
    """Fetch what a row of points at (k, c), (k, c + 2) ... needs."""
    for item in range(table.shape[0]):
        line, plane = table[item, 0], table[item, 1]
        row, column = k + table[item, 2], c + table[item, 3]
        if level == 0 and plane in (SOUTHEAST, SOUTHWEST):
            break
        fetch(data, plane, row, column, n, t, line, table[item, 4])


@njit(**INNER)  # type: ignore[misc]
def scatter(data: Any, table: Any, i: int, start: int, n: int, t: Any) -> None:
    """Add what a row of points hands to the coarse points from (i, start) on."""
    for item in range(table.shape[0]):
        add(data, table[item, 1], i + table[item, 2], start + table[item, 3], n, t, table[item, 0])


# In the next two, the first lines tell the compiler that indices are not negative: it then need not count
# them from the end, and vectorises.


@njit(**INNER)  # type: ignore[misc]
def fetch(data: Any, plane: int, row: int, column: int, n: int, t: Any, line: int, more: int) -> None:
    if line < 0 or column < 0:
        return
    if more:
        for j in range(n):
            t[line + j] += data[plane, row, column + 2 * j]
    else:
        for j in range(n):
            t[line + j] = data[plane, row, column + 2 * j]


@njit(**INNER)  # type: ignore[misc]
def add(data: Any, plane: int, row: int, column: int, n: int, t: Any, line: int) -> None:
    if line < 0 or column < 0:
        return
    for j in range(n):
        data[plane, row, column + j] += t[line + j]


@njit(**INNER)  # type: ignore[misc]
def between(t: Any, n: int) -> None:
    """Weights of points between two coarse points, and what their two fine edges hand to the coarse edge.

    In: couplings to both (IN_1, IN_2), anchor (IN_3), collapsed diagonal couplings to both (SIDE_1, SIDE_2).
    Out: both weights, lack, the coarse coupling (TO_EAST), the anchors of both coarse points (A_NW, A_NE).
    """
    for j in range(n):
        c1, c2, anchor = t[IN_1 + j], t[IN_2 + j], t[IN_3 + j]
        w1, w2 = c1 + t[SIDE_1 + j], c2 + t[SIDE_2 + j]
        # Where columns hold together far more than rows, collapsed couplings can be negative, a little.
        w1 = w1 if w1 > ZERO else -w1
        w2 = w2 if w2 > ZERO else -w2
        total = w1 + w2 + anchor
        scale = ONE / (total + TINY)
        w1, w2, missing = w1 * scale, w2 * scale, anchor * scale
        stiff = c1 + c2 + anchor
        rest = anchor - stiff * missing
        t[WEIGHT_1 + j], t[WEIGHT_2 + j], t[LACK + j] = w1, w2, missing
        t[TO_EAST + j] = c1 * w2 + c2 * w1 - w1 * w2 * stiff
        t[A_NW + j] = c1 * missing + w1 * rest
        t[A_NE + j] = c2 * missing + w2 * rest


@njit(**INNER)  # type: ignore[misc]
def cells(t: Any, n: int) -> None:
    """Eliminate the middle points of a row of cells."""
    for j in range(n):
        tl, tr, bl, br = t[T_LEFT + j], t[T_RIGHT + j], t[LOW_LEFT + j], t[LOW_RIGHT + j]
        lu, ld, ru, rd = t[T_UP + j], t[T_DOWN + j], t[T_UP + j + 1], t[T_DOWN + j + 1]
        c_top, c_low, c_west, c_east = t[IN_1 + j], t[IN_2 + j], t[IN_3 + j], t[IN_4 + j]
        top, low = c_top * t[LACK_TOP + j], c_low * t[LACK_LOW + j]
        west, east = c_west * t[LACK_SIDE + j], c_east * t[LACK_SIDE + j + 1]
        # The middle point's couplings, collapsed onto the corners.
        nw = tl * c_top + lu * c_west + t[CORNER_1 + j]
        ne = tr * c_top + ru * c_east + t[CORNER_2 + j]
        sw = bl * c_low + ld * c_west + t[CORNER_3 + j]
        se = br * c_low + rd * c_east + t[CORNER_4 + j]
        lack = top + low + west + east + t[IN_5 + j]
        total = nw + ne + sw + se + lack
        scale = ONE / (total + TINY)
        lack *= scale
        from_nw, from_ne, from_sw, from_se = nw * scale, ne * scale, sw * scale, se * scale
        t[T_NW + j], t[T_NE + j], t[T_SW + j], t[T_SE + j] = from_nw, from_ne, from_sw, from_se
        t[TO_EAST + j] = nw * from_ne - tl * tr * c_top
        t[TO_SOUTH + j] = nw * from_sw - lu * ld * c_west
        t[TO_LOW_EAST + j] = sw * from_se - bl * br * c_low
        t[TO_FAR_SOUTH + j] = ne * from_se - ru * rd * c_east
        t[FALLING + j] = nw * from_se
        t[RISING + j] = ne * from_sw
        t[A_NW + j] = nw * lack - tl * top - lu * west
        t[A_NE + j] = ne * lack - tr * top - ru * east
        t[A_SW + j] = sw * lack - bl * low - ld * west
        t[A_SE + j] = se * lack - br * low - rd * east


@njit(**INNER)  # type: ignore[misc]
def diagonals(t: Any, n: int) -> None:
    """What the couplings between edge points, across the corners of the fine cells, hand on."""
    for j in range(n):
        tl, tr, bl, br = t[T_LEFT + j], t[T_RIGHT + j], t[LOW_LEFT + j], t[LOW_RIGHT + j]
        lu, ld, ru, rd = t[T_UP + j], t[T_DOWN + j], t[T_UP + j + 1], t[T_DOWN + j + 1]
        top, low, west, east = t[LACK_TOP + j], t[LACK_LOW + j], t[LACK_SIDE + j], t[LACK_SIDE + j + 1]
        w1, w2, w3, w4 = t[TIE_1 + j], t[TIE_2 + j], t[TIE_3 + j], t[TIE_4 + j]
        nw, ne, sw, se = w1 * (tl - lu), w2 * (tr - ru), w3 * (ld - bl), w4 * (rd - br)
        t[TO_EAST + j] -= nw * tr + ne * tl
        t[TO_SOUTH + j] += nw * ld - sw * lu
        t[TO_LOW_EAST + j] += sw * br + se * bl
        t[TO_FAR_SOUTH + j] += ne * rd - se * ru
        t[FALLING + j] += w2 * tl * rd + w3 * lu * br
        t[RISING + j] += w1 * tr * ld + w4 * ru * bl
        d1, d2, d3, d4 = west - top, east - top, low - west, low - east
        t[A_NW + j] += nw * d1 + w2 * tl * d2 + w3 * lu * d3
        t[A_NE + j] += w1 * tr * d1 + ne * d2 + w4 * ru * d4
        t[A_SW + j] += sw * d3 - w1 * ld * d1 - w4 * bl * d4
        t[A_SE + j] += se * d4 - w2 * rd * d2 - w3 * br * d3


@njit(**INNER)  # type: ignore[misc]
def invert(data: Any, top: int, height: int, width: int, level: int, dense: Any, a: Any) -> None:
    """Inverse of the coarsest operator by Gauss-Jordan elimination in float64.

    Points tied to no anchor have no absolute height: the last pivot among them is 0, and it stays at 0.
    """
    n = height * width
    for row in range(n):
        for column in range(2 * n):
            a[row, column] = 0
    largest = 0.0
    for row in range(n):
        i, j = top + 1 + row // width, 1 + row % width
        a[row, row] += data[ANCHOR, i, j] if data[ANCHOR, i, j] > ZERO else ZERO
        a[row, n + row] = 1
        tie(a, row, row + 1, data[EAST, i, j])
        tie(a, row, row + width, data[SOUTH, i, j])
        if level > 0:
            tie(a, row, row + width + 1, data[SOUTHEAST, i, j])
            tie(a, row, row + width - 1, data[SOUTHWEST, i, j])
        largest = a[row, row] if a[row, row] > largest else largest
    for pivot in range(n):
        value = a[pivot, pivot]
        scale = 1 / value if value > 1e-9 * largest else 0.0
        for column in range(pivot, 2 * n):
            a[pivot, column] *= scale
        for row in range(n):
            factor = a[row, pivot]
            if row != pivot and factor != 0:
                for column in range(pivot, 2 * n):
                    a[row, column] -= factor * a[pivot, column]
    for row in range(n):
        for column in range(n):
            dense[row, column] = a[row, n + column]


@njit(**LEAF)  # type: ignore[misc]
def tie(a: Any, row: int, other: int, coupling: float) -> None:
    if coupling != 0:
        a[row, row] += coupling
        a[other, other] += coupling
        a[row, other] -= coupling
        a[other, row] -= coupling
