"""Geometry of the report's charts, in pixels; `charts.html` draws them as SVG, in the page's own colors."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from gelform.arrays import Array, Numbers
from gelform.slopes.sigma import ONE_SIGMA

RIGHT_PERCENT = round(100 * ONE_SIGMA)  # within one sigma
SHARE_RIGHT, SHARE_FAIR = (60, 76), 45  # % within one sigma that are good, or fair; above, it is only wide
TICKS = 8  # steps of an axis, at most
Ticks = Sequence[float] | Array


@dataclass(frozen=True)
class Axes:
    """A plot area: its ranges and ticks, and the conversion of data to pixels. x to the right, y upward."""

    x_range: tuple[float, float]
    y_range: tuple[float, float]
    x_ticks: Ticks
    y_ticks: Ticks
    width, height = 460, 270
    left, right, top, bottom = 46, 448, 30, 230

    def x(self, value: float) -> float:
        """Pixel of an abscissa."""
        low, high = self.x_range
        return self.left + (value - low) / (high - low) * (self.right - self.left)

    def y(self, value: float) -> float:
        """Pixel of an ordinate, cut to the plot."""
        low, high = self.y_range
        return self.bottom - (min(max(value, low), high) - low) / (high - low) * (self.bottom - self.top)

    def points(self, xs: Sequence[float], ys: Sequence[float]) -> str:
        """The points of a line."""
        return " ".join(f"{self.x(x):.1f},{self.y(y):.1f}" for x, y in zip(xs, ys))

    def band(self, xs: Sequence[float], lows: Sequence[float], highs: Sequence[float]) -> str:
        """The outline between two curves."""
        return f"{self.points(xs, lows)} {self.points(xs[::-1], highs[::-1])}"


def gain_axes(gain: dict[str, Any]) -> Axes | None:
    """The axes of the gain curve; None if there is none."""
    bins = gain["contact"]
    if not bins:
        return None
    low = np.floor(min([b["gain"] for b in bins] + [0.8]) * 10) / 10
    high = np.ceil(max([b["gain"] for b in bins] + [1.2]) * 10) / 10
    end = max(b["slope_to"] for b in bins)
    return Axes((0, end), (low, high), round_ticks(0, end), round_ticks(low, high))


def middles(bins: Sequence[dict[str, Any]]) -> list[float]:
    """The slopes in the middle of bins."""
    return [(b["slope_from"] + b["slope_to"]) / 2 for b in bins]


def sigma_axes(sigma: dict[str, Any]) -> Axes | None:
    """The axes of the shares by slope; None if there are none."""
    if not sigma["by_slope"]:
        return None
    end = sigma["by_slope"][-1]["slope_to"]
    return Axes((0, end), (0, 100), round_ticks(0, end), round_ticks(0, 100))


def round_above(value: float) -> float:
    """The least of 1, 2 and 5 times a power of ten that is not below a value."""
    power = 10.0 ** np.floor(np.log10(value))
    return float(next(step * power for step in (1, 2, 5, 10) if step * power >= value))


def round_ticks(low: float, high: float) -> Numbers:
    """Ticks at round steps from a round value on."""
    step = round_above((high - low) / TICKS)
    count = int((high - low) / step + 0.5) + 1
    return np.asarray(low + step * np.arange(count), dtype=np.float64)


def learning_axes(learning: dict[str, Any]) -> Axes:
    """The axes of the learning curve; draws far above the others lie on its upper edge."""
    points, expected = learning["points"], learning["expected"]
    end = expected["presses_now"] + expected["presses_more"]
    highest = max(max(p["draws_deg"]) for p in points)
    top = float(np.ceil(min(highest, 3 * points[-1]["mean_deg"] + 4)))
    return Axes((0, end), (0, top), round_ticks(0, end), round_ticks(0, top))


def learning_law(learning: dict[str, Any], axes: Axes) -> str:
    """The points of the fitted law, as far as it lies in the plot."""
    expected = learning["expected"]
    now = expected["presses_now"]
    presses = np.arange(min(10, now), now + expected["presses_more"] + 1)
    law = np.sqrt(expected["floor_deg"] ** 2 + expected["square_slope_deg2"] / presses)
    inside = law <= axes.y_range[1]
    return axes.points(presses[inside].tolist(), law[inside].tolist())


def bar_of(percent: float) -> str:
    """CSS class of a fraction within one sigma, of the whole percents that are printed."""
    percent = float(f"{percent:.0f}")
    if SHARE_RIGHT[0] <= percent <= SHARE_RIGHT[1]:
        return "bar"
    return "bar off" if percent >= SHARE_FAIR else "bar far"


class Cell(NamedTuple):
    """A cell of a map of the frame, px."""

    left: float
    top: float
    width: float
    height: float

    @property
    def middle(self) -> tuple[float, float]:
        """Its middle (x, y)."""
        return self.left + self.width / 2, self.top + self.height / 2


def cells_of(grid: dict[str, Any], shape: Sequence[int], width: int) -> Iterator[Cell]:
    """The cells of a map of the frame that is `width` px wide, row by row."""
    rows, columns = grid["rows"], grid["columns"]
    across, down = width / columns, shape[0] * width / shape[1] / rows
    return (Cell(k % columns * across, k // columns * down, across, down) for k in range(rows * columns))


def petal(cell: Cell, k: int, directions: int) -> str:
    """The path of one sector of a rose; octant 0 points to the right, 2 downwards."""
    (x, y), radius = cell.middle, min(cell.width, cell.height) / 2
    ends = [2 * np.pi * (k + side) / directions for side in (-0.5, 0.5)]
    (x0, y0), (x1, y1) = ((x + radius * np.cos(a), y + radius * np.sin(a)) for a in ends)
    return f"M{x:.1f} {y:.1f}L{x0:.1f} {y0:.1f}A{radius:.1f} {radius:.1f} 0 0 1 {x1:.1f} {y1:.1f}Z"


def scale_of_errors(errors: dict[str, Any]) -> float:
    """The RMS slope error of the map's darkest shade; an arrow of this length spans a cell."""
    known = [rms for rms in errors["rms"] if rms is not None]
    return float(max(np.quantile(known, 0.95), 1e-6)) if known else 1.0


def arrow(cell: Cell, mean: Sequence[float], limit: float) -> tuple[float, float]:
    """The end (x, y) of the arrow of a mean error, from the cell's middle: at most a cell away."""
    scale = min(cell.width, cell.height) / max(limit, math.hypot(*mean))
    return cell.middle[0] + mean[0] * scale, cell.middle[1] + mean[1] * scale
