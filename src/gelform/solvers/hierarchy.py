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

from gelform.solvers.cycle import (
    ANCHOR,
    EAST,
    FAST,
    INNER,
    INVERSE,
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
IN_1, IN_2, IN_3, IN_4, IN_5, IN_6, IN_7, IN_8, IN_9 = (N * k for k in range(13, 22))
TO_EAST, TO_SOUTH, TO_LOW_EAST, TO_FAR_SOUTH, FALLING, RISING = (N * k for k in range(22, 28))
A_NW, A_NE, A_SW, A_SE = (N * k for k in range(28, 32))
WEIGHT_1, WEIGHT_2, LACK = (N * k for k in range(32, 35))
LINES = 35


@njit(**FAST, cache=True)  # type: ignore[misc]
def build(data: Any, levels: Any, dense: Any) -> None:
    """All coarse levels from the couplings and the anchor of the finest, and the inverse of the coarsest."""
    t = np.zeros(LINES * N, dtype=np.float32)
    last = levels.shape[0] - 1
    for level in range(last):
        invert_diagonal(data, levels[level, 0], levels[level, 1], levels[level, 2], level)
        coarsen(data, levels, level, t)
    invert(data, levels[last, 0], levels[last, 1], levels[last, 2], last, dense)


@njit(**INNER)  # type: ignore[misc]
def invert_diagonal(data: Any, top: int, height: int, width: int, level: int) -> None:
    for i in range(top + 1, top + height + 1):
        for j in range(1, width + 1):
            data[INVERSE, i, j] = (
                data[EAST, i, j]
                + data[EAST, i, j - 1]
                + data[SOUTH, i, j]
                + data[SOUTH, i - 1, j]
                + max(data[ANCHOR, i, j], ZERO)
            )
        if level > 0:
            for j in range(1, width + 1):
                data[INVERSE, i, j] += (
                    data[SOUTHEAST, i, j]
                    + data[SOUTHEAST, i - 1, j - 1]
                    + data[SOUTHWEST, i, j]
                    + data[SOUTHWEST, i - 1, j + 1]
                )
        for j in range(1, width + 1):
            data[INVERSE, i, j] = ONE / data[INVERSE, i, j] if data[INVERSE, i, j] > ZERO else ZERO


@njit(**INNER)  # type: ignore[misc]
def coarsen(data: Any, levels: Any, level: int, t: Any) -> None:
    """Interpolation weights and couplings of the next coarser level, in strips of cells, downwards."""
    top = levels[level, 0]
    coarse_top, height, width = levels[level + 1, 0], levels[level + 1, 1], levels[level + 1, 2]
    for plane in range(ANCHOR + 1):
        for i in range(coarse_top + 1, coarse_top + height + 1):
            for j in range(1, width + 1):
                data[plane, i, j] = 0
    for start in range(1, width + 1, STRIP):
        n = min(STRIP, width + 1 - start)
        horizontal_points(data, coarse_top + 1, top + 1, start, n, level, t)
        for row in range(1, height + 1):
            i, k = coarse_top + row, top + 2 * row - 1
            for j in range(n):
                t[T_LEFT + j], t[T_RIGHT + j], t[LACK_TOP + j] = (
                    t[LOW_LEFT + j],
                    t[LOW_RIGHT + j],
                    t[LACK_LOW + j],
                )
            vertical_points(data, i, k + 1, start, n, level, t)
            if row == height:
                clear(t, LOW_LEFT, 3 * N)
            else:
                horizontal_points(data, i + 1, k + 2, start, n, level, t)
            cells(data, k + 1, start, n, level, t)
            if level > 0:
                diagonals(data, k + 1, start, n, t)
            write(data, i, k, start, n, t)


# In the next five, slices and not sums of indices: an index that may be negative is not vectorised.


@njit(**INNER)  # type: ignore[misc]
def get(t: Any, line: int, n: int, data: Any, plane: int, row: int, column: int) -> None:
    to, values = t[line:], data[plane, row, column:]
    for j in range(n):
        to[j] = values[2 * j]


@njit(**INNER)  # type: ignore[misc]
def add(data: Any, plane: int, row: int, column: int, n: int, t: Any, line: int) -> None:
    to, values = data[plane, row, column:], t[line:]
    for j in range(n):
        to[j] += values[j]


@njit(**INNER)  # type: ignore[misc]
def put(data: Any, plane: int, row: int, column: int, n: int, t: Any, line: int) -> None:
    to, values = data[plane, row, column:], t[line:]
    for j in range(n):
        to[j] = values[j]


@njit(**INNER)  # type: ignore[misc]
def get_sum(t: Any, line: int, n: int, data: Any, row: int, column: int, row_2: int, column_2: int) -> None:
    """Sum of two diagonal couplings: SOUTHEAST at the first place, SOUTHWEST at the second."""
    to, first, second = t[line:], data[SOUTHEAST, row, column:], data[SOUTHWEST, row_2, column_2:]
    for j in range(n):
        to[j] = first[2 * j] + second[2 * j]


@njit(**INNER)  # type: ignore[misc]
def clear(t: Any, line: int, n: int) -> None:
    to = t[line:]
    for j in range(n):
        to[j] = 0


@njit(**INNER)  # type: ignore[misc]
def between(t: Any, n: int) -> None:
    """Weights of points between two coarse points, and what their two fine edges hand to the coarse edge.

    In: couplings to both (IN_1, IN_2), anchor (IN_3), collapsed diagonal couplings to both sides (IN_4, 5).
    Out: both weights, lack, the coarse coupling (TO_EAST), the anchors of both coarse points (A_NW, A_NE).
    """
    for j in range(n):
        c1, c2, anchor = t[IN_1 + j], t[IN_2 + j], t[IN_3 + j]
        w1, w2 = c1 + t[IN_4 + j], c2 + t[IN_5 + j]
        w1 = w1 if w1 > ZERO else ZERO
        w2 = w2 if w2 > ZERO else ZERO
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
def horizontal_points(data: Any, i: int, k: int, start: int, n: int, level: int, t: Any) -> None:
    """Points between two coarse points of coarse row i, fine row k: the lower side of a row of cells."""
    c = 2 * start
    get(t, IN_1, n, data, EAST, k, c - 1)
    get(t, IN_2, n, data, EAST, k, c)
    get(t, IN_3, n, data, ANCHOR, k, c)
    if level > 0:
        get_sum(t, IN_4, n, data, k - 1, c - 1, k, c)
        get_sum(t, IN_5, n, data, k, c, k - 1, c + 1)
    else:
        clear(t, IN_4, n)
        clear(t, IN_5, n)
    between(t, n)
    for j in range(n):
        t[LOW_LEFT + j], t[LOW_RIGHT + j], t[LACK_LOW + j] = t[WEIGHT_1 + j], t[WEIGHT_2 + j], t[LACK + j]
    add(data, EAST, i, start, n, t, TO_EAST)
    add(data, ANCHOR, i, start, n, t, A_NW)
    add(data, ANCHOR, i, start + 1, n, t, A_NE)


@njit(**INNER)  # type: ignore[misc]
def vertical_points(data: Any, i: int, k: int, start: int, n: int, level: int, t: Any) -> None:
    """Points below coarse row i, fine row k: the left sides of a row of cells, and the last right side."""
    c = 2 * start - 1
    get(t, IN_1, n + 1, data, SOUTH, k - 1, c)
    get(t, IN_2, n + 1, data, SOUTH, k, c)
    get(t, IN_3, n + 1, data, ANCHOR, k, c)
    if level > 0:
        get_sum(t, IN_4, n + 1, data, k - 1, c - 1, k - 1, c + 1)
        get_sum(t, IN_5, n + 1, data, k, c, k, c)
    else:
        clear(t, IN_4, n + 1)
        clear(t, IN_5, n + 1)
    between(t, n + 1)
    for j in range(n + 1):
        t[T_UP + j], t[T_DOWN + j], t[LACK_SIDE + j] = t[WEIGHT_1 + j], t[WEIGHT_2 + j], t[LACK + j]
    add(data, SOUTH, i, start, n, t, TO_EAST)
    add(data, ANCHOR, i, start, n, t, A_NW)
    add(data, ANCHOR, i + 1, start, n, t, A_NE)


@njit(**INNER)  # type: ignore[misc]
def cells(data: Any, k: int, start: int, n: int, level: int, t: Any) -> None:
    """Eliminate the middle points (fine row k) of a row of cells."""
    c = 2 * start
    get(t, IN_1, n, data, SOUTH, k - 1, c)
    get(t, IN_2, n, data, SOUTH, k, c)
    get(t, IN_3, n, data, EAST, k, c - 1)
    get(t, IN_4, n, data, EAST, k, c)
    get(t, IN_5, n, data, ANCHOR, k, c)
    if level > 0:
        get(t, IN_6, n, data, SOUTHEAST, k - 1, c - 1)
        get(t, IN_7, n, data, SOUTHWEST, k - 1, c + 1)
        get(t, IN_8, n, data, SOUTHWEST, k, c)
        get(t, IN_9, n, data, SOUTHEAST, k, c)
    else:
        for line in range(IN_6, IN_9 + 1, N):
            clear(t, line, n)
    for j in range(n):
        tl, tr, bl, br = t[T_LEFT + j], t[T_RIGHT + j], t[LOW_LEFT + j], t[LOW_RIGHT + j]
        lu, ld, ru, rd = t[T_UP + j], t[T_DOWN + j], t[T_UP + j + 1], t[T_DOWN + j + 1]
        c_top, c_low, c_west, c_east = t[IN_1 + j], t[IN_2 + j], t[IN_3 + j], t[IN_4 + j]
        top, low = c_top * t[LACK_TOP + j], c_low * t[LACK_LOW + j]
        west, east = c_west * t[LACK_SIDE + j], c_east * t[LACK_SIDE + j + 1]
        # The middle point's couplings, collapsed onto the corners.
        nw = tl * c_top + lu * c_west + t[IN_6 + j]
        ne = tr * c_top + ru * c_east + t[IN_7 + j]
        sw = bl * c_low + ld * c_west + t[IN_8 + j]
        se = br * c_low + rd * c_east + t[IN_9 + j]
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
def diagonals(data: Any, k: int, start: int, n: int, t: Any) -> None:
    """What the couplings between edge points, across the corners of the fine cells, hand on."""
    c = 2 * start
    get(t, IN_1, n, data, SOUTHWEST, k - 1, c)
    get(t, IN_2, n, data, SOUTHEAST, k - 1, c)
    get(t, IN_3, n, data, SOUTHEAST, k, c - 1)
    get(t, IN_4, n, data, SOUTHWEST, k, c + 1)
    for j in range(n):
        tl, tr, bl, br = t[T_LEFT + j], t[T_RIGHT + j], t[LOW_LEFT + j], t[LOW_RIGHT + j]
        lu, ld, ru, rd = t[T_UP + j], t[T_DOWN + j], t[T_UP + j + 1], t[T_DOWN + j + 1]
        top, low, west, east = t[LACK_TOP + j], t[LACK_LOW + j], t[LACK_SIDE + j], t[LACK_SIDE + j + 1]
        w1, w2, w3, w4 = t[IN_1 + j], t[IN_2 + j], t[IN_3 + j], t[IN_4 + j]
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
def write(data: Any, i: int, k: int, start: int, n: int, t: Any) -> None:
    """Hand a row of cells (coarse row i, its upper fine row k) to the coarse level."""
    for line in range(8):
        put(data, LEFT + line, i, start, n, t, line * N)
    add(data, EAST, i, start, n, t, TO_EAST)
    add(data, SOUTH, i, start, n, t, TO_SOUTH)
    add(data, EAST, i + 1, start, n, t, TO_LOW_EAST)
    add(data, SOUTH, i, start + 1, n, t, TO_FAR_SOUTH)
    put(data, SOUTHEAST, i, start, n, t, FALLING)
    put(data, SOUTHWEST, i, start + 1, n, t, RISING)
    add(data, ANCHOR, i, start, n, t, A_NW)
    add(data, ANCHOR, i, start + 1, n, t, A_NE)
    add(data, ANCHOR, i + 1, start, n, t, A_SW)
    add(data, ANCHOR, i + 1, start + 1, n, t, A_SE)
    get(t, IN_1, n, data, ANCHOR, k, 2 * start - 1)
    add(data, ANCHOR, i, start, n, t, IN_1)


@njit(**INNER)  # type: ignore[misc]
def invert(data: Any, top: int, height: int, width: int, level: int, dense: Any) -> None:
    """Inverse of the coarsest operator by Gauss-Jordan elimination in float64.

    Points tied to no anchor have no absolute height: the last pivot among them is 0, and it stays at 0.
    """
    n = height * width
    a = np.zeros((n, 2 * n))
    largest = 0.0
    for row in range(n):
        i, j = top + 1 + row // width, 1 + row % width
        a[row, row] += max(data[ANCHOR, i, j], ZERO)
        a[row, n + row] = 1
        tie(a, row, row + 1, data[EAST, i, j])
        tie(a, row, row + width, data[SOUTH, i, j])
        if level > 0:
            tie(a, row, row + width + 1, data[SOUTHEAST, i, j])
            tie(a, row, row + width - 1, data[SOUTHWEST, i, j])
        largest = max(largest, a[row, row])
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


@njit(**INNER)  # type: ignore[misc]
def tie(a: Any, row: int, other: int, coupling: float) -> None:
    if coupling != 0:
        a[row, row] += coupling
        a[other, other] += coupling
        a[row, other] -= coupling
        a[other, row] -= coupling
