"""How an indenter's friction drags the gel's surface, and the markers on it, along."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.simulate.gel.gel import Gel, Surface
from gelform.simulate.gel.membrane import carried_along, spread
from gelform.simulate.indenters.pose import Pose

DRAG_STRIDE = 4  # drag is smooth over the gel's thickness: every fourth pixel is plenty


class Drag:
    """The surface's sideways displacement during a sequence; it has memory, so one per sequence.

    In the contact the surface sticks to the indenter until it has been dragged `friction` times the local
    depth (Coulomb: the bed's pressure grows with the depth); then it slips. Beside the contact the
    displacement falls off over the gel's thickness. What is pressed away flows sideways by `-h grad b` (b the
    bulge): the layer's mean flow that keeps its volume where bulge = 1.
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
        still = (
            surface.contact & self._contact if self._contact is not None else np.zeros_like(surface.contact)
        )
        moved = np.where(still[..., None], self._stuck + self._step(x, y, pose), self._stuck)
        limit = self.gel.friction * np.maximum(surface.depth_mm, 0)
        length = np.linalg.norm(moved, axis=-1)
        moved *= np.minimum(1, limit / np.maximum(length, 1e-12))[..., None]
        if surface.contact.any():
            thickness_px = self.gel.thickness_mm / pitch
            moved = np.stack(
                [carried_along(moved[..., k], surface.contact, thickness_px) for k in (0, 1)], axis=-1
            )
        else:
            moved = np.zeros_like(moved)
        self._stuck, self._pose, self._contact = moved, pose, surface.contact
        return moved + self._pressed_away(surface, pitch)

    def _step(self, x: NDArray[Any], y: NDArray[Any], pose: Pose) -> NDArray[np.float64]:
        """How far the indenter's surface has moved sideways since the last pose, at each point."""
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


def thinned(surface: Surface, stride: int) -> Surface:
    """Every `stride`-th sample of a surface, for what is smooth."""
    at = (slice(stride // 2, None, stride),) * 2
    return Surface(
        surface.x_mm[:, at[1]],
        surface.y_mm[at[0]],
        np.ascontiguousarray(surface.depth_mm[at]),
        surface.gradients[at],
        surface.contact[at],
    )


def displacement_at(
    displacement_mm: NDArray[np.float64], surface: Surface, points_mm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """A displacement field (h, w, 2) at points (N, 2), bilinear; at the border the nearest value."""
    pitch_x = float(surface.x_mm[0, 1] - surface.x_mm[0, 0])
    pitch_y = float(surface.y_mm[1, 0] - surface.y_mm[0, 0])
    column = ((points_mm[:, 0] - surface.x_mm[0, 0]) / pitch_x).astype(np.float32)
    row = ((points_mm[:, 1] - surface.y_mm[0, 0]) / pitch_y).astype(np.float32)
    found = cv2.remap(
        displacement_mm, column[:, None], row[:, None], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(found[:, 0], dtype=np.float64)
