"""Common parts of all pictures: an off-screen figure, its colors, its panels, and its file.

Needs matplotlib, the extra `plots`. Figures are drawn off screen; matplotlib's global state stays unchanged.
"""

from __future__ import annotations

from os import PathLike
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.errors import needed
from gelform.foundations.checks import check_image
from gelform.foundations.npz_files import written_file
from gelform.foundations.pictures import picture_bytes
from gelform.result import Reconstruction

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


def pixels_of(figure: Any) -> NDArray[np.uint8]:
    """The drawn figure as an RGB picture (h, w, 3)."""
    figure.canvas.draw()
    return np.asarray(figure.canvas.buffer_rgba(), dtype=np.uint8)[..., :3].copy()


def save_picture(path: str | PathLike[str], picture: ArrayLike, *, overwrite: bool = False) -> None:
    """Write an RGB picture (h, w, 3) uint8 as PNG, completely or not at all.

    Raises
    ------
    DataError
        The file exists and `overwrite` is False, or it cannot be written.
    """
    content = picture_bytes(check_image(picture, name="picture").astype(np.uint8))
    with written_file(path, overwrite=overwrite) as handle:
        handle.write(content)


def draw_map(axes: Any, values: ArrayLike, title: str, **style: Any) -> Any:
    """Show an image or a map under a title, pixel by pixel and without ticks; returns the object for a color bar.

    NaN, which means unknown, is hatched.
    """
    shown = axes.imshow(values, interpolation="nearest", **style)
    hatch_behind(axes)
    axes.set_title(title, fontsize=10, color=INK)
    axes.set_xticks([])
    axes.set_yticks([])
    return shown


def hatch_behind(axes: Any) -> None:
    """Hatch the axes' background, which shows where a map is NaN (unknown)."""
    axes.set_facecolor(GRID)
    axes.patch.set(hatch="///", edgecolor=FAINT, linewidth=0)


def style_profiles(axes: Any, title: str, unit: str) -> None:
    """The frame around depth profiles: zero line, faint grid, labels in the unit of both axes."""
    axes.axhline(0, color=FAINT, linewidth=0.8, zorder=1)
    axes.margins(x=0.01, y=0.12)
    axes.grid(color=GRID, linewidth=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_title(title, fontsize=10, color=INK, loc="left")
    axes.set_xlabel(f"distance from it ({unit})")
    axes.set_ylabel(f"depth ({unit})")


def known_depth(result: Reconstruction, depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """A depth of the result for drawing: NaN where it was filled without information."""
    return np.where(result.known, depth, np.float32(np.nan))


def in_words(depth: float) -> str:
    """A depth to the micrometer; a dash if it is unknown."""
    return "–" if np.isnan(depth) else f"{depth:.3f}"


def deepest_px(depth: NDArray[np.float32]) -> tuple[int, int]:
    """Row and column of the deepest point, ignoring single noisy pixels and NaN (unknown).

    If all are NaN, the first pixel.
    """
    unknown = np.isnan(depth)
    smooth = cv2.GaussianBlur(np.where(unknown, 0, depth), (0, 0), 1)
    smooth[unknown] = -np.inf
    row, column = np.unravel_index(int(np.argmax(smooth)), smooth.shape)
    return int(row), int(column)
