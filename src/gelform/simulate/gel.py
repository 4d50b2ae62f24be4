"""The gel: its surface follows the indenter where it touches and relaxes beside it.

The surface is a membrane under tension on an elastic bed, held up by the indenter: of all surfaces u that do
not enter the indenter's face g, the one of least energy

    min_u  integral |grad u|^2 + (u/L)^2      subject to  u >= g.

So u = g in the contact, L^2 laplace(u) = u beside it (depth falls off over the relaxation length L), and the
slope is continuous at the rim: the gel leaves the indenter a little inside the circle where the undeformed
plane would cut it.

The obstacle problem: Kinderlehrer and Stampacchia, An Introduction to Variational Inequalities, 1980; the
elastic bed: Kerr, Elastic and viscoelastic foundation models, J. Appl. Mech. 31, 1964.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import k0e, k1e

from gelform.simulate.indenters import Ball, Indenter
from gelform.simulate.membrane import membrane_over


@dataclass(frozen=True)
class Surface:
    """A gel surface on a regular grid.

    Attributes
    ----------
    x_mm, y_mm : (1, W) and (H, 1), coordinates of the samples
    depth_mm : (H, W) float64, >= 0, positive where pressed
    gradients : (H, W, 2) float64, mm/mm
    contact : (H, W) bool, where gel and indenter touch
    """

    x_mm: NDArray[np.float64]
    y_mm: NDArray[np.float64]
    depth_mm: NDArray[np.float64]
    gradients: NDArray[np.float64]
    contact: NDArray[np.bool_]


def flat_surface(x_mm: NDArray[np.float64], y_mm: NDArray[np.float64]) -> Surface:
    """The untouched gel."""
    shape = (y_mm.size, x_mm.size)
    return Surface(x_mm, y_mm, np.zeros(shape), np.zeros((*shape, 2)), np.zeros(shape, dtype=bool))


def surface_from_ball(
    ball: Ball,
    x_mm: NDArray[np.float64],
    y_mm: NDArray[np.float64],
    *,
    center_mm: tuple[float, float],
    depth_mm: float,
    relaxation_mm: float,
) -> Surface:
    """The pressed gel under a ball, in closed form: a cap, then the Bessel function K0 of r/L."""
    a = contact_radius_of_ball(ball.radius_mm, depth_mm, relaxation_mm)
    dx, dy = x_mm - center_mm[0], y_mm - center_mm[1]
    r = np.hypot(dx, dy)
    touching = r <= a
    cosine = np.sqrt(ball.radius_mm**2 - np.minimum(r, a) ** 2)
    depth = depth_mm - ball.radius_mm + cosine
    slope_over_r = -1 / cosine
    tail_r = r[~touching]
    tail = depth[~touching] * np.exp((a - tail_r) / relaxation_mm) / k0e(a / relaxation_mm)
    depth[~touching] = tail * k0e(tail_r / relaxation_mm)
    slope_over_r[~touching] = -tail * k1e(tail_r / relaxation_mm) / (relaxation_mm * tail_r)
    gradients = slope_over_r[..., None] * np.stack(np.broadcast_arrays(dx, dy), axis=-1)
    return Surface(x_mm, y_mm, depth, gradients, touching)


def contact_radius_of_ball(radius_mm: float, depth_mm: float, relaxation_mm: float) -> float:
    """Radius in mm of the circle in which the gel touches a ball pressed `depth_mm` deep."""

    def mismatch(
        a: float,
    ) -> float:  # slope of the tail beside the rim less that of the ball, times the cosine
        cosine = np.sqrt(radius_mm**2 - a**2)
        return float((depth_mm - radius_mm + cosine) * cosine - a * _tail_mm(a, relaxation_mm))

    return float(brentq(mismatch, 1e-9 * radius_mm, radius_mm, xtol=1e-12 * radius_mm))


def depth_of_ball(radius_mm: float, rim_slope: float, relaxation_mm: float) -> float:
    """How deep a ball must be pressed, in mm, for its slope at the contact's rim to be `rim_slope`."""
    cosine = radius_mm / np.hypot(1, rim_slope)
    tail = rim_slope * _tail_mm(rim_slope * cosine, relaxation_mm)
    return float(radius_mm - cosine + tail)


def surface_from_indenter(
    indenter: Indenter,
    x_mm: NDArray[np.float64],
    y_mm: NDArray[np.float64],
    *,
    center_mm: tuple[float, float],
    depth_mm: float,
    relaxation_mm: float,
) -> Surface:
    """The pressed gel under any indenter: the membrane solved on the grid, its slopes by central differences.

    The grid must reach some relaxation lengths beyond what is looked at: no force acts across its border.
    """
    obstacle = depth_mm + indenter.face_mm(x_mm - center_mm[0], y_mm - center_mm[1])
    obstacle = np.maximum(obstacle, 0)
    pitch = float(x_mm[0, 1] - x_mm[0, 0])
    depth = membrane_over(obstacle, relaxation_px=relaxation_mm / pitch)
    slope_y, slope_x = np.gradient(depth, pitch, edge_order=2)
    touching = (obstacle > 0) & (depth <= obstacle)
    return Surface(x_mm, y_mm, depth, np.stack([slope_x, slope_y], axis=-1), touching)


def cropped(surface: Surface, margin: int) -> Surface:
    """The surface without `margin` samples on each side."""
    inner = slice(margin, -margin or None)
    return Surface(
        surface.x_mm[:, inner],
        surface.y_mm[inner],
        surface.depth_mm[inner, inner],
        surface.gradients[inner, inner],
        surface.contact[inner, inner],
    )


def _tail_mm(a: float, relaxation_mm: float) -> Any:
    """Depth over slope of the relaxing gel at radius a: L K0(a/L)/K1(a/L)."""
    return relaxation_mm * k0e(a / relaxation_mm) / k1e(a / relaxation_mm)
