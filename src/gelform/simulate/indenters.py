"""Indenters: each is the height of its face over a plane; meshes, poses, and several at once.

An indenter has the method `face_mm(x_mm, y_mm)`: the height of its face relative to its foremost point, in mm. It is 0 at
that point, negative elsewhere, and -inf outside. x is to the right, y down, with the origin at its center.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any, Protocol

import cv2
import numpy as np
import scipy  # its parts load at first use
from numpy.typing import ArrayLike, NDArray

from gelform._native import Kernel
from gelform.arrays import Array, Mask, Numbers
from gelform.foundations.checks import check_finite, check_map, check_mm_per_px, check_positive

MAX_SIZE_MM = 1000.0  # mm, of an indenter; a larger number is in another unit


class Indenter(Protocol):
    """Anything with a face."""

    def face_mm(self, x_mm: Array, y_mm: Array) -> Numbers:
        """Height of the face over its foremost point, mm: <= 0, -inf where there is nothing."""
        ...


def check_size(value: float, name: str) -> None:
    """Refuse a length in mm that is not positive, or so large that it must be in another unit."""
    if check_positive(value, name) > MAX_SIZE_MM:
        raise ValueError(
            f"Expected {name} in mm, at most {MAX_SIZE_MM:g}, got {value:g}. Is it in another unit?"
        )


class _Sized:
    """An indenter of lengths `..._mm` and opening angles `..._deg`, which are checked when it is made."""

    def __post_init__(self) -> None:
        for one in fields(self):  # type: ignore[arg-type]
            value = getattr(self, one.name)
            if one.name.endswith("_mm") and value is not None:
                check_size(value, one.name)
            if one.name.endswith("_deg") and not 0 < value < 180:
                raise ValueError(f"Expected {one.name} in 0-180 degrees (both excluded), got {value}.")


def _arc(inside: Numbers, radius_mm: float, there: Mask | bool = True) -> Numbers:
    """A round face: `inside` is the square of its radius less that of the distance from its middle."""
    return np.where((inside > 0) & there, np.sqrt(np.maximum(inside, 0)) - radius_mm, -np.inf)


def _flank(away: Numbers, angle_deg: float, there: Mask) -> Numbers:
    """A straight flank that falls with the distance `away`; `angle_deg` is the opening between it and the opposite one."""
    return np.where(there, -away / np.tan(np.deg2rad(angle_deg) / 2), -np.inf)


@dataclass(frozen=True)
class Ball(_Sized):
    """A ball of the given radius in mm."""

    radius_mm: float

    def face_mm(self, x_mm: Array, y_mm: Array) -> Numbers:
        return _arc(self.radius_mm**2 - x_mm**2 - y_mm**2, self.radius_mm)


@dataclass(frozen=True)
class HeightMap:
    """A measured or generated face: heights in mm on a grid, larger is nearer to the camera.

    Between the samples the face is a cubic spline; outside the grid there is none.

    Attributes
    ----------
    height_mm : (h, w), mm, at least 2x2; its largest value is the foremost point
    mm_per_px : float or (x, y), mm between samples
    """

    height_mm: ArrayLike
    mm_per_px: float | tuple[float, float]

    def __post_init__(self) -> None:
        heights = check_map(self.height_mm, "height_mm", dtype=np.float64)
        if heights.ndim != 2 or min(heights.shape) < 2:
            raise ValueError(f"Expected height_mm of shape (h, w), at least 2x2, got {heights.shape}.")
        spline = scipy.ndimage.spline_filter(heights - heights.max(), order=3, mode="nearest")
        object.__setattr__(self, "_spline", spline)
        object.__setattr__(self, "_pitch", check_mm_per_px(self.mm_per_px))

    def face_mm(self, x_mm: Array, y_mm: Array) -> Numbers:
        spline, (hx, hy) = self._spline, self._pitch  # type: ignore[attr-defined]
        height, width = spline.shape
        column, row = np.broadcast_arrays(x_mm / hx + (width - 1) / 2, y_mm / hy + (height - 1) / 2)
        face = scipy.ndimage.map_coordinates(spline, [row, column], order=3, mode="nearest", prefilter=False)
        there = (row >= 0) & (row <= height - 1) & (column >= 0) & (column <= width - 1)
        return np.where(there, np.minimum(face, 0), -np.inf)


@dataclass(frozen=True)
class Coin(_Sized):
    """A coin-like relief: a raised rim, a star and a ring of beads on a flat disc.

    Attributes
    ----------
    diameter_mm : of the disc
    relief_mm : height of rim, star and beads over the disc; their flanks are twice as wide as they are high
    """

    diameter_mm: float = 8.0
    relief_mm: float = 0.15

    def face_mm(self, x_mm: Array, y_mm: Array) -> Numbers:
        x, y = np.broadcast_arrays(x_mm, y_mm)
        radius, face = self.diameter_mm / 2, np.full(x.shape, -np.inf)
        on_disc = x**2 + y**2 <= radius**2
        r, angle = np.hypot(x[on_disc], y[on_disc]), np.arctan2(y[on_disc], x[on_disc])
        sector = np.pi / 16
        bead_angle = (angle + sector) % (2 * sector) - sector
        bead_distance = np.hypot(r * np.cos(bead_angle) - 0.74 * radius, r * np.sin(bead_angle))
        inside = np.maximum.reduce(  # distance inside the nearest raised edge, mm
            [r - 0.86 * radius, 0.05 * radius - bead_distance, _inside_star(r, angle, 0.58 * radius)]
        )
        t = np.clip(inside / (2 * self.relief_mm) + 0.5, 0, 1)
        raised = t * t * (3 - 2 * t)  # 0 outside, 1 inside, a cubic between
        face[on_disc] = (raised - 1) * self.relief_mm
        return face


@dataclass(frozen=True)
class Screw(_Sized):
    """A metric screw thread lying on its side, its axis along x.

    It is a V thread of the given pitch, flanks at 60 degrees (30 from the normal of the axis each), cut to five
    eighths of the sharp V's height as in ISO 68-1; the helix is that of the crest's cylinder.
    """

    major_diameter_mm: float = 8.0
    pitch_mm: float = 1.25
    length_mm: float = 12.0

    def face_mm(self, x_mm: Array, y_mm: Array) -> Numbers:
        major = self.major_diameter_mm / 2
        turn = np.arcsin(np.clip(y_mm / major, -1, 1)) / (2 * np.pi)
        phase = np.abs((x_mm / self.pitch_mm - turn) % 1 - 0.5) * 2  # 0 at the crest, 1 in the groove
        sharp = np.sqrt(3) / 2 * self.pitch_mm
        radius = major - np.clip(phase * sharp - sharp / 8, 0, 0.625 * sharp)
        return _arc(radius**2 - y_mm**2, major, np.abs(x_mm) <= self.length_mm / 2)


@dataclass(frozen=True)
class Cylinder(_Sized):
    """A cylinder lying on its side, its axis along x."""

    radius_mm: float
    length_mm: float

    def face_mm(self, x_mm: Array, y_mm: Array) -> Numbers:
        return _arc(self.radius_mm**2 - y_mm**2, self.radius_mm, np.abs(x_mm) <= self.length_mm / 2)


@dataclass(frozen=True)
class BoxEdge(_Sized):
    """A long edge of a box, along x: a roof with two equal sides.

    Attributes
    ----------
    length_mm : of the edge
    angle_deg : between the two sides, 90 for a box
    """

    length_mm: float
    angle_deg: float = 90.0

    def face_mm(self, x_mm: Array, y_mm: Array) -> Numbers:
        return _flank(np.abs(y_mm), self.angle_deg, np.abs(x_mm) <= self.length_mm / 2)


@dataclass(frozen=True)
class Punch(_Sized):
    """A flat punch: a disc, or a rectangle where `width_mm` is given; its edge is sharp."""

    diameter_mm: float
    width_mm: float | None = None

    def face_mm(self, x_mm: Array, y_mm: Array) -> Numbers:
        if self.width_mm is None:
            there = x_mm**2 + y_mm**2 <= (self.diameter_mm / 2) ** 2
        else:
            there = (np.abs(x_mm) <= self.diameter_mm / 2) & (np.abs(y_mm) <= self.width_mm / 2)
        return np.where(there, 0.0, -np.inf)


@dataclass(frozen=True)
class Pyramid(_Sized):
    """A square pyramid, its point toward the camera.

    Attributes
    ----------
    base_mm : side of the base
    angle_deg : between opposite sides at the point
    """

    base_mm: float
    angle_deg: float = 120.0

    def face_mm(self, x_mm: Array, y_mm: Array) -> Numbers:
        away = np.maximum(np.abs(x_mm), np.abs(y_mm))
        return _flank(away, self.angle_deg, away <= self.base_mm / 2)


@dataclass(frozen=True)
class Cone(_Sized):
    """A cone, its point toward the camera.

    Attributes
    ----------
    diameter_mm : of the base
    angle_deg : the opening at the point
    """

    diameter_mm: float
    angle_deg: float = 120.0

    def face_mm(self, x_mm: Array, y_mm: Array) -> Numbers:
        r = np.hypot(x_mm, y_mm)
        return _flank(r, self.angle_deg, r <= self.diameter_mm / 2)


@dataclass(frozen=True)
class Torus(_Sized):
    """A ring lying flat.

    Attributes
    ----------
    ring_radius_mm : from the axis to the middle of the tube
    tube_radius_mm : of the tube
    """

    ring_radius_mm: float
    tube_radius_mm: float

    def face_mm(self, x_mm: Array, y_mm: Array) -> Numbers:
        away = np.hypot(x_mm, y_mm) - self.ring_radius_mm
        return _arc(self.tube_radius_mm**2 - away**2, self.tube_radius_mm)


def text_relief(text: str, *, height_mm: float, relief_mm: float = 0.3) -> HeightMap:
    """Raised letters on a plate, as on a stamp that reads right in the image.

    Parameters
    ----------
    text : printable ASCII
    height_mm : of a capital letter
    relief_mm : height of the letters over the plate

    Raises
    ------
    ValueError
        Text that is empty or has a character that the font lacks.
    """
    if not text.strip() or not all(32 <= ord(letter) < 127 for letter in text):
        raise ValueError(f"Expected text of printable ASCII letters, got {text!r}.")
    check_size(height_mm, "height_mm")
    check_size(relief_mm, "relief_mm")
    capital_px, font, thickness = 48, cv2.FONT_HERSHEY_SIMPLEX, 6
    scale = capital_px / 22.0  # this font's capitals are 22 px high at scale 1
    (width, height), below = cv2.getTextSize(text, font, scale, thickness)
    border = capital_px // 2
    drawing = np.zeros((height + below + 2 * border, width + 2 * border), dtype=np.uint8)
    cv2.putText(drawing, text, (border, border + height), font, scale, 255, thickness, cv2.LINE_AA)
    heights = cv2.GaussianBlur(drawing.astype(np.float64), (0, 0), 1.5) * (relief_mm / 255)
    return HeightMap(heights - heights.max(), height_mm / capital_px)


def _inside_star(r: Array, angle: Array, radius: float) -> Numbers:
    """Signed distance inside a five-pointed star's edges (their lines), positive inside."""
    sector = np.pi / 5
    folded = np.abs((angle + np.pi / 2 + sector) % (2 * sector) - sector)  # a point of the star at 0
    x, y = r * np.cos(folded), r * np.sin(folded)
    inner = 0.45 * radius
    edge = np.array([inner * np.cos(sector) - radius, inner * np.sin(sector)])
    nx, ny = np.array([edge[1], -edge[0]]) / np.hypot(*edge)
    return -((x - radius) * nx + y * ny)


_rasterise = Kernel(
    "rasterise",
    "f64[count,3] vertices, i64[faces,3] triangles, out f64[h,w] height, f64 x0, f64 y0, f64 hx, f64 hy",
)


@dataclass(frozen=True, eq=False)
class Mesh:
    """A closed triangle mesh; its side toward +z faces the gel.

    Its origin is the middle of its extent in x and y, at its highest point.

    Attributes
    ----------
    vertices_mm : (V, 3), x to the right, y down, z toward the camera
    triangles : (T, 3) int, indices into the vertices

    Raises
    ------
    ValueError
        No triangles, indices out of range, more than 5 million triangles, a mesh that is open (an edge
        without its two triangles), or a size that suggests another unit.
    """

    vertices_mm: ArrayLike
    triangles: ArrayLike

    def __post_init__(self) -> None:
        vertices = check_finite(np.ascontiguousarray(self.vertices_mm, dtype=np.float64), "vertices_mm")
        triangles = np.ascontiguousarray(self.triangles, dtype=np.int64)
        if vertices.ndim != 2 or vertices.shape[1] != 3 or triangles.ndim != 2 or triangles.shape[1] != 3:
            raise ValueError(
                f"Expected vertices_mm (V, 3) and triangles (T, 3), got {vertices.shape} and {triangles.shape}."
            )
        if not 0 < len(triangles) <= 5_000_000:  # a larger file was meant for something else
            got = f"got {len(triangles)}. Simplify the mesh first" if len(triangles) else "got an empty one"
            raise ValueError(f"Expected a mesh with triangles, 5000000 at most, {got}.")
        if triangles.min() < 0 or triangles.max() >= len(vertices):
            raise ValueError(f"Expected triangles with indices in 0-{len(vertices) - 1}.")
        size = float(np.ptp(vertices, axis=0).max())
        if not 0.01 <= size <= MAX_SIZE_MM:
            raise ValueError(
                f"Expected a mesh of 0.01-{MAX_SIZE_MM:g} mm, got {size:.4g} mm. Is it in another unit? "
                "Scale it: meters x 1000, inches x 25.4."
            )
        _, merged = np.unique(vertices, axis=0, return_inverse=True)  # an STL repeats its vertices
        edges = np.sort(merged.reshape(-1)[triangles][:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        _, count = np.unique(edges[edges[:, 0] != edges[:, 1]], axis=0, return_counts=True)
        if open_edges := int(np.count_nonzero(count % 2)):
            raise ValueError(
                f"Expected a closed mesh, got one with {open_edges} edges that border only one triangle. "
                "Close its holes first (in trimesh: mesh.fill_holes())."
            )
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        shift = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, high[2]])
        object.__setattr__(self, "vertices_mm", vertices - shift)
        object.__setattr__(self, "triangles", triangles)

    def face_mm(self, x_mm: Array, y_mm: Array) -> Numbers:
        return height_of_triangles(np.asarray(self.vertices_mm), np.asarray(self.triangles), x_mm, y_mm)


def height_of_triangles(vertices: Numbers, triangles: NDArray[np.int64], x_mm: Array, y_mm: Array) -> Numbers:
    """Height of the topmost of triangles (T, 3) with vertices (V, 3) over each point of a grid; -inf where there is none.

    x_mm (1, W) and y_mm (H, 1) are evenly spaced.
    """
    x, y = np.ravel(x_mm).astype(np.float64), np.ravel(y_mm).astype(np.float64)
    if np.shape(x_mm) != (1, x.size) or np.shape(y_mm) != (y.size, 1):
        raise ValueError(
            f"Expected a regular grid (1, W) and (H, 1), got {np.shape(x_mm)} and {np.shape(y_mm)}."
        )
    out = np.full((y.size, x.size), -np.inf)
    pitch_x, pitch_y = (x[-1] - x[0]) / (x.size - 1), (y[-1] - y[0]) / (y.size - 1)
    _rasterise(vertices, triangles, out, x[0], y[0], pitch_x, pitch_y)
    return out


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

    def face_mm(self, x_mm: Array, y_mm: Array) -> Numbers:
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

    def face_mm(self, x_mm: Array, y_mm: Array) -> Numbers:
        faces = [
            part.indenter.face_mm(x_mm - part.center_mm[0], y_mm - part.center_mm[1]) - part.back_mm
            for part in self.parts
        ]
        return np.asarray(np.maximum.reduce(faces), dtype=np.float64)


def rotation(spin_deg: float, tilt_deg: Pair) -> Numbers:
    """Rotation (3, 3) in the image frame (x right, y down, z toward the camera): tilt, then spin."""
    ax, ay = np.deg2rad(tilt_deg)
    about_x = np.array([[1, 0, 0], [0, np.cos(ax), -np.sin(ax)], [0, np.sin(ax), np.cos(ax)]])
    about_y = np.array([[np.cos(ay), 0, -np.sin(ay)], [0, 1, 0], [np.sin(ay), 0, np.cos(ay)]])
    a = np.deg2rad(spin_deg)
    spin = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
    return np.asarray(spin @ about_y @ about_x, dtype=np.float64)


def _tilted(posed: Posed) -> tuple[Numbers, NDArray[np.int64]]:
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
) -> tuple[Numbers, NDArray[np.int64], NDArray[np.int64]]:
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
