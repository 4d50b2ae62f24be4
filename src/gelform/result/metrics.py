"""Measures of surfaces: a pressed ball, errors of a result against the truth, and roughness."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy  # its parts load at first use
from numpy.typing import ArrayLike
from scipy import ndimage

from gelform._native import Kernel
from gelform.arrays import Array, Mask, Numbers
from gelform.foundations.checks import (
    check_choice,
    check_gradients,
    check_map,
    check_mask,
    check_mm_per_px,
    check_numbers,
    check_positive,
    check_within,
)
from gelform.image.view import scale_of

__all__ = [  # as the reference of the site lists them
    "FORMS", "PressErrors", "Roughness", "SlopeScore", "angle_deg", "areal_roughness", "gaussian_areal_filter",
    "press_errors", "score_slopes",
]  # fmt: skip

_ball_center = Kernel(
    "ball_center",
    "f64[n,2] gradients, f64[n] x, f64[n] y, out f64[2] center, f64 radius, f64 scale, f64 held, i64 rounds",
)
OFF_CONTACT = 2.5  # contact radii, beyond which the gel is at rest
# Fraction of the radius: farther out the slopes of a ball are held constant.
STEEPEST_FRACTION = 0.97


def followed_radius(contact_radius_px: float, ball_radius_px: float) -> float:
    """Radius, px, up to which the gel of a press follows the ball.

    It is the radius of the visible circle, unless that is as wide as the ball or wider. In that case the gel leaves the
    ball inside the circle, and certainly follows it up to 0.75 of the ball's radius.
    """
    if contact_radius_px < STEEPEST_FRACTION * ball_radius_px:
        return contact_radius_px
    return 0.75 * ball_radius_px  # 0.8 of it has slopes up to 0.75


def ball_gradients(
    x_px: ArrayLike, y_px: ArrayLike, center_px: tuple[float, float], radius_px: float | tuple[float, float]
) -> Numbers:
    """Slopes `p = -u/sqrt(R^2 - u^2 - v^2)` (..., 2) of a ball, u and v its pixel distances from the center.

    Beyond 0.97 R the slope stays constant, because it grows without bound at R. The radius R is one, or (x, y) if pixels are
    not square.
    """
    rx, ry = np.broadcast_to(np.asarray(radius_px, dtype=np.float64), (2,))
    u = (np.asarray(x_px, dtype=np.float64) - center_px[0]) / rx
    v = (np.asarray(y_px, dtype=np.float64) - center_px[1]) / ry
    height = np.sqrt(np.maximum(1 - u * u - v * v, 1 - STEEPEST_FRACTION**2))
    return np.stack([-u / height, -v / height], axis=-1)


def ball_center(
    gradients: Array,
    x_px: Array,
    y_px: Array,
    start_px: tuple[float, float],
    radius_px: float,
    rounds: int = 30,
) -> tuple[float, float]:
    """Center (x, y), px, of the ball of known radius with the slopes closest to gradients (N, 2).

    It uses Gauss-Newton on a pseudo-Huber loss, where a pixel whose slope is off by more than 0.05 counts less.
    """
    center = np.array(start_px, dtype=np.float64)
    slopes, x, y = (np.ascontiguousarray(values, dtype=np.float64) for values in (gradients, x_px, y_px))
    _ball_center(slopes, x, y, center, radius_px, 0.05, STEEPEST_FRACTION, rounds)
    return float(center[0]), float(center[1])


def center_jacobian(ball: Numbers, radius_px: float | Numbers) -> Numbers:
    """Derivative (N, 2, 2) of a ball's slopes by its center: `(1 + p^2, p q; p q, 1 + q^2) sqrt(1 + p^2 + q^2)/R`.

    R is one radius, or one for each pixel (N,).
    """
    p, q = ball[:, 0], ball[:, 1]
    length = np.sqrt(1 + p * p + q * q) / radius_px
    jacobian = np.empty((len(ball), 2, 2))
    jacobian[:, 0, 0] = (1 + p * p) * length
    jacobian[:, 1, 1] = (1 + q * q) * length
    jacobian[:, 0, 1] = jacobian[:, 1, 0] = p * q * length
    return jacobian


def fit_sphere(
    depth_mm: ArrayLike, region: Mask, *, mm_per_px: float | Sequence[float], radius_mm: float
) -> tuple[Numbers, float]:
    """Center (3,) and radius, mm, of the sphere through a region of a depth map.

    The fit is soft-l1 (20 um) least squares from `radius_mm` on. ValueError: the region has fewer than 10 pixels.
    """
    hx, hy = check_mm_per_px(mm_per_px)
    rows, cols = np.nonzero(region)
    if rows.size < 10:
        raise ValueError(f"Expected at least 10 pixels to fit a sphere to, got {rows.size}.")
    z = np.asarray(depth_mm, dtype=np.float64)[region]
    x, y = cols * hx, rows * hy

    def distances(t: Array) -> Array:
        return np.sqrt((x - t[0]) ** 2 + (y - t[1]) ** 2 + (z - t[2]) ** 2) - t[3]

    start = [x.mean(), y.mean(), z.max() - radius_mm, radius_mm]
    *center, radius = scipy.optimize.least_squares(distances, start, loss="soft_l1", f_scale=0.02).x
    return np.array(center), float(abs(radius))


def angle_deg(gradients: ArrayLike, reference: ArrayLike) -> Numbers:
    """Angle between the normals of two sets of gradients (..., 2), degrees."""
    a, b = np.asarray(gradients, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    difference = a - b
    cross = np.sqrt((a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]) ** 2 + np.sum(difference**2, axis=-1))
    return np.degrees(np.arctan2(cross, 1 + np.sum(a * b, axis=-1)))


@dataclass(frozen=True)
class SlopeScore:
    """Errors of the slopes of a contact against those of the ball that pressed it.

    Attributes
    ----------
    center_px : (x, y) of the ball, fitted to the slopes, because the center of a contact circle is off by a pixel
    true_gradients : (N, 2) slopes of the ball of known radius at that center
    errors : (N, 2) slopes minus true slopes
    normal_deg : mean angle to the ball's normals, degrees
    """

    center_px: tuple[float, float]
    true_gradients: Numbers
    errors: Numbers
    normal_deg: float


def score_slopes(
    gradients: Array, x_px: Array, y_px: Array, start_px: tuple[float, float], ball_radius_px: float
) -> SlopeScore:
    """Compare slopes (N, 2) at pixels x_px, y_px (N,) of one contact with a ball of known radius.

    The search for the ball's center begins at `start_px`, the center of the contact circle.
    """
    center = ball_center(gradients, x_px, y_px, start_px, ball_radius_px)
    truth = ball_gradients(x_px, y_px, center, ball_radius_px)
    return SlopeScore(center, truth, gradients - truth, float(angle_deg(gradients, truth).mean()))


@dataclass(frozen=True)
class PressErrors:
    """Errors of one reconstructed press against the ball; no scale is fitted.

    They cover the pixels inside the contact edge, where the gel follows the ball, and at least 3 px (at 240 rows) inside
    the visible rim. If the visible circle is as wide as the ball, the contact ends at `followed_radius`.

    Attributes
    ----------
    normal_deg : mean angle to the ball's normals, degrees
    normal_free_deg : the same with a free center: the ball of known radius is fitted to the gradients
    normal_rim_deg : the same up to 3 px inside the visible rim, where the gel has already left the ball
    cap_um : standard deviation of depth minus the ball's cap (offset free, scale not), um
    cap_free_um : the same with a free center, fitted to the slopes of the depth map
    radius_percent : (R_fit - R)/R of a sphere fitted to the depth, signed
    off_contact_um : RMS of depth beyond 2.5 radii of the visible circle, um; NaN if the frame ends before
    """

    normal_deg: float
    normal_free_deg: float
    normal_rim_deg: float
    cap_um: float
    cap_free_um: float
    radius_percent: float
    off_contact_um: float


def press_errors(
    depth_mm: Array,
    gradients: Array,
    *,
    circle_px: tuple[float, float, float],
    ball_radius_mm: float,
    mm_per_px: float,
    contact_radius_ratio: float = 1.0,
) -> PressErrors:
    """Errors of a reconstructed press of a ball.

    Parameters
    ----------
    depth_mm : (H, W)
    gradients : (H, W, 2)
    circle_px : contact circle (center x, center y, radius), px
    ball_radius_mm, mm_per_px : known, never fitted
    contact_radius_ratio : radius of the contact edge over that of the visible circle, 0-1

    Raises
    ------
    ValueError
        Fewer than 10 pixels of the contact lie inside the frame.
    """
    return press_fit(depth_mm, gradients, circle_px, ball_radius_mm, mm_per_px, contact_radius_ratio).errors


class PressFit(NamedTuple):
    """Errors of a reconstructed press, and the centers (x, y), px, of its ball that they were measured about."""

    errors: PressErrors
    reach_px: float  # up to which slopes are judged: 3 px (at 240 rows) inside the visible rim
    center_px: tuple[float, float]  # fitted to the gradients inside the contact edge
    surface_center_px: tuple[float, float]  # fitted to the slopes of the depth map there


def press_fit(
    depth_mm: Array,
    gradients: Array,
    circle_px: tuple[float, float, float],
    ball_radius_mm: float,
    mm_per_px: float,
    contact_radius_ratio: float,
) -> PressFit:
    """`press_errors`, and where the ball is."""
    depth_mm = check_map(depth_mm, "depth_mm")
    if depth_mm.ndim != 2:
        raise ValueError(f"Expected depth_mm of shape (H, W), got {depth_mm.shape}.")
    height, width = depth_mm.shape
    gradients = check_gradients(gradients, shape=(height, width))
    if gradients.ndim != 3:
        raise ValueError(f"Expected gradients of one frame, ({height}, {width}, 2), got {gradients.shape}.")
    y, x = np.mgrid[:height, :width]
    cx, cy, contact = check_numbers(circle_px, "circle_px", 3)
    mm_per_px = check_positive(mm_per_px, "mm_per_px")
    ball_px = check_within(ball_radius_mm, "ball_radius_mm", 1e-3, 1e4) / mm_per_px
    inset = 3 * scale_of((height, width))
    rho = np.hypot(x - cx, y - cy)
    followed = followed_radius(contact, ball_px)
    visible = min(followed - inset, STEEPEST_FRACTION * ball_px)
    reach = min(check_within(contact_radius_ratio, "contact_radius_ratio", 1e-3, 1) * followed, visible)
    inside = rho < reach
    if np.count_nonzero(inside) < 10:
        raise ValueError(f"Expected a contact of at least 10 px inside the frame, got a circle {circle_px}.")
    slope_y, slope_x = np.gradient(np.asarray(depth_mm, dtype=np.float64), mm_per_px)
    surface = np.stack([slope_x, slope_y], axis=-1)
    free = [ball_center(g[inside], x[inside], y[inside], (cx, cy), ball_px) for g in (gradients, surface)]
    from_free = [np.hypot(x - c[0], y - c[1]) for c in free]
    inside_free = [distance < reach for distance in from_free]

    def normal(center: tuple[float, float], region: Mask) -> float:
        truth = ball_gradients(x[region], y[region], center, ball_px)
        return float(angle_deg(gradients[region], truth).mean())

    def cap(center: tuple[float, float], region: Mask) -> float:
        square = (x[region] - center[0]) ** 2 + (y[region] - center[1]) ** 2
        ball = mm_per_px * np.sqrt(np.maximum(ball_px**2 - square, 0))
        return float(1e3 * np.std(depth_mm[region] - ball))

    _, fitted_mm = fit_sphere(depth_mm, inside, mm_per_px=mm_per_px, radius_mm=ball_radius_mm)
    far = rho > OFF_CONTACT * contact
    off = 1e3 * np.sqrt(np.mean(np.square(depth_mm[far], dtype=np.float64))) if far.any() else np.nan
    errors = PressErrors(
        normal_deg=normal((cx, cy), inside),
        normal_free_deg=normal(free[0], inside_free[0]),
        normal_rim_deg=normal(free[0], from_free[0] < visible),
        cap_um=cap((cx, cy), inside),
        cap_free_um=cap(free[1], inside_free[1]),
        radius_percent=100 * (fitted_mm - ball_radius_mm) / ball_radius_mm,
        off_contact_um=float(off),
    )
    return PressFit(errors, visible, *free)


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


def gaussian_areal_filter(heights: Array, cutoff_px: float, inside: Mask) -> Numbers:
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


def _developed_area(depth: Array, inside: Mask, pitch: float) -> float:
    """Sdr, per cent: the mean of sqrt(1 + slope^2) - 1 over cells of four pixels inside."""
    a, b, c, d = depth[:-1, :-1], depth[:-1, 1:], depth[1:, :-1], depth[1:, 1:]
    slope_x, slope_y = (b - a + d - c) / (2 * pitch), (c - a + d - b) / (2 * pitch)
    whole = inside[:-1, :-1] & inside[:-1, 1:] & inside[1:, :-1] & inside[1:, 1:]
    excess = (np.sqrt(1 + slope_x**2 + slope_y**2) - 1)[whole]
    return float(100 * np.mean(excess)) if excess.size else 0.0


def _form(depth: Array, inside: Mask, degree: int) -> Numbers:
    """The polynomial (H, W), fitted by least squares to the pixels inside."""
    height, width = depth.shape
    y, x = np.meshgrid(np.linspace(-1, 1, height), np.linspace(-1, 1, width), indexing="ij")
    terms = np.stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)], axis=-1)
    weights, *_ = np.linalg.lstsq(terms[inside], depth[inside], rcond=None)
    return np.asarray(terms @ weights)
