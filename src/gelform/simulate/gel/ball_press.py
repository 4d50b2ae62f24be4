"""The gel under a ball, in closed form outside the contact: depth and slope depend on the radius alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import scipy  # its parts load at first use
from numpy.typing import NDArray

from gelform._native import Kernel

NODES = 200  # of the differences that solve the bulge inside the contact; measured error 3e-6 of its height
TABLE = 4096  # distances at which depth outside the contact is tabulated; measured error 25 nm

_ball_surface = Kernel(
    "ball_surface",
    "f64[w] dx, f64[h] dy, f64[points] depth, f64[points] slope, out f64[h,w] z, out f64[h,w,2] gradients, "
    "out bool[h,w] touching, f64 radius, f64 top, f64 contact, f64 step",
)


@dataclass(frozen=True)
class BallPress:
    """A ball in the gel, as depth over the distance r from its axis.

    Inside the contact radius `z = depth - R + sqrt(R^2 - r^2)`, beyond it a sum of two Bessel functions K0.

    Attributes
    ----------
    radius_mm, depth_mm : radius of the ball, and its depth in the gel
    contact_radius_mm : of the circle in which they touch
    tail_mm : depth at the rim that falls off over the relaxation length: the membrane, less the part of the
        bulge with the same length
    bulge_mm : height at the rim of the part of the bulge that falls off over the thickness
    relaxation_mm, thickness_mm : the lengths over which the two fall off
    """

    radius_mm: float
    depth_mm: float
    contact_radius_mm: float
    tail_mm: float
    bulge_mm: float
    relaxation_mm: float
    thickness_mm: float

    def tail(self, r_mm: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Depth and slope at distances r >= contact radius."""
        depth, slope = np.zeros(np.shape(r_mm)), np.zeros(np.shape(r_mm))
        for size, length in ((self.tail_mm, self.relaxation_mm), (-self.bulge_mm, self.thickness_mm)):
            if size != 0:
                scale = size * np.exp((self.contact_radius_mm - r_mm) / length)
                scale = scale / scipy.special.k0e(self.contact_radius_mm / length)
                depth += scale * scipy.special.k0e(r_mm / length)
                slope -= scale * scipy.special.k1e(r_mm / length) / length
        return depth, slope


@lru_cache(maxsize=256)
def ball_press(
    radius_mm: float, depth_mm: float, relaxation_mm: float, *, thickness_mm: float = 3.0, bulge: float = 0.0
) -> BallPress:
    """The press of a ball whose foremost point stands `depth_mm` in a gel; lengths in mm."""
    thickness_mm = _apart(thickness_mm, relaxation_mm)

    def mismatch(a: float) -> float:
        cosine = np.sqrt(radius_mm**2 - a**2)
        return float(_rim(a, radius_mm, depth_mm, relaxation_mm, thickness_mm, bulge)[0] * cosine)

    limits = 1e-6 * radius_mm, radius_mm * (1 - 1e-12)
    a = float(scipy.optimize.brentq(mismatch, *limits, xtol=1e-12 * radius_mm))
    _, membrane, risen = _rim(a, radius_mm, depth_mm, relaxation_mm, thickness_mm, bulge)
    follows = bulge * membrane / (1 - (thickness_mm / relaxation_mm) ** 2)
    return BallPress(radius_mm, depth_mm, a, membrane - follows, risen - follows, relaxation_mm, thickness_mm)


def depth_of_ball(
    radius_mm: float,
    rim_slope: float,
    relaxation_mm: float,
    *,
    thickness_mm: float = 3.0,
    bulge: float = 0.0,
) -> float:
    """Depth of a ball, mm, at which its slope at the contact's rim is `rim_slope`."""
    thickness_mm = _apart(thickness_mm, relaxation_mm)
    a = rim_slope * radius_mm / np.hypot(1, rim_slope)
    at_0, at_1 = (_rim(a, radius_mm, d, relaxation_mm, thickness_mm, bulge)[0] for d in (0.0, 1.0))
    return float(at_0 / (at_0 - at_1))  # the mismatch is linear in the depth


def ball_on_grid(
    press: BallPress, x_mm: NDArray[Any], y_mm: NDArray[Any], center_mm: tuple[float, float]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Depth (H, W), gradients (H, W, 2) and contact of a ball on a grid."""
    a = press.contact_radius_mm
    length = max(press.relaxation_mm, press.thickness_mm) if press.bulge_mm else press.relaxation_mm
    step = 16 * length / (TABLE - 1)  # e^-16: beyond, the gel is at rest
    depth, slope = _table(press, step)
    z, gradients = np.zeros((y_mm.size, x_mm.size)), np.zeros((y_mm.size, x_mm.size, 2))
    touching = np.zeros(z.shape, dtype=bool)
    dx, dy = np.ravel(x_mm) - center_mm[0], np.ravel(y_mm) - center_mm[1]
    _ball_surface(dx, dy, depth, slope, z, gradients, touching, press.radius_mm, press.depth_mm, a, step)
    return z, gradients, touching


@lru_cache(maxsize=64)
def _table(press: BallPress, step: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    return press.tail(press.contact_radius_mm + step * np.arange(TABLE))


def _rim(
    a: float, radius_mm: float, depth_mm: float, length: float, thickness: float, bulge: float
) -> tuple[float, float, float]:
    """Slope of the gel just inside the rim minus that outside; membrane and bulge at the rim.

    Inside, the membrane is the ball's face g plus the bulge b: (1 - bulge) b - h^2 laplace(b) = bulge g, by
    second-order differences. Outside, both are Bessel functions.
    """
    r = np.linspace(0, a, NODES + 1)
    face = depth_mm - radius_mm + np.sqrt(radius_mm**2 - r**2)
    kl = scipy.special.k1e(a / length) / scipy.special.k0e(a / length) / length
    slope = -a / np.sqrt(radius_mm**2 - a**2)
    if bulge == 0:
        return float(slope + face[-1] * kl), float(face[-1]), 0.0
    kh = scipy.special.k1e(a / thickness) / scipy.special.k0e(a / thickness) / thickness
    follows = bulge / (1 - (thickness / length) ** 2)
    b, b_slope = _bulge_inside(face, a, thickness, bulge, follows * (kl - kh), kh)
    membrane = face[-1] + b
    return float(slope + b_slope + membrane * kl), float(membrane), b


def _bulge_inside(
    face: NDArray[Any], a: float, thickness: float, bulge: float, coupling: float, kh: float
) -> tuple[float, float]:
    """The bulge and its slope at the rim, where it obeys `b' = -coupling (g + b) - kh b`."""
    step = a / NODES
    stiffness = (thickness / step) ** 2
    i = np.arange(1, NODES + 1)
    lower, upper = np.empty(NODES + 1), np.empty(NODES + 1)
    diagonal, right = np.full(NODES + 1, 1 - bulge + 2 * stiffness), bulge * face
    lower[1:], upper[1:] = -stiffness * (1 - 0.5 / i), -stiffness * (1 + 0.5 / i)
    diagonal[0], upper[0] = 1 - bulge + 4 * stiffness, -4 * stiffness
    ghost = upper[-1]  # the node beyond the rim, eliminated by the condition there
    lower[-1] += ghost
    diagonal[-1] -= ghost * 2 * step * (coupling + kh)
    right[-1] += ghost * 2 * step * coupling * face[-1]
    bands = np.stack([np.roll(upper, 1), diagonal, np.roll(lower, -1)])
    # Never singular: with a bulge below 1 the diagonal outweighs the rest of each row.
    b = float(scipy.linalg.solve_banded((1, 1), bands, right, check_finite=False)[-1])
    return b, -coupling * (float(face[-1]) + b) - kh * b


def _apart(thickness_mm: float, relaxation_mm: float) -> float:
    """The thickness, changed by a thousandth if it equals the relaxation length, because the formula has a pole there."""
    return relaxation_mm * (1 + 1e-3) if abs(thickness_mm / relaxation_mm - 1) < 1e-3 else thickness_mm
