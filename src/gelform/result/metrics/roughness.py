"""Areal roughness of a surface by ISO 25178-2, without its form and without small and large scales."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from gelform.foundations.checks import check_choice, check_map, check_mask, check_positive

FORMS = {"none": 0, "plane": 1, "quadratic": 2}  # degree of the polynomial
ALPHA = np.sqrt(np.log(2) / np.pi)  # ISO 16610-61: a wave of the cut-off length keeps half its height
LEAST_PX = 100  # pixels, the smallest region whose roughness can be computed


@dataclass(frozen=True)
class Roughness:
    """Height parameters, and one hybrid one, of ISO 25178-2:2021.

    Attributes
    ----------
    Sa_um, Sq_um : arithmetic mean and root mean square of the heights, um
    Sz_um : highest peak to deepest pit, um
    Ssk, Sku : skewness and kurtosis of the heights; 0 and 3 for Gaussian ones
    Sdr_percent : excess of the surface's area over that of its projection, per cent
    form : the form that was removed: none, plane or quadratic
    s_filter_mm, l_filter_mm : cut-off lengths (nesting indices), mm; None: not filtered
    area_mm2 : the evaluated area, mm^2
    """

    Sa_um: float
    Sq_um: float
    Sz_um: float
    Ssk: float
    Sku: float
    Sdr_percent: float
    form: str
    s_filter_mm: float | None
    l_filter_mm: float | None
    area_mm2: float


def areal_roughness(
    depth_mm: ArrayLike,
    *,
    mm_per_px: float,
    mask: ArrayLike | None = None,
    form: str = "quadratic",
    s_filter_mm: float | str | None = "auto",
    l_filter_mm: float | None = 2.5,
) -> Roughness:
    """Roughness of a height map.

    The S-filter removes the small scales. Then the form, a polynomial fitted by least squares, is subtracted, and the
    L-filter removes the large scales (ISO 25178-3). Both filters are Gaussian (ISO 16610-61); at the end of the surface
    their weights cover the existing pixels.

    Parameters
    ----------
    depth_mm : (H, W), heights
    mm_per_px : > 0; pixels are square
    mask : (H, W) bool, the pixels that are evaluated and filtered; all by default
    form : "none", "plane" or "quadratic"
    s_filter_mm : cut-off of the S-filter, mm; "auto": 3 pixels; None: no filter
    l_filter_mm : cut-off of the L-filter, mm; None: no filter, and the result is that of an S-F surface

    Raises
    ------
    ValueError, TypeError
        NaN, another shape of the mask, fewer than 100 pixels, cut-offs that leave nothing between them.
    """
    depth = check_map(depth_mm, "depth_mm", dtype=np.float64)
    if depth.ndim != 2:
        raise ValueError(f"Expected depth_mm of shape (H, W), got {depth.shape}.")
    everywhere = np.ones(depth.shape, dtype=bool)
    inside = check_mask(everywhere if mask is None else mask, shape=depth.shape, may_be_empty=True)
    if np.count_nonzero(inside) < LEAST_PX:
        raise ValueError(f"Expected at least {LEAST_PX} pixels to evaluate, got {np.count_nonzero(inside)}.")
    check_choice(form, FORMS, "a form")
    pitch = check_positive(mm_per_px, "mm_per_px")
    small, large = 3 * pitch if s_filter_mm == "auto" else s_filter_mm, l_filter_mm
    if small is not None:
        small = check_positive(float(small), "s_filter_mm")
        depth = gaussian_areal_filter(depth, small / pitch, inside)
    depth = depth - _form(depth, inside, FORMS[form])
    if large is not None:
        if check_positive(large, "l_filter_mm") <= (small or 0):
            raise ValueError(
                f"Expected the L-filter above the S-filter's {small:.3f} mm, got {large:.3f} mm."
            )
        depth = depth - gaussian_areal_filter(depth, large / pitch, inside)
    heights = 1e3 * (depth[inside] - depth[inside].mean())
    root_mean_square = float(np.sqrt(np.mean(heights**2)))
    scaled = heights / (root_mean_square or 1.0)
    return Roughness(
        Sa_um=float(np.mean(np.abs(heights))),
        Sq_um=root_mean_square,
        Sz_um=float(np.ptp(heights)),
        Ssk=float(np.mean(scaled**3)),
        Sku=float(np.mean(scaled**4)),
        Sdr_percent=_developed_area(depth, inside, pitch),
        form=form,
        s_filter_mm=small,
        l_filter_mm=large,
        area_mm2=float(np.count_nonzero(inside) * pitch**2),
    )


def gaussian_areal_filter(
    heights: NDArray[Any], cutoff_px: float, inside: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """The large scales of heights (H, W): their mean with the weights of ISO 16610-61 around each pixel.

    The weights are exp(-pi r^2 / (alpha cutoff)^2) with alpha = sqrt(ln 2 / pi), over the pixels `inside`, normalized to 1.
    A wave of the cut-off length keeps half of its height. Pixels outside are 0. The Gaussian ends at 4e-6 of its peak.
    """
    sigma = ALPHA * cutoff_px / np.sqrt(2 * np.pi)
    blurred, weight = (
        ndimage.gaussian_filter(values, sigma, mode="constant", truncate=5)
        for values in (np.where(inside, heights, 0.0), inside.astype(np.float64))
    )
    return np.divide(blurred, weight, out=np.zeros_like(blurred), where=inside)


def _developed_area(depth: NDArray[Any], inside: NDArray[np.bool_], pitch: float) -> float:
    """Sdr, per cent: the mean of sqrt(1 + slope^2) - 1 over cells of four pixels inside."""
    a, b, c, d = depth[:-1, :-1], depth[:-1, 1:], depth[1:, :-1], depth[1:, 1:]
    slope_x, slope_y = (b - a + d - c) / (2 * pitch), (c - a + d - b) / (2 * pitch)
    whole = inside[:-1, :-1] & inside[:-1, 1:] & inside[1:, :-1] & inside[1:, 1:]
    excess = (np.sqrt(1 + slope_x**2 + slope_y**2) - 1)[whole]
    return float(100 * np.mean(excess)) if excess.size else 0.0


def _form(depth: NDArray[Any], inside: NDArray[np.bool_], degree: int) -> NDArray[np.float64]:
    """The polynomial (H, W), fitted by least squares to the pixels inside."""
    height, width = depth.shape
    y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    terms = np.stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)], axis=-1)
    weights, *_ = np.linalg.lstsq(terms[inside], depth[inside], rcond=None)
    return np.asarray(terms @ weights)
