"""Conjugate gradients on the finest level of the hierarchy, preconditioned by one V-cycle: numba, float32."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from gelform.solvers.cycle import (
    ANCHOR,
    ANSWER,
    DEPTH,
    EAST,
    FAST,
    INNER,
    PRODUCT,
    RIGHT_SIDE,
    SEARCH,
    SOUTH,
    cycle,
)


@njit(**FAST, cache=True)  # type: ignore[misc]
def solve(data: Any, levels: Any, dense: Any, scale: float, tolerance: float, limit: int) -> Any:
    """Add to the depth what the right side (the residual) asks for.

    Stops when the estimated largest error, as a share of `scale` (0: of the range of the first answer), is
    below the tolerance. One V-cycle's answer is an estimate of the whole error; 4 rate/(1 - rate) says what
    is left of it after it was added, on the safe side in trials. The rate is the mean so far, or over the
    last four iterations where that is slower; and where many iterations are needed, a V-cycle sees less of the
    error, hence the count in place of 4.

    Returns
    -------
    iterations : int
    estimate : float
        Estimated largest error as a share of the scale.
    """
    height, width = levels[0, 1], levels[0, 2]
    line = np.zeros((3, width + 3), dtype=np.float32)
    product = cycle(data, levels, dense, line)
    first = spread(data, height, width)
    whole = scale if scale > 0 else first
    estimate = np.inf if first > 0 else 0.0
    past = np.zeros(4)
    turn = 0.0
    done = 0
    while estimate > tolerance and done < limit:
        curvature = search(data, height, width, turn)
        if not curvature > 0:
            break
        advance(data, height, width, product / curvature)
        next_product = cycle(data, levels, dense, line)
        turn = next_product / product
        product = next_product
        done += 1
        left = spread(data, height, width)
        rate = (left / first) ** (1 / done)
        if done > 4:
            rate = max(rate, (left / past[done % 4]) ** 0.25)
        past[done % 4] = left
        rate = min(rate, 0.9)
        estimate = left / whole * max(4, done) * rate / (1 - rate)
    for i in range(1, height + 1):
        for j in range(1, width + 1):
            data[DEPTH, i, j] += data[ANSWER, i, j]
    return done, estimate


@njit(**INNER)  # type: ignore[misc]
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


@njit(**INNER)  # type: ignore[misc]
def advance(data: Any, height: int, width: int, length: float) -> None:
    """Go along the search direction."""
    s = np.float32(length)
    for i in range(1, height + 1):
        for j in range(1, width + 1):
            data[DEPTH, i, j] += s * data[SEARCH, i, j]
        for j in range(1, width + 1):
            data[RIGHT_SIDE, i, j] -= s * data[PRODUCT, i, j]


@njit(**INNER)  # type: ignore[misc]
def spread(data: Any, height: int, width: int) -> float:
    """Largest minus smallest value of the finest level's answer."""
    low = high = data[ANSWER, 1, 1]
    for i in range(1, height + 1):
        for j in range(1, width + 1):
            value = data[ANSWER, i, j]
            low = value if value < low else low
            high = value if value > high else high
    return float(high - low)
