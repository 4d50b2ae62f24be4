"""Geometry of a pressed ball: its slopes, its center and radius from slopes, and a sphere through a depth map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # its parts load at first use
from numpy.typing import ArrayLike, NDArray

from gelform._native import Kernel
from gelform.foundations.checks import check_mm_per_px

_ball_center = Kernel(
    "ball_center",
    "f64[n,2] gradients, f64[n] x, f64[n] y, out f64[2] center, f64 radius, f64 scale, i64 rounds",
)
# Fraction of the radius: farther out the slopes of a ball are held constant; the same in native/result/metrics/center.c.
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
) -> NDArray[np.float64]:
    """Slopes `p = -u/sqrt(R^2 - u^2 - v^2)` of a ball, u and v its pixel distances from the center.

    Parameters
    ----------
    x_px, y_px : (...) pixel positions
    center_px : (x, y)
    radius_px : the ball's radius, px; or (x, y) if pixels are not square

    Returns
    -------
    gradients : (..., 2) float64; beyond 0.97 R the slope stays constant, because it grows without bound at R
    """
    rx, ry = np.broadcast_to(np.asarray(radius_px, dtype=np.float64), (2,))
    u = (np.asarray(x_px, dtype=np.float64) - center_px[0]) / rx
    v = (np.asarray(y_px, dtype=np.float64) - center_px[1]) / ry
    height = np.sqrt(np.maximum(1 - u * u - v * v, 1 - STEEPEST_FRACTION**2))
    return np.stack([-u / height, -v / height], axis=-1)


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
    """Center (x, y), px, of the ball of known radius with the slopes closest to gradients (N, 2).

    It uses Gauss-Newton on a pseudo-Huber loss; `scale` is the slope error beyond which a pixel counts less.
    """
    center = np.array(start_px, dtype=np.float64)
    slopes, x, y = (np.ascontiguousarray(values, dtype=np.float64) for values in (gradients, x_px, y_px))
    _ball_center(slopes, x, y, center, radius_px, scale, rounds)
    return float(center[0]), float(center[1])


def radius_from_gradients(gradients: NDArray[Any], x_px: NDArray[Any], y_px: NDArray[Any]) -> float:
    """Radius, px, of the ball with the slopes closest to gradients (N, 2) at pixel positions (N,); the center is free.

    The first two components of a ball's normals are `((x - cx)/R, (y - cy)/R)`. So 1/R is the slope of a line through them,
    fitted by least squares with Huber weights. The radius is infinite or negative if the slopes show no ball.
    """
    slopes = np.asarray(gradients, dtype=np.float64)
    normals = -slopes / np.sqrt(1 + np.sum(slopes**2, axis=1, keepdims=True))
    place = np.stack([x_px, y_px], axis=1).astype(np.float64)
    weight = np.ones(len(place))
    for _ in range(8):  # later rounds move the radius by less than 0.1 %
        away, turned = (v - np.average(v, axis=0, weights=weight) for v in (place, normals))
        curvature = np.sum(weight[:, None] * away * turned) / np.sum(weight[:, None] * away**2)
        error = np.linalg.norm(turned - curvature * away, axis=1)
        weight = np.minimum(1, 0.05 / np.maximum(error, 1e-12))  # about the usual error of a component
    return float(1 / curvature) if curvature else float("inf")


def center_jacobian(ball: NDArray[np.float64], radius_px: float | NDArray[np.float64]) -> NDArray[np.float64]:
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


@dataclass(frozen=True)
class SphereFit:
    """A sphere fitted to a depth map: center (x, y, z) and radius, mm."""

    center_mm: tuple[float, float, float]
    radius_mm: float


def fit_sphere(
    depth_mm: ArrayLike, region: NDArray[np.bool_], *, mm_per_px: float | Sequence[float], radius_mm: float
) -> SphereFit:
    """Sphere through a region of a depth map, by soft-l1 (20 um) least squares that starts from `radius_mm`."""
    hx, hy = check_mm_per_px(mm_per_px)
    rows, cols = np.nonzero(region)
    if rows.size < 10:
        raise ValueError(f"Expected at least 10 pixels to fit a sphere to, got {rows.size}.")
    z = np.asarray(depth_mm, dtype=np.float64)[region]
    x, y = cols * hx, rows * hy

    def distances(t: NDArray[Any]) -> NDArray[Any]:
        return np.sqrt((x - t[0]) ** 2 + (y - t[1]) ** 2 + (z - t[2]) ** 2) - t[3]

    start = [x.mean(), y.mean(), z.max() - radius_mm, radius_mm]
    fit = scipy.optimize.least_squares(distances, start, loss="soft_l1", f_scale=0.02)
    return SphereFit((fit.x[0], fit.x[1], fit.x[2]), float(abs(fit.x[3])))
