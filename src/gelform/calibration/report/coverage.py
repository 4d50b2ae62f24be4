"""Where presses are missing: which slope directions each place has seen, and where one more press helps most."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.ball import ball_gradients
from gelform.calibration.report.held_out import HeldOutSample
from gelform.calibration.report.residuals import cells_of

DIRECTIONS = 8
COLUMNS = 8
STEP = 3
LEAST_SLOPE = 0.08
LEAST_PIXELS = 6
PRIOR_PIXELS = 200
SUGGESTIONS = 3


def grid_of(shape: tuple[int, int], columns: int = COLUMNS) -> tuple[int, int]:
    """Rows and columns of cells that are about square; the longer side has `columns` of them."""
    height, width = shape
    if width >= height:
        return max(2, round(columns * height / width)), columns
    return columns, max(2, round(columns * width / height))


def direction_of(gradients: NDArray[Any]) -> NDArray[np.intp]:
    """Octant 0-7 of the slope's direction (N, 2): 0 rises to the right, 2 downwards (image rows run down)."""
    turn = np.arctan2(gradients[:, 1], gradients[:, 0]) / (2 * np.pi / DIRECTIONS)
    octant: NDArray[np.intp] = np.round(turn).astype(np.intp) % DIRECTIONS
    return octant


def bins_of_press(
    circle_px: tuple[float, float, float],
    ball_px: float,
    zone: float,
    shape: tuple[int, int],
    grid: tuple[int, int],
) -> NDArray[np.bool_]:
    """(cells, directions) that a press shows, inside a share of its contact radius."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(0, shape[1], STEP), np.arange(0, shape[0], STEP)))
    inside = np.hypot(x - circle_px[0], y - circle_px[1]) < zone * circle_px[2]
    x, y = x[inside], y[inside]
    slopes = ball_gradients(x, y, circle_px[:2], ball_px)
    steep = np.linalg.norm(slopes, axis=1) > LEAST_SLOPE
    index = cells_of(x[steep], y[steep], shape, grid) * DIRECTIONS + direction_of(slopes[steep])
    count = np.bincount(index, minlength=grid[0] * grid[1] * DIRECTIONS)
    seen: NDArray[np.bool_] = (count >= LEAST_PIXELS).reshape(-1, DIRECTIONS)
    return seen


def coverage(
    circles_px: Sequence[tuple[float, float, float]],
    balls_px: Sequence[float],
    zone: float,
    samples: Sequence[HeldOutSample],
    shape: tuple[int, int],
) -> dict[str, Any]:
    """How many presses have shown each slope direction at each place, and where to press next.

    Parameters
    ----------
    circles_px, balls_px : contact circles and ball radii of the presses that train, px
    zone : share of the contact radius that trains
    samples : held-out slopes, which tell where the error is large
    shape : (H, W)

    Returns
    -------
    coverage : dict
        `presses` (cells x 8 counts), `covered` (share of the cells' directions seen at least once) and `next`:
        places in the order in which they help.
    """
    grid = grid_of(shape)
    seen = [bins_of_press(c, b, zone, shape, grid) for c, b in zip(circles_px, balls_px)]
    support = np.stack(seen).sum(axis=0, dtype=np.intp)
    return {
        "rows": grid[0],
        "columns": grid[1],
        "directions": DIRECTIONS,
        "presses": support.tolist(),
        "covered": float(np.mean(support > 0)),
        "next": _next_places(support, circles_px, balls_px, zone, samples, shape, grid),
    }


def _next_places(
    support: NDArray[np.intp],
    circles_px: Sequence[tuple[float, float, float]],
    balls_px: Sequence[float],
    zone: float,
    samples: Sequence[HeldOutSample],
    shape: tuple[int, int],
    grid: tuple[int, int],
) -> list[dict[str, float]]:
    """Greedy: the place whose press takes most from `sum error^2 / (1 + presses)`, then the next one after it.

    The press is a typical one: the median contact radius and ball of those that were made.
    """
    radius, ball = float(np.median([c[2] for c in circles_px])), float(np.median(balls_px))
    error = _square_error(samples, shape, grid)
    inset = 0.5 * radius
    xs = np.linspace(inset, shape[1] - 1 - inset, 2 * grid[1])
    ys = np.linspace(inset, shape[0] - 1 - inset, 2 * grid[0])
    places = [(float(x), float(y)) for y in ys for x in xs]
    shown = np.array([bins_of_press((*place, radius), ball, zone, shape, grid) for place in places])
    count, chosen = support.astype(np.float64), []
    for _ in range(SUGGESTIONS):
        worth = (shown * (error / ((1 + count) * (2 + count)))).sum(axis=(1, 2))
        best = int(worth.argmax())
        chosen.append({"x_px": places[best][0], "y_px": places[best][1], "contact_radius_px": radius})
        count += shown[best]
    return chosen


def _square_error(
    samples: Sequence[HeldOutSample], shape: tuple[int, int], grid: tuple[int, int]
) -> NDArray[np.float64]:
    """(cells, directions) mean square slope error, drawn to the overall mean where few pixels tell."""
    size = grid[0] * grid[1] * DIRECTIONS
    total, count = np.zeros(size), np.zeros(size)
    for one in samples:
        index = cells_of(one.x_px, one.y_px, shape, grid) * DIRECTIONS + direction_of(one.true_gradients)
        total += np.bincount(index, (one.errors.astype(np.float64) ** 2).sum(axis=1), size)
        count += np.bincount(index, minlength=size)
    overall = total.sum() / count.sum() if count.any() else 1.0
    mean: NDArray[np.float64] = (total + PRIOR_PIXELS * overall) / (count + PRIOR_PIXELS)
    return mean.reshape(-1, DIRECTIONS)
