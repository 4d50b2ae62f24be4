"""The gel: its surface follows the indenter in the contact, relaxes around it, and is dragged along.

The surface is a membrane under tension on an elastic bed, held up by the indenter: of all surfaces u that do
not enter the indenter's face g, the one of least energy

    min_u  integral |grad u|^2 + (u/L)^2      subject to  u >= g.

So u = g in the contact, L^2 laplace(u) = u around it (depth falls off over the relaxation length L), and the
slope is continuous at the rim: the gel leaves the indenter a little inside the circle where the undeformed
plane would cut it.

Rubber keeps its volume: the displaced part rises around the contact, over a length of about the gel's
thickness. With w the membrane, b the bulge and h the thickness, the surface is

    u = w - b,    b - h^2 laplace(b) = bulge w,    w the membrane over g + b.

The volume of u is (1 - bulge) times that of w; with `bulge` = 0 nothing rises.

The obstacle problem: Kinderlehrer and Stampacchia, An Introduction to Variational Inequalities, 1980; the
elastic bed: Kerr, Elastic and viscoelastic foundation models, J. Appl. Mech. 31, 1964.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.foundations.checks import check_positive
from gelform.simulate.gel.ball_press import ball_on_grid, ball_press
from gelform.simulate.gel.membrane import TOLERANCE, carried_along, membrane_over, spread
from gelform.simulate.indenters.faces import Ball, Indenter
from gelform.simulate.indenters.pose import Pose


@dataclass(frozen=True)
class Gel:
    """The material of the gel.

    Attributes
    ----------
    thickness_mm : float
        The displaced gel rises within about this distance of the contact.
    bulge : float, 0 to 0.95
        Part of the displaced volume that rises around the contact: 0 for a foam, near 1 for rubber.
    friction : float, >= 0
        Distance that the surface is dragged before it slips, per mm of depth.
    """

    thickness_mm: float = 3.0
    bulge: float = 0.0
    friction: float = 0.8

    def __post_init__(self) -> None:
        check_positive(self.thickness_mm, "thickness_mm")
        if not 0 <= self.bulge <= 0.95:
            raise ValueError(f"Expected bulge in 0-0.95, got {self.bulge}.")
        if not 0 <= self.friction < np.inf:
            raise ValueError(f"Expected friction >= 0, got {self.friction}.")


def relaxation_from_gel(tension_n_per_m: float, stiffness_kpa: float, thickness_mm: float) -> float:
    """Relaxation length in mm of a coating under tension T on a gel of Young's modulus E: sqrt(T h/E).

    The bed's spring constant per area is E/h (Winkler), the membrane's equation `T laplace(u) = E/h u`.
    """
    tension = check_positive(tension_n_per_m, "tension_n_per_m")
    stiffness = check_positive(stiffness_kpa, "stiffness_kpa")
    return float(np.sqrt(tension * check_positive(thickness_mm, "thickness_mm") / stiffness))


@dataclass(frozen=True)
class Surface:
    """A gel surface on a regular grid.

    Attributes
    ----------
    x_mm, y_mm : (1, W) and (H, 1), coordinates of the samples
    depth_mm : (H, W) float64, positive where pressed, negative where the gel rises around the contact
    gradients : (H, W, 2) float64, mm/mm
    contact : (H, W) bool, where gel and indenter touch
    """

    x_mm: NDArray[np.float64]
    y_mm: NDArray[np.float64]
    depth_mm: NDArray[np.float64]
    gradients: NDArray[np.float64]
    contact: NDArray[np.bool_]

    def sampled(self, at: slice) -> Surface:
        """The surface at given rows, and at the same of its columns."""
        return Surface(
            self.x_mm[:, at],
            self.y_mm[at],
            np.ascontiguousarray(self.depth_mm[at, at]),
            np.ascontiguousarray(self.gradients[at, at]),
            np.ascontiguousarray(self.contact[at, at]),
        )

    def middles(self, stride: int) -> Surface:
        """The surface at the middle of each `stride` samples, for an odd number per pixel: at the pixels' centers."""
        return self if stride == 1 else self.sampled(slice(stride // 2, None, stride))


def flat_surface(x_mm: NDArray[np.float64], y_mm: NDArray[np.float64]) -> Surface:
    """The surface of the gel at rest."""
    shape = (y_mm.size, x_mm.size)
    return Surface(x_mm, y_mm, np.zeros(shape), np.zeros((*shape, 2)), np.zeros(shape, dtype=bool))


def surface_from_indenter(
    indenter: Indenter,
    x_mm: NDArray[np.float64],
    y_mm: NDArray[np.float64],
    *,
    center_mm: tuple[float, float],
    depth_mm: float,
    relaxation_mm: float,
    gel: Gel | None = None,
) -> Surface:
    """The pressed gel under an indenter: the membrane solved on the grid, its slopes by central differences.

    The grid must extend some relaxation lengths beyond the region of interest, because no force acts across its border.
    Under a
    ball the surface is known in closed form: a cap, then Bessel functions K0 of r over the gel's lengths.
    """
    gel = gel or Gel()
    if isinstance(indenter, Ball):
        lengths = {"thickness_mm": gel.thickness_mm, "bulge": gel.bulge}
        press = ball_press(indenter.radius_mm, depth_mm, relaxation_mm, **lengths)
        return Surface(x_mm, y_mm, *ball_on_grid(press, x_mm, y_mm, center_mm))
    face = depth_mm + indenter.face_mm(x_mm - center_mm[0], y_mm - center_mm[1])
    pitch = float(x_mm[0, 1] - x_mm[0, 0])
    obstacle = np.maximum(face, -depth_mm if gel.bulge else 0)  # the gel never rises that far
    membrane, bulge = membrane_over(
        obstacle, relaxation_px=relaxation_mm / pitch, bulge=gel.bulge, bulge_px=gel.thickness_mm / pitch
    )
    tolerance = TOLERANCE * depth_mm if gel.bulge else 0
    touching = (membrane > 0) & (membrane <= obstacle + bulge + tolerance)
    depth = np.where(touching, obstacle, membrane - bulge)
    slope_y, slope_x = np.gradient(depth, pitch, edge_order=2)
    return Surface(x_mm, y_mm, depth, np.stack([slope_x, slope_y], axis=-1), touching)


class Drag:
    """The surface's sideways displacement during a sequence. It has memory, so each sequence needs its own.

    In the contact the surface sticks to the indenter until it has been dragged `friction` times the local
    depth (Coulomb: the bed's pressure grows with the depth); then it slips. Around the contact the
    displacement falls off over the gel's thickness. Displaced gel flows sideways by `-h grad b` (b the bulge):
    the layer's mean flow that keeps its volume where bulge = 1.
    """

    def __init__(self, gel: Gel) -> None:
        self.gel = gel
        self._stuck: NDArray[np.float64] | None = None
        self._pose: Pose | None = None
        self._contact: NDArray[np.bool_] | None = None

    def __call__(self, surface: Surface, pose: Pose) -> NDArray[np.float64]:
        """Displacement (h, w, 2) in mm, x and y, on the surface's grid."""
        x, y = surface.x_mm, surface.y_mm
        pitch = float(x[0, 1] - x[0, 0])
        if self._stuck is None:
            self._stuck = np.zeros((*surface.depth_mm.shape, 2))
        elif self._stuck.shape[:2] != surface.depth_mm.shape:
            raise ValueError("Expected surfaces on one grid, got another: use one Drag per sequence.")
        touched = np.zeros_like(surface.contact) if self._contact is None else surface.contact & self._contact
        moved = np.where(touched[..., None], self._stuck + self._step(x, y, pose), self._stuck)
        limit = self.gel.friction * np.maximum(surface.depth_mm, 0)
        length = np.linalg.norm(moved, axis=-1)
        moved *= np.minimum(1, limit / np.maximum(length, 1e-12))[..., None]
        thickness_px = self.gel.thickness_mm / pitch
        if surface.contact.any():
            parts = [carried_along(moved[..., k], surface.contact, thickness_px) for k in (0, 1)]
            moved = np.stack(parts, axis=-1)
        else:
            moved = np.zeros_like(moved)
        self._stuck, self._pose, self._contact = moved, pose, surface.contact
        return moved + self._pressed_away(surface, pitch)

    def _step(self, x: NDArray[Any], y: NDArray[Any], pose: Pose) -> NDArray[np.float64]:
        """Sideways motion of the indenter's surface since the last pose, at each point."""
        last = self._pose or pose
        turn = np.deg2rad(pose.spin_deg - last.spin_deg)
        dx, dy = np.broadcast_arrays(x - pose.center_mm[0], y - pose.center_mm[1])
        step_x = pose.travel_mm[0] - last.travel_mm[0] - np.sin(turn) * dy + (np.cos(turn) - 1) * dx
        step_y = pose.travel_mm[1] - last.travel_mm[1] + np.sin(turn) * dx + (np.cos(turn) - 1) * dy
        return np.stack([step_x, step_y], axis=-1)

    def _pressed_away(self, surface: Surface, pitch: float) -> NDArray[np.float64]:
        """The gel's flow from under the indenter, `-h grad b`, with b from the positive part of the depth."""
        thickness = self.gel.thickness_mm
        bulge = self.gel.bulge * spread(np.maximum(surface.depth_mm, 0), thickness / pitch)
        slope_y, slope_x = np.gradient(bulge, pitch)
        return -thickness * np.stack([slope_x, slope_y], axis=-1)


def displacement_at(
    displacement_mm: NDArray[np.float64], surface: Surface, points_mm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """A displacement field (h, w, 2) at points (N, 2), bilinear; the nearest value outside the border."""
    pitch_x = float(surface.x_mm[0, 1] - surface.x_mm[0, 0])
    pitch_y = float(surface.y_mm[1, 0] - surface.y_mm[0, 0])
    column = ((points_mm[:, 0] - surface.x_mm[0, 0]) / pitch_x).astype(np.float32)
    row = ((points_mm[:, 1] - surface.y_mm[0, 0]) / pitch_y).astype(np.float32)
    found = cv2.remap(
        displacement_mm, column[:, None], row[:, None], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(found[:, 0], dtype=np.float64)
