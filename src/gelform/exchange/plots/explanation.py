"""The picture of an explanation: the image, the confidence of each slope, and the share of each cause (extra `plots`)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.exchange.plots.canvas import INK, WIDTH, canvas, draw_map, pixels_of
from gelform.foundations.checks import check_image
from gelform.result.maps import MAPS
from gelform.slopes.confidence import Explanation
from gelform.slopes.confidence.causes import CAUSES

COLUMNS = 4  # panels per row
USUAL = "usual noise"  # what no cause explains
LEAST_SHARE = 5e-4  # fraction of the frame that a cause affects; a smaller one gets no panel
COLORS = ("#e8e8e8", *(cause.color for cause in CAUSES.values()))
"""Colors of the usual noise and of each cause, in the order of `CAUSES`."""


def explanation_picture(explanation: Explanation, image: ArrayLike) -> NDArray[np.uint8]:
    """Draw why each pixel has its confidence: image, confidence, sigma, largest cause, and a panel for each cause.

    Parameters
    ----------
    explanation : result of `Reconstructor.explain`
    image : (H, W, 3) RGB, its image

    Returns
    -------
    picture : (h, w, 3) uint8, RGB

    Raises
    ------
    GelformError
        matplotlib is not installed.
    ValueError
        The image has another size.
    """
    shown = check_image(image, shape=explanation.confidence.shape).astype(np.uint8)
    there = {name: one for name, one in explanation.maps.items() if (one > 0).mean() >= LEAST_SHARE}
    rows = 1 + -(-len(there) // COLUMNS)
    height = (WIDTH - 1.5) / COLUMNS * shown.shape[0] / shown.shape[1] + 0.6
    figure = canvas(WIDTH, rows * height + 0.5 + 0.2 * len(explanation.findings))
    grid = figure.subplots(rows, COLUMNS, squeeze=False)
    figure.suptitle(_headline(explanation), x=0.012, ha="left", fontsize=11, color=INK)
    _draw_summary(figure, grid[0], explanation, shown)
    panels = grid[1:].ravel()
    for axes, (name, one) in zip(panels, there.items()):
        drawn = draw_map(
            axes, one, f"{name}: {100 * explanation.shares[name]:.1f} % of the variance", **_style()
        )
    free = panels[len(there) :]
    if there:  # the bar stands in the first free place, beside the last map
        where = {"cax": free[0].inset_axes((0.02, 0.04, 0.06, 0.92))} if len(free) else {"ax": list(panels)}
        figure.colorbar(drawn, **where, label="sigma (mm/mm)")
    for axes in free:
        axes.set_axis_off()
    return pixels_of(figure)


def _style() -> dict[str, Any]:
    """Sigma from 0.01 to 1 mm/mm on a logarithmic scale; the palest color means none."""
    from matplotlib.colors import LogNorm

    return {"cmap": "magma_r", "norm": LogNorm(0.01, 1, clip=True)}


def _headline(explanation: Explanation) -> str:
    trusted = float((explanation.confidence >= 0.5).mean())
    law = explanation.shares["law"]
    lines = [
        f"{100 * trusted:.1f} % of the pixels have a confidence of 0.5 or more   |   {USUAL}: "
        f"{100 * law:.1f} % of the variance   |   confidence 1 up to sigma {explanation.full_confidence_sigma:.3g} mm/mm"
    ]
    return "\n".join([*lines, *(f"! {finding.message}" for finding in explanation.findings)])


def _draw_summary(figure: Any, grid: Any, explanation: Explanation, image: NDArray[np.uint8]) -> None:
    draw_map(grid[0], image, "image")
    confidence = draw_map(
        grid[1], explanation.confidence, "confidence", cmap=MAPS["confidence"].colors, vmin=0, vmax=1
    )
    figure.colorbar(confidence, ax=grid[1], shrink=0.7, pad=0.02)
    sigma = draw_map(grid[2], explanation.gradients_sigma, "sigma of the slopes (mm/mm)", **_style())
    figure.colorbar(sigma, ax=grid[2], shrink=0.7, pad=0.02)
    _draw_dominant(grid[3], explanation)


def _draw_dominant(axes: Any, explanation: Explanation) -> None:
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    names = (USUAL, *explanation.maps)
    style = {"cmap": ListedColormap(COLORS), "vmin": -0.5, "vmax": len(COLORS) - 0.5}
    draw_map(axes, explanation.dominant, "largest cause", **style)
    there = [k for k in np.unique(explanation.dominant) if (explanation.dominant == k).mean() >= LEAST_SHARE]
    patches = [Patch(facecolor=COLORS[k], edgecolor=INK, linewidth=0.5, label=names[k]) for k in there]
    axes.legend(handles=patches, fontsize=8, loc="lower left", framealpha=0.9)
