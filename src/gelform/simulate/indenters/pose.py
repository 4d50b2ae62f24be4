"""Poses of indenters, and combinations: turned, tilted, several at once; each of them is again an indenter."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.simulate.indenters.faces import Ball, Indenter
from gelform.simulate.indenters.mesh import Mesh, height_of_triangles

MAX_TILT_DEG = 75.0  # degrees, of an indenter; beyond, the view would be along its face
Pair = tuple[float, float]


@dataclass(frozen=True)
class Pose:
    """The pose of an indenter.

    Attributes
    ----------
    depth_mm : depth of its foremost point in the gel; 0 or less: not pressed
    center_mm : (x, y) of its center, x to the right, y down
    spin_deg, tilt_deg : as in `Posed`
    carried_mm : (x, y), travel of the touched side of the indenter; None: as far as the center (it slides). If it
        rolls, the touched side does not move.
    """

    depth_mm: float
    center_mm: Pair = (0.0, 0.0)
    spin_deg: float = 0.0
    tilt_deg: Pair = (0.0, 0.0)
    carried_mm: Pair | None = None

    def __post_init__(self) -> None:
        numbers = (self.depth_mm, *self.center_mm, self.spin_deg, *self.tilt_deg, *self.travel_mm)
        if not all(np.isfinite(numbers)):
            raise ValueError(f"Expected a pose of finite numbers, got {self}.")
        if max(map(abs, self.tilt_deg)) > MAX_TILT_DEG:
            raise ValueError(f"Expected tilt_deg within +-{MAX_TILT_DEG:g}, got {self.tilt_deg}.")

    @property
    def travel_mm(self) -> Pair:
        return self.center_mm if self.carried_mm is None else self.carried_mm


@dataclass(frozen=True)
class Posed:
    """An indenter turned about the view axis and tilted.

    Attributes
    ----------
    indenter : any
    spin_deg : about the view axis, from x (right) toward y (down): clockwise in the image
    tilt_deg : (about x, about y), applied before the spin; positive about x raises the lower side (+y)
        toward the camera, positive about y the right side (+x)
    extent_mm : distance from its center up to which a tilted face is sampled
    samples : samples per extent, for the triangles of a tilted face

    The face is tilted about the origin, then moved so that its foremost point is at height 0 again. The body
    behind the face counts as a prism.
    """

    indenter: Indenter
    spin_deg: float = 0.0
    tilt_deg: Pair = (0.0, 0.0)
    extent_mm: float = 6.0
    samples: int = 400

    def __post_init__(self) -> None:
        if not np.isfinite(self.spin_deg) or max(map(abs, self.tilt_deg)) > MAX_TILT_DEG:
            raise ValueError(
                f"Expected a finite spin_deg and tilt_deg within +-{MAX_TILT_DEG:g}, got {self.spin_deg} and "
                f"{self.tilt_deg}."
            )
        if isinstance(self.indenter, Ball) or self.tilt_deg == (0, 0):
            return
        object.__setattr__(self, "_tilted", _tilted(self))

    def face_mm(self, x_mm: NDArray[Any], y_mm: NDArray[Any]) -> NDArray[np.float64]:
        if isinstance(self.indenter, Ball):
            return self.indenter.face_mm(x_mm, y_mm)
        c, s = np.cos(np.deg2rad(self.spin_deg)), np.sin(np.deg2rad(self.spin_deg))
        if self.tilt_deg == (0, 0):
            if isinstance(self.indenter, Mesh):
                v = np.asarray(self.indenter.vertices_mm)
                turned = np.stack([c * v[:, 0] - s * v[:, 1], s * v[:, 0] + c * v[:, 1], v[:, 2]], axis=1)
                return height_of_triangles(turned, np.asarray(self.indenter.triangles), x_mm, y_mm)
            return self.indenter.face_mm(c * x_mm + s * y_mm, c * y_mm - s * x_mm)
        vertices, triangles = self._tilted  # type: ignore[attr-defined]
        return height_of_triangles(vertices, triangles, x_mm, y_mm)


@dataclass(frozen=True)
class Placed:
    """One of several indenters: its place, and its distance behind the foremost one."""

    indenter: Indenter
    center_mm: Pair = (0.0, 0.0)
    back_mm: float = 0.0


@dataclass(frozen=True)
class Several:
    """Indenters pressed together as one rigid body."""

    parts: tuple[Placed, ...]

    def __post_init__(self) -> None:
        if len(self.parts) == 0:
            raise ValueError("Expected at least one part, got none.")
        if min(part.back_mm for part in self.parts) < 0:
            raise ValueError("Expected back_mm >= 0: 0 for the foremost part, more for those behind.")

    def face_mm(self, x_mm: NDArray[Any], y_mm: NDArray[Any]) -> NDArray[np.float64]:
        faces = [
            part.indenter.face_mm(x_mm - part.center_mm[0], y_mm - part.center_mm[1]) - part.back_mm
            for part in self.parts
        ]
        return np.asarray(np.maximum.reduce(faces), dtype=np.float64)


def rotation(spin_deg: float, tilt_deg: Pair) -> NDArray[np.float64]:
    """Rotation (3, 3) in the image frame (x right, y down, z toward the camera): tilt, then spin."""
    ax, ay = np.deg2rad(tilt_deg)
    about_x = np.array([[1, 0, 0], [0, np.cos(ax), -np.sin(ax)], [0, np.sin(ax), np.cos(ax)]])
    about_y = np.array([[np.cos(ay), 0, -np.sin(ay)], [0, 1, 0], [np.sin(ay), 0, np.cos(ay)]])
    a = np.deg2rad(spin_deg)
    spin = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    return np.asarray(spin @ about_y @ about_x, dtype=np.float64)


def _tilted(posed: Posed) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices and triangles of a face after its rotation, the foremost at height 0."""
    if isinstance(posed.indenter, Mesh):
        vertices, triangles = np.asarray(posed.indenter.vertices_mm), np.asarray(posed.indenter.triangles)
        used = np.unique(triangles)
    else:
        face: Any = posed.indenter, posed.extent_mm, posed.samples
        try:
            vertices, triangles, used = _triangulated(*face)
        except TypeError:  # an indenter that is no key of a cache
            vertices, triangles, used = _triangulated.__wrapped__(*face)
    turned = vertices @ rotation(posed.spin_deg, posed.tilt_deg).T
    turned[:, 2] -= turned[used, 2].max()
    return np.ascontiguousarray(turned), triangles


@lru_cache(maxsize=1)  # a press tilts one face repeatedly; its triangles take up to 50 MB
def _triangulated(
    indenter: Indenter, extent_mm: float, samples: int
) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """A face as vertices and triangles, with walls down to its depth at its ends; and the triangles that are walls."""
    axis = np.linspace(-extent_mm, extent_mm, 2 * samples + 1)
    face = indenter.face_mm(axis[None, :], axis[:, None])
    if not np.isfinite(face).any():
        raise ValueError(f"Expected a face within {extent_mm:g} mm of its center, got none: raise extent_mm.")
    height = np.where(np.isfinite(face), face, -2 * extent_mm)
    x, y = np.meshgrid(axis, axis)
    vertices = np.stack([x, y, height], axis=-1).reshape(-1, 3)
    n = axis.size
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)[None, :]).ravel()
    triangles = np.concatenate(
        [np.stack([corner, corner + 1, corner + n], 1), np.stack([corner + 1, corner + n + 1, corner + n], 1)]
    )
    there = np.isfinite(face).ravel()[triangles].any(axis=1)
    return vertices, triangles[there], np.unique(triangles[there])
