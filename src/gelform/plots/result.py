"""Pictures of a result: image, normals, gradients, depth in mm and a profile through its deepest point.

Needs matplotlib, the extra `plots`. Figures are drawn off screen; matplotlib's global state is not touched.
"""

from __future__ import annotations

from os import PathLike
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.checks import check_image, check_mm_per_px
from gelform.errors import DataError, GelformError
from gelform.npz_files import written_file
from gelform.reconstruction import Reconstruction

DPI, WIDTH = 110, 13.0
INK, FAINT = "#222222", "#8a8a8a"
ALONG_X, ALONG_Y = "#f4731c", "#29a3e0"


def picture(result: Reconstruction, image: ArrayLike | None = None) -> NDArray[np.uint8]:
    """One picture of a result: what came in, what was found, and how deep it is.

    Image (where given), normals, both slopes, depth with a scale bar and the contact's outline, and the
    profiles along x and y through the deepest point, in mm; in widths of a pixel where the scale is unknown.

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
    """
    depth, shape = _depth(result), result.shape
    shown = None if image is None else check_image(image, shape=shape).astype(np.uint8)
    row, column = _deepest(depth)
    heights = _heights(shape[0] / shape[1], 3 if shown is None else 4, len(result.health))
    figure = canvas(WIDTH, sum(heights))
    top, bottom = figure.subfigures(2, 1, height_ratios=heights)
    top.suptitle(_headline(result, row, column), x=0.012, ha="left", fontsize=11, color=INK)
    _draw_maps(top, result, shown)
    depth_axes, profile_axes = bottom.subplots(1, 2, width_ratios=[1, 1.05])
    _draw_depth(bottom, depth_axes, result, row, column)
    _draw_profiles(profile_axes, result, row, column)
    return pixels_of(figure)


def save_picture(path: str | PathLike[str], picture: ArrayLike, *, overwrite: bool = False) -> None:
    """Write an RGB picture (h, w, 3) uint8 as PNG, whole or not at all.

    Raises
    ------
    DataError
        The file is already there and `overwrite` is False, or it cannot be written.
    """
    pixels = np.ascontiguousarray(check_image(picture, name="picture").astype(np.uint8)[..., ::-1])
    done, png = cv2.imencode(".png", pixels)
    if not done:
        raise DataError(f"OpenCV cannot encode a picture of {pixels.shape[0]}x{pixels.shape[1]} px as PNG.")
    with written_file(path, overwrite=overwrite) as handle:
        handle.write(png.tobytes())


def check_matplotlib() -> None:
    """Raise GelformError, naming the extra, where matplotlib is not installed."""
    try:
        import matplotlib  # noqa: F401
    except ImportError as problem:
        raise GelformError("Pictures need matplotlib. Install it: pip install 'gelform[plots]'.") from problem


def canvas(width: float, height: float, *, layout: Any = "constrained") -> Any:
    """An off-screen matplotlib figure of a size in inches."""
    check_matplotlib()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=DPI, layout=layout, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def pixels_of(figure: Any) -> NDArray[np.uint8]:
    """The drawn figure as an RGB picture."""
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba(), dtype=np.uint8)[..., :3].copy()


def _heights(aspect: float, panels: int, lines: int) -> tuple[float, float]:
    """Inches of the upper and lower row: what the maps need at the picture's width."""
    return (WIDTH - 1.1) / panels * aspect + 0.75 + 0.2 * lines, max(4.2, (WIDTH / 2 - 1.5) * aspect + 0.9)


def _headline(result: Reconstruction, row: int, column: int) -> str:
    pitch_x, pitch_y = _pitch(result)
    area, unit = np.count_nonzero(result.contact) * pitch_x * pitch_y, _unit(result)
    facts = [
        f"deepest {_depth(result)[row, column]:.3f} {unit}",
        f"contact {area:.1f} {unit}²",
        f"{pitch_x:.4g} mm/px" if result.mm_per_px is not None else "scale unknown",
        f"zero: {result.zero}",
        f"solver: {result.solver}",
    ]
    return "   |   ".join(facts) + "".join(f"\n! {finding.message}" for finding in result.health)


def _pitch(result: Reconstruction) -> tuple[float, float]:
    """Of a pixel, in the picture's unit."""
    return (1.0, 1.0) if result.mm_per_px is None else check_mm_per_px(result.mm_per_px)


def _depth(result: Reconstruction) -> NDArray[np.float32]:
    return result.depth_mm if result.mm_per_px is not None else result.depth_px


def _unit(result: Reconstruction) -> str:
    return "px" if result.mm_per_px is None else "mm"


def _draw_maps(figure: Any, result: Reconstruction, image: NDArray[np.uint8] | None) -> None:
    slopes = result.gradients
    limit = max(0.1, float(np.quantile(np.abs(slopes), 0.998)))
    panels: list[tuple[str, NDArray[Any], dict[str, Any]]] = [
        ("normals (x right, y down, z to the camera)", (result.normals + 1) / 2, {}),
        ("slope dz/dx", slopes[..., 0], {"cmap": "RdBu_r", "vmin": -limit, "vmax": limit}),
        ("slope dz/dy", slopes[..., 1], {"cmap": "RdBu_r", "vmin": -limit, "vmax": limit}),
    ]
    if image is not None:
        panels.insert(0, ("image", image, {}))
    grid = figure.subplots(1, len(panels))
    for axes, (title, values, style) in zip(grid, panels):
        shown = axes.imshow(values, interpolation="nearest", **style)
        axes.set_title(title, fontsize=10, color=INK)
        axes.set_xticks([])
        axes.set_yticks([])
    figure.colorbar(shown, ax=list(grid), shrink=0.95, pad=0.01, aspect=16, label="mm/mm")


def _deepest(depth_mm: NDArray[np.float32]) -> tuple[int, int]:
    """Row and column of the deepest point, single noisy pixels aside."""
    smooth = cv2.GaussianBlur(depth_mm, (0, 0), 1)
    row, column = np.unravel_index(int(np.argmax(smooth)), smooth.shape)
    return int(row), int(column)


def _extent(result: Reconstruction) -> tuple[float, float, float, float]:
    """Edges of the picture in mm (or px), with the first pixel's centre at 0."""
    pitch_x, pitch_y = _pitch(result)
    height, width = _depth(result).shape
    return -pitch_x / 2, (width - 0.5) * pitch_x, (height - 0.5) * pitch_y, -pitch_y / 2


def _draw_depth(figure: Any, axes: Any, result: Reconstruction, row: int, column: int) -> None:
    pitch_x, pitch_y = _pitch(result)
    left, right, low, high = _extent(result)
    shown = axes.imshow(
        _depth(result), cmap="viridis", extent=(left, right, low, high), interpolation="nearest"
    )
    figure.colorbar(shown, ax=axes, shrink=0.92, pad=0.015, label=f"depth ({_unit(result)}, 0 at rest)")
    if result.contact.any() and not result.contact.all():
        y, x = (np.arange(size) * pitch for size, pitch in zip(_depth(result).shape, (pitch_y, pitch_x)))
        axes.contour(x, y, result.contact, levels=[0.5], colors="white", linewidths=0.8, alpha=0.8)
    axes.axhline(row * pitch_y, color=ALONG_X, linewidth=1, alpha=0.9)
    axes.axvline(column * pitch_x, color=ALONG_Y, linewidth=1, alpha=0.9)
    _draw_scale_bar(axes, left, right, low, high, _unit(result))
    axes.set_title("depth, the contact outlined", fontsize=10, color=INK)
    axes.set_xlabel(f"x ({_unit(result)})")
    axes.set_ylabel(f"y ({_unit(result)})")


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


def _draw_profiles(axes: Any, result: Reconstruction, row: int, column: int) -> None:
    pitch_x, pitch_y = _pitch(result)
    along = (
        ("along x", ALONG_X, _depth(result)[row], (np.arange(_depth(result).shape[1]) - column) * pitch_x),
        (
            "along y",
            ALONG_Y,
            _depth(result)[:, column],
            (np.arange(_depth(result).shape[0]) - row) * pitch_y,
        ),
    )
    axes.axhline(0, color=FAINT, linewidth=0.8)
    for name, color, depth, place in along:
        axes.plot(place, depth, color=color, linewidth=1.5, label=name)
    axes.fill_between(along[0][3], along[0][2], 0, color=ALONG_X, alpha=0.1)
    axes.plot(0, _depth(result)[row, column], "o", color=INK, markersize=4)
    deepest = float(_depth(result)[row, column])
    axes.annotate(
        f"{deepest:.3f} {_unit(result)}",
        (0, deepest),
        (6, 4),
        textcoords="offset points",
        fontsize=9,
        color=INK,
    )
    axes.margins(x=0.01, y=0.12)
    _quiet(axes, "both")
    axes.legend(frameon=False, fontsize=9, loc="lower right", bbox_to_anchor=(1, 0.99), ncols=2)
    axes.set_title("profiles through the deepest point", fontsize=10, color=INK, loc="left")
    axes.set_xlabel(f"distance from it ({_unit(result)})")
    axes.set_ylabel(f"depth ({_unit(result)})")


def _round_length(length: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not longer."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(max(step for step in (1, 2, 5) if step * power <= length * (1 + 1e-9)) * power)


def _quiet(axes: Any, grid: str) -> None:
    axes.grid(axis=grid, color="#e6e6e6", linewidth=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
