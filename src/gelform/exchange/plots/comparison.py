"""The comparison of two calibrations on one image: figures, and a picture of both side by side."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.errors import DataError
from gelform.exchange.plots.canvas import (
    BLUE,
    INK,
    ORANGE,
    canvas,
    deepest_px,
    draw_map,
    in_words,
    known_depth,
    pixels_of,
    style_profiles,
)
from gelform.foundations.checks import check_image, check_mm_per_px
from gelform.result import Reconstruction
from gelform.result.maps import MAPS
from gelform.result.metrics import angle_deg


@dataclass(frozen=True)
class Comparison:
    """Two depth maps in one unit, and their differences.

    Attributes
    ----------
    unit : "mm", or "px" (widths of a pixel) if one of the two has no scale
    depths : the two maps (H, W) float32, in that unit
    peak_a, peak_b : their deepest points
    difference_rms : RMS of B minus A over the frame
    angle_deg : mean angle between their normals, inside the contact of either; None if neither has one
    curl_rms_a, curl_rms_b : deviation of the slopes from those of a surface, slope per pixel
    """

    unit: str
    depths: tuple[NDArray[np.float32], NDArray[np.float32]]
    peak_a: float
    peak_b: float
    difference_rms: float
    angle_deg: float | None
    curl_rms_a: float
    curl_rms_b: float

    def figures(self) -> dict[str, Any]:
        """All but the maps, for JSON."""
        names = ("peak_a", "peak_b", "difference_rms", "angle_deg", "curl_rms_a", "curl_rms_b")
        return {"unit": self.unit, **{name: getattr(self, name) for name in names}}


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
    peaks = (float(d[one.known].max()) if one.known.any() else float("nan") for d, one in zip(depths, (a, b)))
    peak_a, peak_b = peaks
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
) -> NDArray[np.uint8]:
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
    GelformError
        matplotlib is not installed.
    """
    compared = compare_results(a, b)
    shown = check_image(image, shape=a.shape).astype(np.uint8)
    limits = {"vmin": np.min(compared.depths), "vmax": np.max(compared.depths)}
    far = max(float(np.abs(np.subtract(*compared.depths)).max()), 1e-6)
    first, second = depths = known_depth(a, compared.depths[0]), known_depth(b, compared.depths[1])
    compared = replace(compared, depths=depths)
    row, column = deepest_px(first)
    tall = 3.0 * a.shape[0] / a.shape[1]
    figure = canvas(14.0, tall + 4.0)
    figure.suptitle(_headline(compared), x=0.012, ha="left", fontsize=11, color=INK)
    top, bottom = figure.subfigures(2, 1, height_ratios=[tall + 0.5, 3.0])
    axes = top.subplots(1, 4)
    draw_map(axes[0], shown, "image")
    for panel, depth, title in zip(axes[1:3], depths, (f"A: {names[0]}", f"B: {names[1]}")):
        map_shown = draw_map(panel, depth, title, cmap=MAPS["depth_mm"].colors, **limits)
        panel.axhline(row, color="white", linewidth=0.8, alpha=0.7)
    top.colorbar(map_shown, ax=list(axes[1:3]), shrink=0.9, pad=0.01, label=f"depth ({compared.unit})")
    difference = draw_map(axes[3], second - first, "B minus A", cmap="RdBu_r", vmin=-far, vmax=far)
    top.colorbar(difference, ax=axes[3], shrink=0.9, pad=0.01, label=f"{compared.unit}")
    _draw_profiles(bottom.subplots(1, 1), compared, a, row, column, names)
    return pixels_of(figure)


def _headline(compared: Comparison) -> str:
    unit = compared.unit
    deepest_a, deepest_b = (in_words(np.fmax.reduce(depth, axis=None)) for depth in compared.depths)
    angle = (
        "no contact"
        if compared.angle_deg is None
        else f"normals {compared.angle_deg:.1f} deg apart in contact"
    )
    return (
        f"deepest {deepest_a} and {deepest_b} {unit}   |   difference "
        f"{compared.difference_rms:.3f} {unit} RMS   |   {angle}   |   curl {compared.curl_rms_a:.3f} and "
        f"{compared.curl_rms_b:.3f}"
    )


def _draw_profiles(
    axes: Any, compared: Comparison, a: Reconstruction, row: int, column: int, names: tuple[str, str]
) -> None:
    pitch = check_mm_per_px(a.mm_per_px)[0] if compared.unit == "mm" else 1.0
    place = (np.arange(a.shape[1]) - column) * pitch
    style_profiles(axes, "profiles along x through A's deepest point", compared.unit)
    for depth, color, label in zip(compared.depths, (ORANGE, BLUE), (f"A: {names[0]}", f"B: {names[1]}")):
        axes.plot(place, depth[row], color=color, linewidth=1.5, label=label)
    axes.legend(frameon=False, fontsize=9)
