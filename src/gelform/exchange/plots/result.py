"""The picture of a result: image, normals, slopes, depth in mm and profiles through its deepest point."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.exchange.plots.canvas import (
    BLUE,
    INK,
    ORANGE,
    WIDTH,
    canvas,
    deepest_px,
    draw_map,
    hatch_behind,
    in_words,
    known_depth,
    pixels_of,
    style_profiles,
)
from gelform.foundations.checks import check_image, check_is, check_mm_per_px
from gelform.result import Reconstruction
from gelform.result.maps import MAPS


def picture(result: Reconstruction, image: ArrayLike | None = None) -> NDArray[np.uint8]:
    """Draw a result: the image, its slopes and its depth.

    Shows the image (if given), normals, both slopes, depth with a scale bar and the contact's outline, and the
    profiles along x and y through the deepest point. Lengths are in mm, or in widths of a pixel if the scale is
    unknown. Unknown pixels are hatched.

    Parameters
    ----------
    result : Reconstruction
    image : (H, W, 3) RGB, the image that was reconstructed

    Returns
    -------
    picture : (h, w, 3) uint8, RGB

    Raises
    ------
    GelformError
        matplotlib is not installed.
    ValueError
            The image and the result differ in size.
    """
    shape = check_is(result, Reconstruction, "result").shape
    shown = None if image is None else check_image(image, shape=shape).astype(np.uint8)
    row, column = deepest_px(_depth(result))
    heights = _heights(shape[0] / shape[1], 3 if shown is None else 4, len(result.health))
    figure = canvas(WIDTH, sum(heights))
    top, bottom = figure.subfigures(2, 1, height_ratios=heights)
    top.suptitle(_headline(result, row, column), x=0.012, ha="left", fontsize=11, color=INK)
    _draw_maps(top, result, shown)
    depth_axes, profile_axes = bottom.subplots(1, 2, width_ratios=[1, 1.05])
    _draw_depth(bottom, depth_axes, result, row, column)
    _draw_profiles(profile_axes, result, row, column)
    return pixels_of(figure)


def _heights(aspect: float, panels: int, lines: int) -> tuple[float, float]:
    """Height of the upper and lower row, inches: as the maps need at the picture's width."""
    return (WIDTH - 1.1) / panels * aspect + 0.75 + 0.2 * lines, max(4.2, (WIDTH / 2 - 1.5) * aspect + 0.9)


def _headline(result: Reconstruction, row: int, column: int) -> str:
    pitch_x, pitch_y = _pitch(result)
    area, unit = np.count_nonzero(result.contact) * pitch_x * pitch_y, _unit(result)
    facts = [
        f"deepest {in_words(_depth(result)[row, column])} {unit}",
        f"contact {area:.1f} {unit}²",
        f"{pitch_x:.4g} mm/px" if result.mm_per_px is not None else "scale unknown",
        f"zero: {result.zero}",
        f"solver: {result.solver}",
    ]
    return "   |   ".join(facts) + "".join(f"\n! {finding.message}" for finding in result.health)


def _pitch(result: Reconstruction) -> tuple[float, float]:
    """Pitch of a pixel, (x, y), in the picture's unit."""
    return (1.0, 1.0) if result.mm_per_px is None else check_mm_per_px(result.mm_per_px)


def _depth(result: Reconstruction) -> NDArray[np.float32]:
    return known_depth(result, result.depth_mm if result.mm_per_px is not None else result.depth_px)


def _unit(result: Reconstruction) -> str:
    return "px" if result.mm_per_px is None else "mm"


def _draw_maps(figure: Any, result: Reconstruction, image: NDArray[np.uint8] | None) -> None:
    slopes = result.gradients
    limit = max(0.1, float(np.quantile(np.abs(slopes), 0.998)))
    normals = np.dstack([(result.normals + 1) / 2, result.known])  # unknown pixels are transparent
    slopes = np.where(result.known[..., None], slopes, np.nan)
    style = {"cmap": MAPS["gradients"].colors, "vmin": -limit, "vmax": limit}
    panels: list[tuple[str, NDArray[Any], dict[str, Any]]] = [
        ("normals (x right, y down, z to the camera)", normals, {}),
        ("slope dz/dx", slopes[..., 0], style),
        ("slope dz/dy", slopes[..., 1], style),
    ]
    if image is not None:
        panels.insert(0, ("image", image, {}))
    grid = figure.subplots(1, len(panels))
    for axes, (title, values, options) in zip(grid, panels):
        shown = draw_map(axes, values, title, **options)
    figure.colorbar(shown, ax=list(grid), shrink=0.95, pad=0.01, aspect=16, label="mm/mm")


def _draw_depth(figure: Any, axes: Any, result: Reconstruction, row: int, column: int) -> None:
    depth, unit, (pitch_x, pitch_y) = _depth(result), _unit(result), _pitch(result)
    height, width = depth.shape
    left, right = -pitch_x / 2, (width - 0.5) * pitch_x  # the first pixel's center is at 0
    low, high = (height - 0.5) * pitch_y, -pitch_y / 2
    shown = axes.imshow(
        depth, cmap=MAPS["depth_mm"].colors, extent=(left, right, low, high), interpolation="nearest"
    )
    hatch_behind(axes)
    figure.colorbar(shown, ax=axes, shrink=0.92, pad=0.015, label=f"depth ({unit}, 0 at rest)")
    if result.contact.any() and not result.contact.all():
        x, y = np.arange(width) * pitch_x, np.arange(height) * pitch_y
        axes.contour(x, y, result.contact, levels=[0.5], colors="white", linewidths=0.8, alpha=0.8)
    if result.known.any():
        axes.axhline(row * pitch_y, color=ORANGE, linewidth=1, alpha=0.9)
        axes.axvline(column * pitch_x, color=BLUE, linewidth=1, alpha=0.9)
    _draw_markers(axes, result)
    _draw_scale_bar(axes, left, right, low, high, unit)
    arrows = "" if result.markers is None else "; arrows: markers moved"
    axes.set_title(f"depth, the contact outlined{arrows}", fontsize=10, color=INK)
    axes.set_xlabel(f"x ({unit})")
    axes.set_ylabel(f"y ({unit})")


def _draw_markers(axes: Any, result: Reconstruction) -> None:
    """Draw each marker's displacement from its place at rest as an arrow; markers that were not found are paler."""
    flow = result.markers
    if flow is None or not len(flow):
        return
    pitch = np.array(_pitch(result))
    (x, y), (dx, dy) = (flow.rest_px * pitch).T, (flow.displacement_px * pitch).T
    shades = [(1.0, 1.0, 1.0, 1.0 if seen else 0.3) for seen in flow.seen]
    axes.quiver(x, y, dx, dy, angles="xy", scale_units="xy", scale=1, color=shades, width=0.004, headwidth=4)


def _draw_scale_bar(axes: Any, left: float, right: float, low: float, high: float, unit: str) -> None:
    """A white bar of a round length, about a quarter of the width, in the lower left corner."""
    from matplotlib.patheffects import withStroke

    length = _round_length((right - left) / 4)
    x, y = left + 0.04 * (right - left), low - 0.06 * (low - high)
    outline = [withStroke(linewidth=5.5, foreground="black")]
    axes.plot(
        [x, x + length], [y, y], color="white", linewidth=3.5, solid_capstyle="butt", path_effects=outline
    )
    label = axes.text(x + length / 2, y - 0.02 * (low - high), f"{length:g} {unit}", ha="center", va="bottom")
    label.set(color="white", fontsize=10, fontweight="bold")
    label.set_path_effects([withStroke(linewidth=2.5, foreground="black")])


def _round_length(length: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not longer."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(max(step for step in (1, 2, 5) if step * power <= length * (1 + 1e-9)) * power)


def _draw_profiles(axes: Any, result: Reconstruction, row: int, column: int) -> None:
    depth, unit, (pitch_x, pitch_y) = _depth(result), _unit(result), _pitch(result)
    x, y = (np.arange(depth.shape[1]) - column) * pitch_x, (np.arange(depth.shape[0]) - row) * pitch_y
    style_profiles(axes, "profiles through the deepest point", unit)
    axes.plot(x, depth[row], color=ORANGE, linewidth=1.5, label="along x")
    axes.plot(y, depth[:, column], color=BLUE, linewidth=1.5, label="along y")
    axes.fill_between(x, depth[row], 0, color=ORANGE, alpha=0.1)
    deepest = float(depth[row, column])
    axes.plot(0, deepest, "o", color=INK, markersize=4)
    place = {"xytext": (6, 4), "textcoords": "offset points"}
    axes.annotate(f"{in_words(deepest)} {unit}", (0, deepest), **place, fontsize=9, color=INK)
    axes.legend(frameon=False, fontsize=9, loc="lower right", bbox_to_anchor=(1, 0.99), ncols=2)
