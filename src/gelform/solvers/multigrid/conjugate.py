"""Conjugate gradients on the finest level of the hierarchy, preconditioned by one V-cycle: numba, float32."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from gelform.solvers.multigrid.cycle import (
    ANCHOR,
    ANSWER,
    DEPTH,
    EAST,
    KERNEL,
    LEAF,
    PRODUCT,
    RIGHT_SIDE,
    SEARCH,
    SOUTH,
    cycle,
)


@njit(**KERNEL)  # type: ignore[misc]
def solve(
    data: Any, levels: Any, dense: Any, line: Any, past: Any, scale: float, tolerance: float, limit: int
) -> Any:
    """Add to the depth what the right side (the residual) asks for.

    Stops when the estimated largest error, as a share of `scale` (0: of the range of the first answer), is
    below the tolerance. One V-cycle's answer is an estimate of the whole error; 4 rate/(1 - rate) says what
    is left of it after it was added, on the safe side in trials. The rate is the mean so far, or over the
    last four iterations where that is slower; and where many iterations are needed, a V-cycle sees less of
    the error, hence their count in place of 4 (12 at most: float32 ends at 1e-6). `line` (3, W + 3) and
    `past` (4,) are scratch.

    Returns
    -------
    iterations : int
    estimate : float
        Estimated largest error as a share of the scale.
    """
    height, width = levels[0, 1], levels[0, 2]
    product, first, whole = 1.0, 0.0, scale
    done = 0
    while True:
        before, product = product, cycle(data, levels, dense, line)
        left = spread(data, height, width)
        if done == 0:
            first = left
            whole = scale if scale > 0 else first
            estimate = np.inf if first > 0 else 0.0
        else:
            rate = (left / first) ** (1 / done)
            recent = (left / past[done % 4]) ** 0.25 if done > 4 else 0.0
            rate = recent if recent > rate else rate
            rate = rate if rate < 0.8 else 0.8
            doubt = (done if done < 12 else 12) if done > 4 else 4
            estimate = left / whole * doubt * rate / (1 - rate)
        past[done % 4] = left
        if not estimate > tolerance or done >= limit:
            break
        curvature = search(data, height, width, product / before if done > 0 else 0.0)
        if not curvature > 0:
            break
        advance(data, height, width, product / curvature)
        done += 1
    for i in range(1, height + 1):
        for j in range(1, width + 1):
            data[DEPTH, i, j] += data[ANSWER, i, j]
    return done, estimate


@njit(**LEAF)  # type: ignore[misc]
def search(data: Any, height: int, width: int, turn: Any) -> Any:
    """Next search direction and the operator times it; returns their product."""
    t = np.float32(turn)
    total = 0.0
    for row in range(1, height + 2):
        if row <= height:
            for j in range(1, width + 1):
                data[SEARCH, row, j] = data[ANSWER, row, j] + t * data[SEARCH, row, j]
        i = row - 1
        if i >= 1:
            for j in range(1, width + 1):
                here = data[SEARCH, i, j]
                data[PRODUCT, i, j] = (
                    data[ANCHOR, i, j] * here
                    + data[EAST, i, j] * (here - data[SEARCH, i, j + 1])
                    + data[EAST, i, j - 1] * (here - data[SEARCH, i, j - 1])
                    + data[SOUTH, i, j] * (here - data[SEARCH, i + 1, j])
                    + data[SOUTH, i - 1, j] * (here - data[SEARCH, i - 1, j])
                )
            part: Any = np.float32(0)
            for j in range(1, width + 1):
                part += data[SEARCH, i, j] * data[PRODUCT, i, j]
            total += part
    return total


@njit(**LEAF)  # type: ignore[misc]
def advance(data: Any, height: int, width: int, length: float) -> None:
    """Go along the search direction."""
    s = np.float32(length)
    for i in range(1, height + 1):
        for j in range(1, width + 1):
            data[DEPTH, i, j] += s * data[SEARCH, i, j]
        for j in range(1, width + 1):
            data[RIGHT_SIDE, i, j] -= s * data[PRODUCT, i, j]


@njit(**LEAF)  # type: ignore[misc]
def spread(data: Any, height: int, width: int) -> float:
    """Largest minus smallest value of the finest level's answer."""
    low = high = data[ANSWER, 1, 1]
    for i in range(1, height + 1):
        for j in range(1, width + 1):
            value = data[ANSWER, i, j]
            low = value if value < low else low
            high = value if value > high else high
    return float(high - low)
