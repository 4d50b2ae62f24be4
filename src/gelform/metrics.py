"""How far a result is from the truth: angles in degrees, depth in mm, the sphere that a press should be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from gelform.checks import check_mm_per_px

STEEPEST_FRACTION = 0.97


def ball_gradients(
    x_px: ArrayLike, y_px: ArrayLike, center_px: tuple[float, float], radius_px: float | tuple[float, float]
) -> NDArray[np.float64]:
    """Slopes `p = -u/sqrt(R^2 - u^2 - v^2)` of a ball, u and v its pixel distances from the centre.

    Parameters
    ----------
    x_px, y_px : (...) pixel positions
    center_px : (x, y)
    radius_px : the ball's radius, px; or (x, y) where pixels are not square

    Returns
    -------
    gradients : (..., 2) float64; beyond 0.97 R the slope is held, since it grows without bound at R
    """
    rx, ry = np.broadcast_to(np.asarray(radius_px, dtype=np.float64), (2,))
    u = (np.asarray(x_px, dtype=np.float64) - center_px[0]) / rx
    v = (np.asarray(y_px, dtype=np.float64) - center_px[1]) / ry
    height = np.sqrt(np.maximum(1 - u * u - v * v, 1 - STEEPEST_FRACTION**2))
    return np.stack([-u / height, -v / height], axis=-1)


def angle_deg(gradients: ArrayLike, reference: ArrayLike) -> NDArray[np.float64]:
    """Angle between the normals of two sets of gradients (..., 2), degrees."""
    a, b = np.asarray(gradients, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    difference = a - b
    cross = np.sqrt((a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]) ** 2 + np.sum(difference**2, axis=-1))
    return np.degrees(np.arctan2(cross, 1 + np.sum(a * b, axis=-1)))


@dataclass(frozen=True)
class SphereFit:
    """A sphere fitted to a depth map: centre (x, y, z) and radius, mm."""

    center_mm: tuple[float, float, float]
    radius_mm: float


def fit_sphere(
    depth_mm: ArrayLike, region: NDArray[np.bool_], *, mm_per_px: float | Sequence[float], radius_mm: float
) -> SphereFit:
    """Sphere through a region of a depth map by soft-l1 (20 um) least squares; starts from `radius_mm`."""
    hx, hy = check_mm_per_px(mm_per_px)
    rows, cols = np.nonzero(region)
    if rows.size < 10:
        raise ValueError(f"Expected at least 10 pixels to fit a sphere to, got {rows.size}.")
    z = np.asarray(depth_mm, dtype=np.float64)[region]
    x, y = cols * hx, rows * hy

    def distances(t: NDArray[Any]) -> NDArray[Any]:
        return np.sqrt((x - t[0]) ** 2 + (y - t[1]) ** 2 + (z - t[2]) ** 2) - t[3]

    start = [x.mean(), y.mean(), z.max() - radius_mm, radius_mm]
    fit = least_squares(distances, start, loss="soft_l1", f_scale=0.02)
    return SphereFit((fit.x[0], fit.x[1], fit.x[2]), float(abs(fit.x[3])))


def ball_center(
    gradients: NDArray[Any],
    x_px: NDArray[Any],
    y_px: NDArray[Any],
    start_px: tuple[float, float],
    radius_px: float,
    *,
    scale: float = 0.05,
    rounds: int = 30,
) -> tuple[float, float]:
    """Centre (x, y) in px of the ball of known radius whose slopes agree best with gradients (N, 2).

    Gauss-Newton on a pseudo-Huber loss; `scale` is the slope error beyond which a pixel counts less.
    """
    center = np.array(start_px, dtype=np.float64)
    for _ in range(rounds):
        ball = ball_gradients(x_px, y_px, (center[0], center[1]), radius_px)
        residual = gradients - ball
        weight = np.repeat(1 / np.sqrt(1 + np.sum(residual**2, axis=-1) / scale**2), 2)
        jacobian = _center_jacobian(ball, radius_px).reshape(-1, 2)
        weighted = jacobian * weight[:, None]
        move = np.linalg.solve(weighted.T @ jacobian + 1e-12 * np.eye(2), weighted.T @ residual.ravel())
        center += np.clip(move, -0.2 * radius_px, 0.2 * radius_px)
        if np.hypot(*move) < 1e-3:
            break
    return float(center[0]), float(center[1])


def _center_jacobian(ball: NDArray[np.float64], radius_px: float) -> NDArray[np.float64]:
    """Derivative (N, 2, 2) of a ball's slopes by its centre: `(1 + p^2, p q; p q, 1 + q^2) sqrt(1 + p^2 + q^2)/R`."""
    p, q = ball[:, 0], ball[:, 1]
    length = np.sqrt(1 + p * p + q * q) / radius_px
    jacobian = np.empty((len(ball), 2, 2))
    jacobian[:, 0, 0] = (1 + p * p) * length
    jacobian[:, 1, 1] = (1 + q * q) * length
    jacobian[:, 0, 1] = jacobian[:, 1, 0] = p * q * length
    return jacobian


@dataclass(frozen=True)
class PressErrors:
    """Errors of one reconstructed ball press against the ball; no scale is fitted.

    Attributes
    ----------
    normal_deg : mean angle to the ball's normals inside the contact, 3 px (at 240 rows) inside its rim
    normal_free_deg : the same with a free centre: the ball of known radius fitted to the gradients
    cap_um : standard deviation of depth minus the ball's cap there (offset free, scale not)
    cap_free_um : the same with a free centre, fitted to the slopes of the depth map
    radius_percent : (R_fit - R)/R of a sphere fitted to the depth, signed
    off_contact_um : RMS of depth beyond 2.5 contact radii; NaN where the frame ends before
    """

    normal_deg: float
    normal_free_deg: float
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
) -> PressErrors:
    """Errors of a reconstructed press of a ball.

    Parameters
    ----------
    depth_mm : (H, W)
    gradients : (H, W, 2)
    circle_px : contact circle (centre x, centre y, radius), px
    ball_radius_mm, mm_per_px : known, never fitted
    """
    height, width = depth_mm.shape
    y, x = np.mgrid[:height, :width]
    cx, cy, contact = circle_px
    ball_px = ball_radius_mm / mm_per_px
    inset = 3 * min(height, width) / 240
    rho = np.hypot(x - cx, y - cy)
    reach = min(contact - inset, STEEPEST_FRACTION * ball_px)
    inside = rho < reach
    if np.count_nonzero(inside) < 10:
        raise ValueError(f"Expected a contact of at least 10 px inside the frame, got a circle {circle_px}.")
    slope_y, slope_x = np.gradient(np.asarray(depth_mm, dtype=np.float64), mm_per_px)
    surface = np.stack([slope_x, slope_y], axis=-1)
    free = [ball_center(g[inside], x[inside], y[inside], (cx, cy), ball_px) for g in (gradients, surface)]
    inside_free = [np.hypot(x - c[0], y - c[1]) < reach for c in free]

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
        cap_um=cap((cx, cy), inside),
        cap_free_um=cap(free[1], inside_free[1]),
        radius_percent=100 * (sphere.radius_mm - ball_radius_mm) / ball_radius_mm,
        off_contact_um=off,
    )
