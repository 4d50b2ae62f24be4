"""The report's curves, bars and maps of the frame as SVG: small, crisp, in the page's own colors, light or dark."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

WIDTH, HEIGHT = 460, 270  # px of the curves, as drawn
LEFT, RIGHT, TOP, BOTTOM = 46, 12, 30, 40  # px around the plot
MAP_WIDTH, SHARE_MAP_WIDTH = 560, 330  # px
LONGEST_ARROW = 50.0  # px
SUPPORT_OPACITY = (0.0, 0.3, 0.55, 0.85)  # opacity of a petal that no, one, two, three or more presses show
GAIN_RIGHT = (0.95, 1.05)  # range of a good gain
SHARE_RIGHT, SHARE_FAIR = (60, 76), (45, 90)  # % within one sigma; 68 is right
Ticks = Sequence[float] | NDArray[Any]


def svg(body: str, width: float, height: float, title: str, kind: str = "chart") -> str:
    """An SVG that scales with the page; screen readers read its title."""
    return (
        f'<svg class="{kind}" viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{escape(title)}">'
        f"<title>{escape(title)}</title>{body}</svg>"
    )


def _px(value: float) -> str:
    """A length in px, whole or to a tenth."""
    return str(value) if isinstance(value, int) else f"{value:.1f}"


def _rect(kind: str, x: float, y: float, width: float, height: float, more: str = "") -> str:
    size = f'width="{_px(width)}" height="{_px(height)}"'
    return f'<rect class="{kind}" x="{_px(x)}" y="{_px(y)}" {size}{more}/>'


def _text(kind: str, x: float, y: float, words: str, anchor: str = "middle") -> str:
    return f'<text class="{kind}" x="{_px(x)}" y="{_px(y)}" text-anchor="{anchor}">{words}</text>'


def _line(kind: str, x1: float, x2: float, y1: float, y2: float) -> str:
    return f'<line class="{kind}" x1="{_px(x1)}" x2="{_px(x2)}" y1="{_px(y1)}" y2="{_px(y2)}"/>'


def _circle(kind: str, x: float, y: float, radius: float) -> str:
    return f'<circle class="{kind}" cx="{_px(x)}" cy="{_px(y)}" r="{_px(radius)}"/>'


@dataclass(frozen=True)
class Axes:
    """A plot area: conversion of data to pixels, and its frame. x to the right, y upward."""

    x_range: tuple[float, float]
    y_range: tuple[float, float]

    def x(self, value: float) -> float:
        """Pixel of an abscissa."""
        low, high = self.x_range
        return LEFT + (value - low) / (high - low) * (WIDTH - LEFT - RIGHT)

    def y(self, value: float) -> float:
        """Pixel of an ordinate."""
        low, high = self.y_range
        return HEIGHT - BOTTOM - (value - low) / (high - low) * (HEIGHT - TOP - BOTTOM)

    def frame(self, x_ticks: Ticks, y_ticks: Ticks, x_label: str, y_label: str, unit: str = "") -> str:
        """Grid lines, tick labels and axis labels."""
        right, bottom = WIDTH - RIGHT, HEIGHT - BOTTOM
        parts = []
        for tick in y_ticks:
            y = self.y(tick)
            parts.append(_line("grid", LEFT, right, y, y))
            parts.append(_text("tick", LEFT - 6, y + 4, f"{tick:g}{unit}", "end"))
        parts += [_text("tick", self.x(tick), bottom + 16, f"{tick:g}") for tick in x_ticks]
        parts.append(_text("label", (LEFT + right) / 2, bottom + 34, escape(x_label)))
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

    def level_band(self, low: float, high: float) -> str:
        """The band of good values, over the whole plot."""
        return self.band(self.x_range, (low, low), (high, high), "right")

    def dots(self, xs: Sequence[float], ys: Sequence[float], kind: str, radius: float = 3) -> str:
        """Points."""
        return "".join(_circle(kind, self.x(x), self.y(y), radius) for x, y in zip(xs, ys))


def gain_chart(gain: dict[str, Any]) -> str:
    """Recovered over true slope by slope, inside the contact edge and up to the visible rim; 1 is right."""
    both = gain["contact"] + gain["rim"]
    if not both:
        return ""
    lowest = min([b["gain"] for b in both] + [0.8])
    highest = max([b["gain"] for b in both] + [1.2])
    end = max(b["slope_to"] for b in both)
    axes = Axes((0, end), (np.floor(lowest * 10) / 10, np.ceil(highest * 10) / 10))
    ticks = np.round(np.arange(axes.y_range[0], axes.y_range[1] + 0.01, 0.1), 1)
    parts = [
        axes.level_band(*GAIN_RIGHT),
        axes.frame(_slope_ticks(end), ticks, "true slope, mm/mm", "slope gain: recovered / true slope"),
        axes.line(axes.x_range, (1, 1), "one"),
    ]
    for name, kind in (("rim", "second"), ("contact", "first")):
        xs = [(b["slope_from"] + b["slope_to"]) / 2 for b in gain[name]]
        lows, highs = ([b["interval"][side] for b in gain[name]] for side in (0, 1))
        gains = [b["gain"] for b in gain[name]]
        parts.append(axes.band(xs, lows, highs, f"fill-{kind}"))
        parts.append(axes.line(xs, gains, f"line-{kind}"))
        parts.append(axes.dots(xs, gains, f"dot-{kind}"))
    return svg("".join(parts), WIDTH, HEIGHT, "Slope gain: recovered over true slope, by true slope")


def _slope_ticks(end: float) -> NDArray[np.float64]:
    return np.round(np.arange(0, end + 0.01, 0.2), 1)


def learning_chart(learning: dict[str, Any]) -> str:
    """Held-out error by number of presses: every draw, their mean, and the fitted law beyond them."""
    points, expected = learning["points"], learning["expected"]
    now = expected["presses_now"]
    end = now + expected["presses_more"]
    others = learning.get("other_points") or []
    highest = max(max(p["draws_deg"]) for p in points)
    top = float(np.ceil(min(highest, 3 * points[-1]["mean_deg"] + 4)))
    axes = Axes((0, end * 1.04), (0, top))
    ticks = np.arange(0, top + 0.1, 1 if top <= 8 else 2)
    step = next(s for s in (5, 10, 20, 50, 100, 200, 500) if end / s <= 9)
    parts = [
        axes.frame(
            np.arange(0, end * 1.04, step), ticks, "presses that train", "angle error of the normals", "°"
        )
    ]
    ns = np.linspace(min(10, now), end, 60)
    law = np.sqrt(expected["floor_deg"] ** 2 + expected["square_slope_deg2"] / ns)
    shown = law <= top
    parts.append(axes.line(ns[shown].tolist(), law[shown].tolist(), "law"))
    for p in points:
        draws = [min(value, top) for value in p["draws_deg"]]
        parts.append(axes.dots([p["presses"]] * len(draws), draws, "draw", 2.5))
    sizes, means = [p["presses"] for p in points], [min(p["mean_deg"], top) for p in points]
    parts.append(axes.line(sizes, means, "line-first"))
    parts.append(axes.dots(sizes, means, "dot-first", 3.5))
    if others:
        means = [min(p["mean_deg"], top) for p in others]
        parts.append(axes.line([p["presses"] for p in others], means, "line-second"))
    parts.append(_line("now", axes.x(now), axes.x(now), TOP, axes.y(0)))
    parts.append(_text("tick", axes.x(now) - 4, TOP + 10, f"now: {now}", "end"))
    parts.append(axes.dots([now, end], [expected["now_deg"], expected["more_deg"]], "expected", 4))
    return svg("".join(parts), WIDTH, HEIGHT, "Learning curve: " + learning["sentence"])


def sigma_chart(sigma: dict[str, Any]) -> str:
    """Fraction of held-out slopes within one stated standard deviation, by slope; 68 % is right."""
    bins = sigma["by_slope"]
    if not bins:
        return ""
    axes = Axes((0, bins[-1]["slope_to"]), (0, 100))
    ticks = (0, 20, 40, 60, 80, 100)
    parts = [
        axes.level_band(*SHARE_RIGHT),
        axes.frame(_slope_ticks(axes.x_range[1]), ticks, "slope, mm/mm", "share within one σ", " %"),
    ]
    for one in bins:
        left, right, percent = axes.x(one["slope_from"]) + 2, axes.x(one["slope_to"]) - 2, 100 * one["share"]
        y = axes.y(percent)
        parts.append(_rect(_bar_of(percent), left, y, right - left, axes.y(0) - y, ' rx="2"'))
        label = y + 15 if percent > 10 else y - 4
        parts.append(_text("on-bar", (left + right) / 2, label, f"{percent:.0f}"))
    parts.append(axes.line(axes.x_range, (68, 68), "one"))
    title = "Share of held-out slopes within one standard deviation, by slope"
    return svg("".join(parts), WIDTH, HEIGHT, title)


def _bar_of(percent: float) -> str:
    """CSS class of a fraction within one sigma."""
    if SHARE_RIGHT[0] <= percent <= SHARE_RIGHT[1]:
        return "bar"
    return "bar off" if SHARE_FAIR[0] <= percent <= SHARE_FAIR[1] else "bar far"


def limit_bar(value: float, interval: Sequence[float] | None, good: float, fair: float) -> str:
    """A figure and its interval on the ranges good, fair and poor; smaller is better."""
    end = max(1.5 * fair, 1.05 * value, 1.05 * (interval or [0, 0])[1])
    scale = 200 / end
    parts = [
        _rect("zone-good", 0, 8, good * scale, 6),
        _rect("zone-fair", good * scale, 8, (fair - good) * scale, 6),
        _rect("zone-poor", fair * scale, 8, 200 - fair * scale, 6),
    ]
    if interval:
        low, high = (v * scale for v in interval)
        parts.append(_rect("whisker", low, 9.5, max(high - low, 1.0), 3))
    parts.append(_circle("marker", value * scale, 11, 5.5))
    parts += [_text("tick", limit * scale, 28, f"{limit:g}") for limit in (good, fair)]
    return svg("".join(parts), 206, 32, f"{value:.3g}: good up to {good:g}, fair up to {fair:g}", "limits")


def range_bar(row: dict[str, Any], end: float) -> str:
    """A candidate's normal error with its standard error, from 0 to `end` degrees."""
    value, error = row["normal_free_deg"], row.get("standard_error_deg", 0.0)
    low, high, middle = (160 * v / end for v in (value - error, value + error, value))
    body = _line("grid", 0, 160, 7, 7) + _line("line-first", low, high, 7, 7)
    return svg(
        body + _circle("dot-first", middle, 7, 5 if row["chosen"] else 3.5), 166, 14, f"{value:.3g}°", "range"
    )


def coverage_map(coverage: dict[str, Any], shape: Sequence[int]) -> str:
    """A rose in every cell: one petal for each slope direction, filled by the number of presses that show it."""
    scale = MAP_WIDTH / shape[1]
    parts, cells = _cells(coverage, shape, MAP_WIDTH)
    for (left, top, width, height), counts in zip(cells, coverage["presses"]):
        x, y, radius = left + width / 2, top + height / 2, 0.44 * min(width, height)
        parts += [_petal(x, y, radius, k, len(counts), count) for k, count in enumerate(counts)]
    for number, place in enumerate(coverage["next"], start=1):
        x, y = (place["x_px"] + 0.5) * scale, (place["y_px"] + 0.5) * scale
        parts.append(_circle("next", x, y, place["contact_radius_px"] * scale))
        parts.append(_circle("next-mark", x, y, 12))
        parts.append(_text("next-text", x, y + 5, f"{number}"))
    return _map(
        parts, shape, MAP_WIDTH, "Slope directions that presses show at each place, and where to press next"
    )


def _cells(
    grid: dict[str, Any], shape: Sequence[int], width: int
) -> tuple[list[str], Iterator[tuple[float, float, float, float]]]:
    """The background of a map of the frame, and left, top, width, height of its cells, row by row."""
    height, rows, columns = shape[0] * width / shape[1], grid["rows"], grid["columns"]
    ground = f'<rect class="ground" width="{width}" height="{height:.1f}" rx="3"/>'
    across, down = width / columns, height / rows
    return [ground], (
        (k % columns * across, k // columns * down, across, down) for k in range(rows * columns)
    )


def _map(parts: Sequence[str], shape: Sequence[int], width: int, title: str) -> str:
    return svg("".join(parts), width, shape[0] * width / shape[1], title, "map")


def _petal(x: float, y: float, radius: float, k: int, directions: int, count: int) -> str:
    """One sector of a rose; octant 0 points to the right, 2 downwards."""
    ends = [2 * np.pi * (k + side) / directions for side in (-0.45, 0.45)]
    (x0, y0), (x1, y1) = ((x + radius * np.cos(a), y + radius * np.sin(a)) for a in ends)
    path = f"M{x:.1f} {y:.1f}L{x0:.1f} {y0:.1f}A{radius:.1f} {radius:.1f} 0 0 1 {x1:.1f} {y1:.1f}Z"
    kind = "petal" if count else "petal none"
    return f'<path class="{kind}" fill-opacity="{SUPPORT_OPACITY[min(count, 3)]:g}" d="{path}"/>'


def slope_error_map(errors: dict[str, Any], shape: Sequence[int]) -> str:
    """The RMS length of the held-out slope error as shade, its mean as an arrow, by place."""
    limit = scale_of_errors(errors)
    parts, cells = _cells(errors, shape, MAP_WIDTH)
    arrows = []
    for (left, top, width, height), rms, mean in zip(cells, errors["rms"], errors["mean"]):
        if rms is None:
            continue
        shade = f' fill-opacity="{min(rms / limit, 1) * 0.9 + 0.04:.2f}"'
        title = f"<title>RMS {rms:.3f}, mean ({mean[0]:+.3f}, {mean[1]:+.3f})</title>"
        cell = _rect("heat", left, top, width, height, shade)
        parts.append(f"{cell.removesuffix('/>')}>{title}</rect>")
        arrows.append(_arrow(left + width / 2, top + height / 2, mean, 0.9 * min(width, height) / limit))
    return _map(parts + arrows, shape, MAP_WIDTH, "Held-out slope error over the image")


def scale_of_errors(errors: dict[str, Any]) -> float:
    """The RMS slope error of the map's darkest shade; an arrow of this length spans 0.9 of a cell."""
    known = [rms for rms in errors["rms"] if rms is not None]
    return float(max(np.quantile(known, 0.95), 1e-6)) if known else 1.0


def _arrow(x: float, y: float, mean: Sequence[float], scale: float) -> str:
    """A line from the cell's middle in the direction of the mean error, with a dot at its tail."""
    shrink = min(1.0, LONGEST_ARROW / max(math.hypot(*mean) * scale, 1e-9))
    dx, dy = mean[0] * scale * shrink, mean[1] * scale * shrink
    end = f'<line class="arrow" x1="{x:.1f}" y1="{y:.1f}" x2="{x + dx:.1f}" y2="{y + dy:.1f}"/>'
    return _circle("tail", x, y, 1.6) + end


def share_map(sigma: dict[str, Any], shape: Sequence[int]) -> str:
    """Fraction within one standard deviation by place, as numbers on shades."""
    parts, cells = _cells(sigma, shape, SHARE_MAP_WIDTH)
    for (left, top, width, height), share in zip(cells, sigma["by_place"]):
        words = "–"
        if share is not None:
            words = f"{100 * share:.0f} %"
            parts.append(_rect(_bar_of(100 * share), left + 1, top + 1, width - 2, height - 2, ' rx="2"'))
        parts.append(_text("cell", left + width / 2, top + height / 2 + 5, words))
    title = "Share of held-out slopes within one standard deviation, by place"
    return _map(parts, shape, SHARE_MAP_WIDTH, title)
