"""Pictures of results, of explanations, and of two calibrations side by side; needs matplotlib, the extra `plots`.

Figures are drawn off screen; matplotlib's global state stays unchanged.
"""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gelform.arrays import Array, Image, Map
from gelform.depth.contact import at_least
from gelform.errors import DataError, needed
from gelform.foundations.checks import check_image, check_is, check_mm_per_px
from gelform.foundations.files import picture_bytes, written_file
from gelform.result import Reconstruction
from gelform.result.maps import MAPS
from gelform.result.measure import Measured
from gelform.result.metrics import angle_deg
from gelform.slopes.budget import CAUSES, Explanation

DPI, WIDTH = 110, 13.0  # pixels per inch, and inches of most pictures
INK, FAINT, GRID = "#222222", "#8a8a8a", "#e6e6e6"
ORANGE, BLUE = "#f4731c", "#29a3e0"


def check_matplotlib() -> None:
    """Raise DataError, naming the extra, if matplotlib is not installed."""
    needed("matplotlib", "plots", "A picture")


def canvas(width: float, height: float, *, layout: Any = "constrained") -> Any:
    """An off-screen matplotlib figure of a size in inches."""
    check_matplotlib()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=DPI, layout=layout, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def pixels_of(figure: Any) -> Image:
    """The drawn figure as an RGB picture (h, w, 3)."""
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba(), dtype=np.uint8)[..., :3].copy()


def save_picture(path: str | PathLike[str], picture: ArrayLike, *, overwrite: bool = False) -> None:
    """Write an RGB picture (h, w, 3) uint8 as PNG, completely or not at all.

    DataError: the file exists and `overwrite` is False, or it cannot be written.
    """
    content = picture_bytes(check_image(picture, name="picture").astype(np.uint8))
    with written_file(path, overwrite=overwrite) as handle:
        handle.write(content)


def draw_map(axes: Any, values: ArrayLike, title: str, **style: Any) -> Any:
    """Show an image or a map under a title, pixel by pixel and without ticks; returns the object for a color bar.

    NaN, which means unknown, is hatched.
    """
    drawn = axes.imshow(values, interpolation="nearest", **style)
    _hatch_behind(axes)
    axes.set_title(title, fontsize=10, color=INK)
    axes.set_xticks([])
    axes.set_yticks([])
    return drawn


def _hatch_behind(axes: Any) -> None:
    """Hatch the axes' background, which shows where a map is NaN (unknown)."""
    axes.set_facecolor(GRID)
    axes.patch.set(hatch="///", edgecolor=FAINT, linewidth=0)


def _style_profiles(axes: Any, title: str, unit: str) -> None:
    """The frame around depth profiles: zero line, faint grid, labels in the unit of both axes."""
    axes.axhline(0, color=FAINT, linewidth=0.8, zorder=1)
    axes.margins(x=0.01, y=0.12)
    axes.grid(color=GRID, linewidth=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_title(title, fontsize=10, color=INK, loc="left")
    axes.set_xlabel(f"distance from it ({unit})")
    axes.set_ylabel(f"depth ({unit})")


def _known(result: Reconstruction, depth: Map) -> Map:
    """A depth of the result for drawing: NaN where it was filled without information."""
    return np.where(result.known, depth, np.float32(np.nan))


def _in_unit(result: Reconstruction) -> tuple[Map, str, tuple[float, float]]:
    """Depth (H, W) for drawing, its unit, mm, or px without a scale, and in it the pitch (x, y) of a pixel."""
    if result.mm_per_px is None:
        return _known(result, result.depth_px), "px", (1.0, 1.0)
    return _known(result, result.depth_mm), "mm", check_mm_per_px(result.mm_per_px)


def _in_words(depth: float) -> str:
    """A depth to the micrometer; a dash if it is unknown."""
    return "–" if np.isnan(depth) else f"{depth:.3f}"


def deepest_px(depth: Map) -> tuple[int, int]:
    """Row and column of the deepest pixel that is not NaN (unknown). If all are NaN, the first pixel."""
    row, column = divmod(int(np.argmax(np.where(np.isnan(depth), -np.inf, depth))), depth.shape[1])
    return row, column


def picture(result: Reconstruction, image: ArrayLike | None = None) -> Image:
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
    row, column = deepest_px(_in_unit(result)[0])
    aspect, panels = shape[0] / shape[1], 3 if shown is None else 4
    upper = (WIDTH - 1.1) / panels * aspect + 0.75 + 0.2 * len(result.health)  # inches, as the maps need
    heights = upper, max(4.2, (WIDTH / 2 - 1.5) * aspect + 0.9)
    figure = canvas(WIDTH, sum(heights))
    top, bottom = figure.subfigures(2, 1, height_ratios=heights)
    top.suptitle(_headline_of_result(result, row, column), x=0.012, ha="left", fontsize=11, color=INK)
    _draw_maps(top, result, shown)
    depth_axes, profile_axes = bottom.subplots(1, 2, width_ratios=[1, 1.05])
    _draw_depth(bottom, depth_axes, result, row, column)
    _draw_profiles(profile_axes, result, row, column)
    return pixels_of(figure)


def _headline_of_result(result: Reconstruction, row: int, column: int) -> str:
    depth, unit, (pitch_x, pitch_y) = _in_unit(result)
    area = np.count_nonzero(result.contact) * pitch_x * pitch_y
    unsure = result.numbers is not None and result.numbers.at_least
    facts = [
        f"deepest {at_least(unsure)}{_in_words(depth[row, column])} {unit}",
        f"contact {area:.1f} {unit}²",
        f"{pitch_x:.4g} mm/px" if result.mm_per_px is not None else "scale unknown",
        f"zero: {result.zero}",
        f"solver: {result.solver}",
    ]
    return "   |   ".join(facts) + "".join(f"\n! {finding.message}" for finding in result.health)


def _draw_maps(figure: Any, result: Reconstruction, image: Image | None) -> None:
    slopes = result.gradients
    limit = max(0.1, float(np.quantile(np.abs(slopes), 0.998)))
    normals = np.dstack([(result.normals + 1) / 2, result.known])  # unknown pixels are transparent
    slopes = np.where(result.known[..., None], slopes, np.nan)
    style = {"cmap": MAPS["gradients"].colors, "vmin": -limit, "vmax": limit}
    panels: list[tuple[str, Array, dict[str, Any]]] = [
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
    depth, unit, (pitch_x, pitch_y) = _in_unit(result)
    height, width = depth.shape
    left, right = -pitch_x / 2, (width - 0.5) * pitch_x  # the first pixel's center is at 0
    low, high = (height - 0.5) * pitch_y, -pitch_y / 2
    shown = axes.imshow(
        depth, cmap=MAPS["depth_mm"].colors, extent=(left, right, low, high), interpolation="nearest"
    )
    _hatch_behind(axes)
    figure.colorbar(shown, ax=axes, shrink=0.92, pad=0.015, label=f"depth ({unit}, 0 at rest)")
    if result.contact.any() and not result.contact.all():
        x, y = np.arange(width) * pitch_x, np.arange(height) * pitch_y
        axes.contour(x, y, result.contact, levels=[0.5], colors="white", linewidths=0.8, alpha=0.8)
    if result.known.any():
        axes.axhline(row * pitch_y, color=ORANGE, linewidth=1, alpha=0.9)
        axes.axvline(column * pitch_x, color=BLUE, linewidth=1, alpha=0.9)
    _draw_scale_bar(axes, left, right, low, high, unit)
    flow = result.markers
    if flow is not None and len(flow):
        # An arrow from each place at rest; markers that were not found are paler.
        (x, y), (dx, dy) = (one.T * [[pitch_x], [pitch_y]] for one in (flow.rest_px, flow.displacement_px))
        shades = [(1.0, 1.0, 1.0, 1.0 if seen else 0.3) for seen in flow.seen]
        how = {"angles": "xy", "scale_units": "xy", "scale": 1, "width": 0.004, "headwidth": 4}
        axes.quiver(x, y, dx, dy, color=shades, **how)
    arrows = "" if flow is None else "; arrows: markers moved"
    axes.set_title(f"depth, the contact outlined{arrows}", fontsize=10, color=INK)
    axes.set_xlabel(f"x ({unit})")
    axes.set_ylabel(f"y ({unit})")


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
    depth, unit, (pitch_x, pitch_y) = _in_unit(result)
    x, y = (np.arange(depth.shape[1]) - column) * pitch_x, (np.arange(depth.shape[0]) - row) * pitch_y
    _style_profiles(axes, "profiles through the deepest point", unit)
    axes.plot(x, depth[row], color=ORANGE, linewidth=1.5, label="along x")
    axes.plot(y, depth[:, column], color=BLUE, linewidth=1.5, label="along y")
    axes.fill_between(x, depth[row], 0, color=ORANGE, alpha=0.1)
    deepest = float(depth[row, column])
    axes.plot(0, deepest, "o", color=INK, markersize=4)
    place = {"xytext": (6, 4), "textcoords": "offset points"}
    axes.annotate(f"{_in_words(deepest)} {unit}", (0, deepest), **place, fontsize=9, color=INK)
    axes.legend(frameon=False, fontsize=9, loc="lower right", bbox_to_anchor=(1, 0.99), ncols=2)


def measured_picture(result: Reconstruction, measured: Measured) -> Image:
    """Draw what was measured on a result: depth with the lines and regions, each profile, and the figures in words.

    The picture is (h, w, 3) uint8, RGB. GelformError: matplotlib is not installed.
    """
    depth, unit, _ = _in_unit(result)
    words = [f"{one.of}, {one}" for one in measured.quantities]
    panels, upper = max(len(measured.profiles), 1), WIDTH / 2 * depth.shape[0] / depth.shape[1]
    figure = canvas(WIDTH, max(upper, 0.22 * len(words)) + 3.2 * -(-panels // 2))
    figure.suptitle(
        _headline_of_result(result, *deepest_px(depth)), x=0.012, ha="left", fontsize=11, color=INK
    )
    top, bottom = figure.subfigures(
        2, 1, height_ratios=(max(upper, 0.22 * len(words)), 3.2 * -(-panels // 2))
    )
    map_axes, text_axes = top.subplots(1, 2)
    shown = map_axes.imshow(depth, cmap=MAPS["depth_mm"].colors, interpolation="nearest")
    _hatch_behind(map_axes)
    top.colorbar(shown, ax=map_axes, shrink=0.92, pad=0.015, label=f"depth ({unit}, 0 at rest)")
    for k, mask in enumerate(measured.regions):
        map_axes.contour(mask, levels=[0.5], colors="white", linewidths=1)
        y, x = np.argwhere(mask).mean(axis=0)
        map_axes.text(x, y, str(k + 1), color="white", ha="center", va="center", fontweight="bold")
    text_axes.set_axis_off()
    text_axes.text(0, 1, "\n".join(words), va="top", fontsize=9, color=INK)
    grid = bottom.subplots(-(-panels // 2), min(panels, 2), squeeze=False).ravel()
    for axes in grid[len(measured.profiles) :]:
        axes.set_axis_off()
    for k, (axes, one) in enumerate(zip(grid, measured.profiles)):
        x1, y1, x2, y2 = one.line
        map_axes.annotate(
            "", (x2, y2), (x1, y1), arrowprops={"arrowstyle": "->", "color": ORANGE, "linewidth": 1.5}
        )
        map_axes.text(x1, y1, f"line {k + 1}", color=ORANGE, fontweight="bold")
        _style_profiles(axes, f"line {k + 1}", unit)
        axes.set_xlabel(f"distance from its first end ({unit})")
        axes.plot(one.distance_mm, np.where(one.known, one.depth_mm, np.nan), color=ORANGE, linewidth=1.5)
        if one.base_mm is not None and one.edges_mm is not None:
            axes.plot(one.distance_mm, one.base_mm, color=FAINT, linestyle="--", linewidth=1)
            at = np.interp(one.edges_mm, one.distance_mm, one.depth_mm)
            axes.plot(one.edges_mm, at, "o-", color=BLUE, markersize=4, linewidth=1)
    return pixels_of(figure)


USUAL, USUAL_COLOR = "usual noise", "#e8e8e8"  # what no cause explains
LEAST_SHARE = 5e-4  # fraction of the frame that a cause affects; a smaller one gets no panel


def explanation_picture(explanation: Explanation, image: ArrayLike) -> Image:
    """Draw why each pixel has its confidence: image, confidence, sigma, largest cause, and a panel for each cause.

    The explanation is that of `Reconstructor.explain` for the image (H, W, 3) RGB; the picture is (h, w, 3) uint8, RGB.

    GelformError: matplotlib is not installed. ValueError: the image has another size.
    """
    shown = check_image(image, shape=explanation.confidence.shape).astype(np.uint8)
    there = {name: one for name, one in explanation.maps.items() if (one > 0).mean() >= LEAST_SHARE}
    columns = 4
    rows = 1 + -(-len(there) // columns)
    height = (WIDTH - 1.5) / columns * shown.shape[0] / shown.shape[1] + 0.6
    figure = canvas(WIDTH, rows * height + 0.5 + 0.2 * len(explanation.findings))
    grid = figure.subplots(rows, columns, squeeze=False)
    trusted = 100 * float((explanation.confidence >= 0.5).mean())
    headline = (
        f"{trusted:.1f} % of the pixels have a confidence of 0.5 or more   |   {USUAL}: "
        f"{100 * explanation.shares['law']:.1f} % of the variance   |   confidence 1 up to sigma "
        f"{explanation.full_confidence_sigma:.3g} mm/mm"
    ) + "".join(f"\n! {finding.message}" for finding in explanation.findings)
    figure.suptitle(headline, x=0.012, ha="left", fontsize=11, color=INK)
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


def _draw_summary(figure: Any, grid: Any, explanation: Explanation, image: Image) -> None:
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    draw_map(grid[0], image, "image")
    confidence = draw_map(
        grid[1], explanation.confidence, "confidence", cmap=MAPS["confidence"].colors, vmin=0, vmax=1
    )
    figure.colorbar(confidence, ax=grid[1], shrink=0.7, pad=0.02)
    sigma = draw_map(grid[2], explanation.gradients_sigma, "sigma of the slopes (mm/mm)", **_style())
    figure.colorbar(sigma, ax=grid[2], shrink=0.7, pad=0.02)
    axes = grid[3]
    names = (USUAL, *explanation.maps)
    colors = (USUAL_COLOR, *(CAUSES[name].color for name in explanation.maps))
    style = {"cmap": ListedColormap(colors), "vmin": -0.5, "vmax": len(colors) - 0.5}
    draw_map(axes, explanation.dominant, "largest cause", **style)
    there = [k for k in np.unique(explanation.dominant) if (explanation.dominant == k).mean() >= LEAST_SHARE]
    patches = [Patch(facecolor=colors[k], edgecolor=INK, linewidth=0.5, label=names[k]) for k in there]
    axes.legend(handles=patches, fontsize=8, loc="lower left", framealpha=0.9)


@dataclass(frozen=True)
class Comparison:
    """Two depth maps in one unit, and their differences."""

    unit: str  # "mm", or "px" (widths of a pixel) if one of the two has no scale
    depths: tuple[Map, Map]  # the two maps (H, W) float32, in that unit
    peak_a: float  # their deepest points
    peak_b: float
    difference_rms: float  # of B minus A over the frame
    # Mean angle between their normals, inside the contact of either; None if neither has one.
    angle_deg: float | None
    curl_rms_a: float  # deviation of the slopes from those of a surface, slope per pixel
    curl_rms_b: float

    def figures(self) -> dict[str, Any]:
        """All but the maps, for JSON."""
        return {name: value for name, value in vars(self).items() if name != "depths"}


def compare_results(a: Reconstruction, b: Reconstruction) -> Comparison:
    """Compare two results of the same image.

    DataError: they differ in size.
    """
    if a.shape != b.shape:
        raise DataError(
            f"Expected two results of one size, got {a.shape[0]}x{a.shape[1]} and {b.shape[0]}x{b.shape[1]} px: "
            "the calibrations crop or scale frames differently."
        )
    unit = "mm" if a.mm_per_px is not None and b.mm_per_px is not None else "px"
    depths = (a.depth_mm, b.depth_mm) if unit == "mm" else (a.depth_px, b.depth_px)
    touched, known = a.contact | b.contact, a.known & b.known
    peak_a, peak_b = (
        float(depth[one.known].max()) if one.known.any() else float("nan")
        for depth, one in zip(depths, (a, b))
    )
    squares = (depths[1] - depths[0])[known].astype(np.float64) ** 2
    angle = angle_deg(b.gradients[touched], a.gradients[touched])
    return Comparison(
        unit=unit,
        depths=depths,
        peak_a=peak_a,
        peak_b=peak_b,
        difference_rms=float(np.sqrt(squares.mean())) if squares.size else float("nan"),
        angle_deg=float(angle.mean()) if angle.size else None,
        curl_rms_a=a.curl_rms,
        curl_rms_b=b.curl_rms,
    )


def comparison_picture(
    a: Reconstruction, b: Reconstruction, image: ArrayLike, *, names: tuple[str, str] = ("A", "B")
) -> Image:
    """The image, both depths on one scale, their difference, and both profiles through A's deepest point.

    Parameters
    ----------
    a, b : results of the same image
    image : (H, W, 3) RGB
    names : of the two calibrations

    Returns
    -------
    picture : (h, w, 3) uint8, RGB

    Raises
    ------
    DataError
        The results differ in size.
    GelformError
        matplotlib is not installed.
    ValueError
        The image has another size.
    """
    compared = compare_results(a, b)
    shown = check_image(image, shape=a.shape).astype(np.uint8)
    limits = {"vmin": np.min(compared.depths), "vmax": np.max(compared.depths)}
    far = max(float(np.abs(np.subtract(*compared.depths)).max()), 1e-6)
    first, second = depths = _known(a, compared.depths[0]), _known(b, compared.depths[1])
    row, column = deepest_px(first)
    tall = 3.0 * a.shape[0] / a.shape[1]
    figure = canvas(14.0, tall + 4.0)
    unit, angle = compared.unit, "no contact"
    if compared.angle_deg is not None:
        angle = f"normals {compared.angle_deg:.1f} deg apart in contact"
    deepest = " and ".join(_in_words(np.fmax.reduce(depth, axis=None)) for depth in depths)
    headline = (
        f"deepest {deepest} {unit}   |   difference {compared.difference_rms:.3f} {unit} RMS   |   {angle}   |   "
        f"curl {compared.curl_rms_a:.3f} and {compared.curl_rms_b:.3f}"
    )
    figure.suptitle(headline, x=0.012, ha="left", fontsize=11, color=INK)
    top, bottom = figure.subfigures(2, 1, height_ratios=[tall + 0.5, 3.0])
    axes = top.subplots(1, 4)
    draw_map(axes[0], shown, "image")
    titles = f"A: {names[0]}", f"B: {names[1]}"
    for panel, depth, title in zip(axes[1:3], depths, titles):
        map_shown = draw_map(panel, depth, title, cmap=MAPS["depth_mm"].colors, **limits)
        panel.axhline(row, color="white", linewidth=0.8, alpha=0.7)
    top.colorbar(map_shown, ax=list(axes[1:3]), shrink=0.9, pad=0.01, label=f"depth ({unit})")
    difference = draw_map(axes[3], second - first, "B minus A", cmap="RdBu_r", vmin=-far, vmax=far)
    top.colorbar(difference, ax=axes[3], shrink=0.9, pad=0.01, label=unit)
    profiles = bottom.subplots(1, 1)
    pitch = check_mm_per_px(a.mm_per_px)[0] if unit == "mm" else 1.0
    place = (np.arange(a.shape[1]) - column) * pitch
    _style_profiles(profiles, "profiles along x through A's deepest point", unit)
    for depth, color, title in zip(depths, (ORANGE, BLUE), titles):
        profiles.plot(place, depth[row], color=color, linewidth=1.5, label=title)
    profiles.legend(frameon=False, fontsize=9)
    return pixels_of(figure)
