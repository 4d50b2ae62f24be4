"""The picture of a design study: expected depth error, slope noise and conditioning over the gel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.design.study import DesignResult
from gelform.plots.canvas import canvas, draw_map, pixels_of

ROWS = ("depth error, um", "slope noise of a pixel", "condition of the lights")


def design_picture(results: Sequence[DesignResult]) -> NDArray[np.uint8]:
    """One column per design, one row per map, each with its median and one colour scale; white: no test press was there.

    The last row shows the gel among its LEDs, dots in their colours; the others the gel alone.

    Returns
    -------
    picture : (h, w, 3) uint8, RGB

    Raises
    ------
    GelformError
        matplotlib is not installed.
    """
    figure = canvas(2.3 * len(results) + 0.8, 6.2)
    axes = figure.subplots(len(ROWS), len(results), squeeze=False)
    maps = [
        [r.depth_map_um for r in results],
        [r.slope_sigma for r in results],
        [r.condition for r in results],
    ]
    for row, (label, values) in enumerate(zip(ROWS, maps)):
        low, high = (
            np.nanmin([np.nanmin(v) for v in values]),
            np.nanmax([np.nanquantile(v, 0.98) for v in values]),
        )
        for column, (value, result) in enumerate(zip(values, results)):
            drawn = _draw(axes[row, column], value, result, low, high)
            if row == len(ROWS) - 1:
                _draw_leds(axes[row, column], result)
            axes[row, column].set_xlabel(f"median {np.nanmedian(value):.3g}", fontsize=8)
        figure.colorbar(drawn, ax=list(axes[row]), label=label, shrink=0.85)
    for column, result in enumerate(results):
        title = f"{result.name}\n{result.depth_rmse_um:.0f} ± {result.depth_rmse_se_um:.0f} um, {result.normal_deg:.1f}°"
        axes[0, column].set_title(title, fontsize=9)
    return pixels_of(figure)


def _draw(axes: Any, values: NDArray[Any], result: DesignResult, low: float, high: float) -> Any:
    height, width = (n * result.sensor.mm_per_px / 2 for n in result.sensor.shape)
    extent = (-width, width, height, -height)
    return draw_map(axes, values, "", cmap="viridis", vmin=low, vmax=high, extent=extent)


def _draw_leds(axes: Any, result: DesignResult) -> None:
    """The LEDs around the gel, to scale."""
    height, width = (n * result.sensor.mm_per_px / 2 for n in result.sensor.shape)
    for led in result.sensor.leds:
        x, y, _ = led.position_mm
        color = np.asarray(led.color) / max(led.color)
        axes.plot(x, y, "o", color=tuple(color), markersize=4, markeredgecolor="black", markeredgewidth=0.5)
    places = np.abs([led.position_mm for led in result.sensor.leds])
    x, y = 1.1 * max(width, places[:, 0].max()), 1.1 * max(height, places[:, 1].max())
    axes.set(xlim=(-x, x), ylim=(y, -y))
