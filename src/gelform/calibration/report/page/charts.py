"""The report's curves and bars as SVG: small, crisp, in the page's own colours, light or dark."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

WIDTH, HEIGHT = 460, 270
Ticks = Sequence[float] | NDArray[Any]
LEFT, RIGHT, TOP, BOTTOM = 46, 12, 30, 40


@dataclass(frozen=True)
class Axes:
    """A plot area: data to pixels, and its frame. x to the right, y upwards."""

    x_range: tuple[float, float]
    y_range: tuple[float, float]
    width: int = WIDTH
    height: int = HEIGHT

    def x(self, value: float) -> float:
        """Pixel of an abscissa."""
        low, high = self.x_range
        return LEFT + (value - low) / (high - low) * (self.width - LEFT - RIGHT)

    def y(self, value: float) -> float:
        """Pixel of an ordinate."""
        low, high = self.y_range
        return self.height - BOTTOM - (value - low) / (high - low) * (self.height - TOP - BOTTOM)

    def frame(self, x_ticks: Ticks, y_ticks: Ticks, x_label: str, y_label: str, unit: str = "") -> str:
        """Grid lines, tick labels and axis labels."""
        right, bottom = self.width - RIGHT, self.height - BOTTOM
        parts = []
        for tick in y_ticks:
            y = self.y(tick)
            parts.append(f'<line class="grid" x1="{LEFT}" x2="{right}" y1="{y:.1f}" y2="{y:.1f}"/>')
            parts.append(
                f'<text class="tick" x="{LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{tick:g}{unit}</text>'
            )
        for tick in x_ticks:
            x = self.x(tick)
            parts.append(
                f'<text class="tick" x="{x:.1f}" y="{bottom + 16}" text-anchor="middle">{tick:g}</text>'
            )
        middle = (LEFT + right) / 2
        parts.append(
            f'<text class="label" x="{middle:.1f}" y="{bottom + 34}" text-anchor="middle">{escape(x_label)}</text>'
        )
        parts.append(f'<text class="label" x="4" y="14">{escape(y_label)}</text>')
        return "".join(parts)

    def line(self, xs: Sequence[float], ys: Sequence[float], kind: str) -> str:
        """A polyline of a CSS class."""
        points = " ".join(f"{self.x(x):.1f},{self.y(y):.1f}" for x, y in zip(xs, ys))
        return f'<polyline class="{kind}" points="{points}"/>'

    def band(self, xs: Sequence[float], lows: Sequence[float], highs: Sequence[float], kind: str) -> str:
        """A filled band between two curves, cut to the plot."""
        low, high = self.y_range
        there = [(x, min(max(v, low), high)) for x, v in zip(xs, lows)]
        back = [(x, min(max(v, low), high)) for x, v in zip(xs, highs)][::-1]
        points = " ".join(f"{self.x(x):.1f},{self.y(y):.1f}" for x, y in there + back)
        return f'<polygon class="{kind}" points="{points}"/>'

    def dots(self, xs: Sequence[float], ys: Sequence[float], kind: str, radius: float = 3) -> str:
        """Points."""
        return "".join(
            f'<circle class="{kind}" cx="{self.x(x):.1f}" cy="{self.y(y):.1f}" r="{radius:g}"/>'
            for x, y in zip(xs, ys)
        )


def svg(body: str, width: float, height: float, title: str, kind: str = "chart") -> str:
    """An SVG that scales with the page; its title is read to who cannot see it."""
    return (
        f'<svg class="{kind}" viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{escape(title)}">'
        f"<title>{escape(title)}</title>{body}</svg>"
    )


def gain_chart(gain: dict[str, Any]) -> str:
    """Recovered over true slope by slope, inside the contact's edge and up to the visible rim; 1 is right."""
    both = gain["contact"] + gain["rim"]
    if not both:
        return ""
    lowest = min([b["gain"] for b in both] + [0.8])
    highest = max([b["gain"] for b in both] + [1.2])
    axes = Axes(
        (0, max(b["slope_to"] for b in both)), (np.floor(lowest * 10) / 10, np.ceil(highest * 10) / 10)
    )
    parts = [axes.band(axes.x_range, (0.95, 0.95), (1.05, 1.05), "right")]
    ticks = np.round(np.arange(axes.y_range[0], axes.y_range[1] + 0.01, 0.1), 1)
    x_ticks = np.round(np.arange(0, axes.x_range[1] + 0.01, 0.2), 1)
    parts.append(axes.frame(x_ticks, ticks, "true slope, mm/mm", "recovered / true slope"))
    parts.append(axes.line(axes.x_range, (1, 1), "one"))
    for name, kind in (("rim", "second"), ("contact", "first")):
        xs = [(b["slope_from"] + b["slope_to"]) / 2 for b in gain[name]]
        intervals = [b["interval"] for b in gain[name]]
        parts.append(axes.band(xs, [i[0] for i in intervals], [i[1] for i in intervals], f"fill-{kind}"))
        parts.append(axes.line(xs, [b["gain"] for b in gain[name]], f"line-{kind}"))
        parts.append(axes.dots(xs, [b["gain"] for b in gain[name]], f"dot-{kind}"))
    return svg("".join(parts), WIDTH, HEIGHT, "Slope gain: recovered over true slope, by true slope")


def learning_chart(learning: dict[str, Any]) -> str:
    """Held-out error by number of presses: every draw, their mean, and the law that is carried on."""
    points, expected = learning["points"], learning["expected"]
    end = expected["presses_now"] + expected["presses_more"]
    highest = max(max(p["draws_deg"]) for p in points)
    top = float(np.ceil(min(highest, 3 * points[-1]["mean_deg"] + 4)))
    axes = Axes((0, end * 1.04), (0, top))
    ticks = np.arange(0, top + 0.1, 1 if top <= 8 else 2)
    step = next(s for s in (5, 10, 20, 50, 100, 200, 500) if end / s <= 9)
    parts = [axes.frame(np.arange(0, end * 1.04, step), ticks, "presses that train", "normal error", "°")]
    ns = np.linspace(min(10, expected["presses_now"]), end, 60)
    law = np.sqrt(expected["floor_deg"] ** 2 + expected["square_slope_deg2"] / ns)
    shown = law <= top
    parts.append(axes.line(ns[shown].tolist(), law[shown].tolist(), "law"))
    for p in points:
        draws = [min(value, top) for value in p["draws_deg"]]
        parts.append(axes.dots([p["presses"]] * len(draws), draws, "draw", 2.5))
    means = [min(p["mean_deg"], top) for p in points]
    parts.append(axes.line([p["presses"] for p in points], means, "line-first"))
    parts.append(axes.dots([p["presses"] for p in points], means, "dot-first", 3.5))
    now = expected["presses_now"]
    parts.append(
        f'<line class="now" x1="{axes.x(now):.1f}" x2="{axes.x(now):.1f}" y1="{TOP}" y2="{axes.y(0):.1f}"/>'
    )
    parts.append(
        f'<text class="tick" x="{axes.x(now) - 4:.1f}" y="{TOP + 10}" text-anchor="end">now: {now}</text>'
    )
    parts.append(axes.dots([now, end], [expected["now_deg"], expected["more_deg"]], "expected", 4))
    return svg("".join(parts), WIDTH, HEIGHT, "Learning curve: " + learning["sentence"])


def sigma_chart(sigma: dict[str, Any]) -> str:
    """Share of held-out slopes within one stated standard deviation, by slope; 68 % is right."""
    bins = sigma["by_slope"]
    if not bins:
        return ""
    axes = Axes((0, bins[-1]["slope_to"]), (0, 100))
    parts = [axes.band(axes.x_range, (60, 60), (76, 76), "right")]
    ticks = np.round(np.arange(0, axes.x_range[1] + 0.01, 0.2), 1)
    parts.append(axes.frame(ticks, (0, 20, 40, 60, 80, 100), "slope, mm/mm", "within one σ", " %"))
    for one in bins:
        left, right, share = axes.x(one["slope_from"]) + 2, axes.x(one["slope_to"]) - 2, 100 * one["share"]
        kind = "bar" if 60 <= share <= 76 else "bar off" if 45 <= share <= 90 else "bar far"
        y = axes.y(share)
        label = y + 15 if share > 10 else y - 4
        parts.append(
            f'<rect class="{kind}" x="{left:.1f}" y="{y:.1f}" width="{right - left:.1f}" '
            f'height="{axes.y(0) - y:.1f}" rx="2"/>'
        )
        parts.append(
            f'<text class="on-bar" x="{(left + right) / 2:.1f}" y="{label:.1f}" text-anchor="middle">{share:.0f}</text>'
        )
    parts.append(axes.line(axes.x_range, (68, 68), "one"))
    return svg(
        "".join(parts), WIDTH, HEIGHT, "Share of held-out slopes within one standard deviation, by slope"
    )


def limit_bar(value: float, interval: Sequence[float] | None, good: float, fair: float) -> str:
    """Where a figure and its interval lie on good, fair and poor; smaller is better."""
    end = max(1.5 * fair, 1.05 * value, 1.05 * (interval or [0, 0])[1])
    scale = 200 / end
    parts = [
        f'<rect class="zone-good" x="0" y="8" width="{good * scale:.1f}" height="6"/>',
        f'<rect class="zone-fair" x="{good * scale:.1f}" y="8" width="{(fair - good) * scale:.1f}" height="6"/>',
        f'<rect class="zone-poor" x="{fair * scale:.1f}" y="8" width="{200 - fair * scale:.1f}" height="6"/>',
    ]
    if interval:
        low, high = (v * scale for v in interval)
        parts.append(
            f'<rect class="whisker" x="{low:.1f}" y="9.5" width="{max(high - low, 1):.1f}" height="3"/>'
        )
    parts.append(f'<circle class="marker" cx="{value * scale:.1f}" cy="11" r="5.5"/>')
    for limit in (good, fair):
        parts.append(
            f'<text class="tick" x="{limit * scale:.1f}" y="28" text-anchor="middle">{limit:g}</text>'
        )
    return svg("".join(parts), 206, 32, f"{value:.3g}: good up to {good:g}, fair up to {fair:g}", "limits")


def range_bar(row: dict[str, Any], end: float) -> str:
    """A candidate's normal error with its standard error, from 0 to `end` degrees."""
    value, error = row["normal_free_deg"], row.get("standard_error_deg", 0.0)
    low, high, middle = (160 * v / end for v in (value - error, value + error, value))
    body = (
        '<line class="grid" x1="0" x2="160" y1="7" y2="7"/>'
        f'<line class="line-first" x1="{low:.1f}" x2="{high:.1f}" y1="7" y2="7"/>'
        f'<circle class="dot-first" cx="{middle:.1f}" cy="7" r="{5 if row["chosen"] else 3.5:g}"/>'
    )
    return svg(body, 166, 14, f"{value:.3g}°", "range")


MAP_WIDTH = 560
LONGEST_ARROW = 50.0
SUPPORT_OPACITY = (0.0, 0.3, 0.55, 0.85)


def coverage_map(coverage: dict[str, Any], shape: Sequence[int]) -> str:
    """A rose in every cell: one petal for each slope direction, filled by how many presses have shown it."""
    scale = MAP_WIDTH / shape[1]
    height = shape[0] * scale
    rows, columns = coverage["rows"], coverage["columns"]
    cell_width, cell_height = MAP_WIDTH / columns, height / rows
    radius = 0.44 * min(cell_width, cell_height)
    parts = [f'<rect class="ground" width="{MAP_WIDTH}" height="{height:.1f}" rx="3"/>']
    for index, counts in enumerate(coverage["presses"]):
        x, y = (index % columns + 0.5) * cell_width, (index // columns + 0.5) * cell_height
        parts += [_petal(x, y, radius, k, len(counts), count) for k, count in enumerate(counts)]
    for number, place in enumerate(coverage["next"], start=1):
        x, y = (place["x_px"] + 0.5) * scale, (place["y_px"] + 0.5) * scale
        parts.append(
            f'<circle class="next" cx="{x:.1f}" cy="{y:.1f}" r="{place["contact_radius_px"] * scale:.1f}"/>'
        )
        parts.append(f'<circle class="next-mark" cx="{x:.1f}" cy="{y:.1f}" r="12"/>')
        parts.append(
            f'<text class="next-text" x="{x:.1f}" y="{y + 5:.1f}" text-anchor="middle">{number}</text>'
        )
    return svg(
        "".join(parts),
        MAP_WIDTH,
        height,
        "Slope directions seen at each place, and where to press next",
        "map",
    )


def _petal(x: float, y: float, radius: float, k: int, directions: int, count: int) -> str:
    """One sector of a rose; octant 0 points to the right, 2 downwards."""
    ends = [2 * np.pi * (k + side) / directions for side in (-0.45, 0.45)]
    (x0, y0), (x1, y1) = ((x + radius * np.cos(a), y + radius * np.sin(a)) for a in ends)
    path = f"M{x:.1f} {y:.1f}L{x0:.1f} {y0:.1f}A{radius:.1f} {radius:.1f} 0 0 1 {x1:.1f} {y1:.1f}Z"
    kind = "petal" if count else "petal none"
    return f'<path class="{kind}" fill-opacity="{SUPPORT_OPACITY[min(count, 3)]:g}" d="{path}"/>'


def slope_error_map(errors: dict[str, Any], shape: Sequence[int]) -> str:
    """RMS length of the held-out slope error as shade, its mean as an arrow, by place."""
    height = shape[0] * MAP_WIDTH / shape[1]
    rows, columns = errors["rows"], errors["columns"]
    width, tall = MAP_WIDTH / columns, height / rows
    limit = scale_of_errors(errors)
    parts = [f'<rect class="ground" width="{MAP_WIDTH}" height="{height:.1f}" rx="3"/>']
    arrows = []
    for index, (rms, mean) in enumerate(zip(errors["rms"], errors["mean"])):
        if rms is None:
            continue
        left, top = index % columns * width, index // columns * tall
        shade = min(rms / limit, 1) * 0.9 + 0.04
        parts.append(
            f'<rect class="heat" x="{left:.1f}" y="{top:.1f}" width="{width:.1f}" height="{tall:.1f}" '
            f'fill-opacity="{shade:.2f}"><title>RMS {rms:.3f}, mean ({mean[0]:+.3f}, {mean[1]:+.3f})</title></rect>'
        )
        arrows.append(_arrow(left + width / 2, top + tall / 2, mean, 0.9 * min(width, tall) / limit))
    return svg("".join(parts + arrows), MAP_WIDTH, height, "Held-out slope error over the frame", "map")


def scale_of_errors(errors: dict[str, Any]) -> float:
    """The RMS slope error that the map shows darkest; an arrow of this length spans 0.9 of a cell."""
    known = [rms for rms in errors["rms"] if rms is not None]
    return float(max(np.quantile(known, 0.95), 1e-6)) if known else 1.0


def _arrow(x: float, y: float, mean: Sequence[float], scale: float) -> str:
    """A line from the cell's middle in the direction of the mean error, with a dot at its tail."""
    shrink = min(1.0, LONGEST_ARROW / max(math.hypot(*mean) * scale, 1e-9))
    dx, dy = mean[0] * scale * shrink, mean[1] * scale * shrink
    return (
        f'<circle class="tail" cx="{x:.1f}" cy="{y:.1f}" r="1.6"/>'
        f'<line class="arrow" x1="{x:.1f}" y1="{y:.1f}" x2="{x + dx:.1f}" y2="{y + dy:.1f}"/>'
    )


def share_map(sigma: dict[str, Any], shape: Sequence[int]) -> str:
    """Share within one standard deviation by place, as numbers on shades."""
    width = 330
    height = shape[0] * width / shape[1]
    rows, columns = sigma["rows"], sigma["columns"]
    cell_width, cell_height = width / columns, height / rows
    parts = [f'<rect class="ground" width="{width}" height="{height:.1f}" rx="3"/>']
    for index, share in enumerate(sigma["by_place"]):
        left, top = index % columns * cell_width, index // columns * cell_height
        text = "–"
        if share is not None:
            percent = 100 * share
            kind = "bar" if 60 <= percent <= 76 else "bar off" if 45 <= percent <= 90 else "bar far"
            parts.append(
                f'<rect class="{kind}" x="{left + 1:.1f}" y="{top + 1:.1f}" width="{cell_width - 2:.1f}" '
                f'height="{cell_height - 2:.1f}" rx="2"/>'
            )
            text = f"{percent:.0f} %"
        x, y = left + cell_width / 2, top + cell_height / 2 + 5
        parts.append(f'<text class="cell" x="{x:.1f}" y="{y:.1f}" text-anchor="middle">{text}</text>')
    return svg(
        "".join(parts),
        width,
        height,
        "Share of held-out slopes within one standard deviation, by place",
        "map",
    )
