"""Errors of a result against the truth: angles between normals in degrees, depth in um, radii in per cent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.foundations.checks import check_gradients, check_map, check_numbers, check_positive, check_within
from gelform.result.metrics.ball import (
    STEEPEST_FRACTION,
    ball_center,
    ball_gradients,
    fit_sphere,
    followed_radius,
)


def angle_deg(gradients: ArrayLike, reference: ArrayLike) -> NDArray[np.float64]:
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
    true_gradients: NDArray[np.float64]
    errors: NDArray[np.float64]
    normal_deg: float


def score_slopes(
    gradients: NDArray[Any],
    x_px: NDArray[Any],
    y_px: NDArray[Any],
    start_px: tuple[float, float],
    ball_radius_px: float,
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
    depth_mm: NDArray[Any],
    gradients: NDArray[Any],
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
    inset = 3 * min(height, width) / 240
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

    def normal(center: tuple[float, float], region: NDArray[np.bool_]) -> float:
        truth = ball_gradients(x[region], y[region], center, ball_px)
        return float(angle_deg(gradients[region], truth).mean())

    def cap(center: tuple[float, float], region: NDArray[np.bool_]) -> float:
        square = (x[region] - center[0]) ** 2 + (y[region] - center[1]) ** 2
        ball = mm_per_px * np.sqrt(np.maximum(ball_px**2 - square, 0))
        return float(1e3 * np.std(depth_mm[region] - ball))

    sphere = fit_sphere(depth_mm, inside, mm_per_px=mm_per_px, radius_mm=ball_radius_mm)
    far = rho > 2.5 * contact
    off = (
        float(1e3 * np.sqrt(np.mean(np.square(depth_mm[far], dtype=np.float64))))
        if far.any()
        else float("nan")
    )
    return PressErrors(
        normal_deg=normal((cx, cy), inside),
        normal_free_deg=normal(free[0], inside_free[0]),
        normal_rim_deg=normal(free[0], from_free[0] < visible),
        cap_um=cap((cx, cy), inside),
        cap_free_um=cap(free[1], inside_free[1]),
        radius_percent=100 * (sphere.radius_mm - ball_radius_mm) / ball_radius_mm,
        off_contact_um=off,
    )
