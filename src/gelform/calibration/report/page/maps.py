"""The report's maps of the frame as SVG: coverage, where to press next, slope errors, shares within sigma."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from gelform.calibration.report.page.charts import svg

WIDTH = 560
LONGEST_ARROW = 50.0
SUPPORT_OPACITY = (0.0, 0.3, 0.55, 0.85)


def coverage_map(coverage: dict[str, Any], shape: Sequence[int]) -> str:
    """A rose in every cell: one petal for each slope direction, filled by how many presses have shown it."""
    scale = WIDTH / shape[1]
    height = shape[0] * scale
    rows, columns = coverage["rows"], coverage["columns"]
    cell_width, cell_height = WIDTH / columns, height / rows
    radius = 0.44 * min(cell_width, cell_height)
    parts = [f'<rect class="ground" width="{WIDTH}" height="{height:.1f}" rx="3"/>']
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
        "".join(parts), WIDTH, height, "Slope directions seen at each place, and where to press next", "map"
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
    height = shape[0] * WIDTH / shape[1]
    rows, columns = errors["rows"], errors["columns"]
    width, tall = WIDTH / columns, height / rows
    limit = scale_of_errors(errors)
    parts = [f'<rect class="ground" width="{WIDTH}" height="{height:.1f}" rx="3"/>']
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
    return svg("".join(parts + arrows), WIDTH, height, "Held-out slope error over the frame", "map")


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
