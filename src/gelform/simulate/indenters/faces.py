"""Indenters: each one is the height of its face over a plane.

An indenter has the method `face_mm(x_mm, y_mm)`: the height of its face relative to its foremost point, in mm. It is 0 at
that point, negative elsewhere, and -inf outside. x is to the right, y down, with the origin at its center.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Protocol

import cv2
import numpy as np
import scipy  # its parts load at first use
from numpy.typing import ArrayLike, NDArray

from gelform.foundations.checks import check_map, check_mm_per_px, check_positive

MAX_SIZE_MM = 1000.0  # mm, of an indenter; a larger number is in another unit


class Indenter(Protocol):
    """Anything with a face."""

    def face_mm(self, x_mm: NDArray[Any], y_mm: NDArray[Any]) -> NDArray[np.float64]:
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


@dataclass(frozen=True)
class Ball(_Sized):
    """A ball of the given radius in mm."""

    radius_mm: float

    def face_mm(self, x_mm: NDArray[Any], y_mm: NDArray[Any]) -> NDArray[np.float64]:
        inside = self.radius_mm**2 - x_mm**2 - y_mm**2
        face = np.sqrt(np.maximum(inside, 0)) - self.radius_mm
        return np.where(inside > 0, face, -np.inf)


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

    def face_mm(self, x_mm: NDArray[Any], y_mm: NDArray[Any]) -> NDArray[np.float64]:
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
    diameter_mm : float
    relief_mm : float
        Height of rim, star and beads over the disc; their flanks are twice as wide as they are high.
    """

    diameter_mm: float = 8.0
    relief_mm: float = 0.15

    def face_mm(self, x_mm: NDArray[Any], y_mm: NDArray[Any]) -> NDArray[np.float64]:
        x, y = np.broadcast_arrays(x_mm, y_mm)
        radius = self.diameter_mm / 2
        face = np.full(x.shape, -np.inf)
        on_disc = x**2 + y**2 <= radius**2
        face[on_disc] = self._relief(x[on_disc], y[on_disc])
        return face

    def _relief(self, x_mm: NDArray[Any], y_mm: NDArray[Any]) -> NDArray[np.float64]:
        radius = self.diameter_mm / 2
        r, angle = np.hypot(x_mm, y_mm), np.arctan2(y_mm, x_mm)
        sector = np.pi / 16
        bead_angle = (angle + sector) % (2 * sector) - sector
        bead_distance = np.hypot(r * np.cos(bead_angle) - 0.74 * radius, r * np.sin(bead_angle))
        inside = np.maximum.reduce(  # distance inside the nearest raised edge, mm
            [r - 0.86 * radius, 0.05 * radius - bead_distance, _inside_star(r, angle, 0.58 * radius)]
        )
        raised = _smooth_step(inside / (2 * self.relief_mm) + 0.5)
        return (raised - 1) * self.relief_mm


@dataclass(frozen=True)
class Screw(_Sized):
    """A metric screw thread lying on its side, its axis along x.

    It is a V thread of the given pitch, flanks at 60 degrees (30 from the normal of the axis each), cut to five
    eighths of the sharp V's height as in ISO 68-1; the helix is that of the crest's cylinder.
    """

    major_diameter_mm: float = 8.0
    pitch_mm: float = 1.25
    length_mm: float = 12.0

    def face_mm(self, x_mm: NDArray[Any], y_mm: NDArray[Any]) -> NDArray[np.float64]:
        major = self.major_diameter_mm / 2
        turn = np.arcsin(np.clip(y_mm / major, -1, 1)) / (2 * np.pi)
        phase = np.abs((x_mm / self.pitch_mm - turn) % 1 - 0.5) * 2  # 0 at the crest, 1 in the groove
        sharp = np.sqrt(3) / 2 * self.pitch_mm
        radius = major - np.clip(phase * sharp - sharp / 8, 0, 0.625 * sharp)
        inside = radius**2 - y_mm**2
        there = (inside > 0) & (np.abs(x_mm) <= self.length_mm / 2)
        return np.where(there, np.sqrt(np.maximum(inside, 0)) - major, -np.inf)


@dataclass(frozen=True)
class Cylinder(_Sized):
    """A cylinder lying on its side, its axis along x."""

    radius_mm: float
    length_mm: float

    def face_mm(self, x_mm: NDArray[Any], y_mm: NDArray[Any]) -> NDArray[np.float64]:
        inside = self.radius_mm**2 - y_mm**2
        there = (inside > 0) & (np.abs(x_mm) <= self.length_mm / 2)
        return np.where(there, np.sqrt(np.maximum(inside, 0)) - self.radius_mm, -np.inf)


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

    def face_mm(self, x_mm: NDArray[Any], y_mm: NDArray[Any]) -> NDArray[np.float64]:
        fall = np.abs(y_mm) / np.tan(np.deg2rad(self.angle_deg) / 2)
        return np.where(np.abs(x_mm) <= self.length_mm / 2, -fall, -np.inf)


@dataclass(frozen=True)
class Punch(_Sized):
    """A flat punch: a disc, or a rectangle where `width_mm` is given; its edge is sharp."""

    diameter_mm: float
    width_mm: float | None = None

    def face_mm(self, x_mm: NDArray[Any], y_mm: NDArray[Any]) -> NDArray[np.float64]:
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

    def face_mm(self, x_mm: NDArray[Any], y_mm: NDArray[Any]) -> NDArray[np.float64]:
        away = np.maximum(np.abs(x_mm), np.abs(y_mm))
        fall = away / np.tan(np.deg2rad(self.angle_deg) / 2)
        return np.where(away <= self.base_mm / 2, -fall, -np.inf)


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

    def face_mm(self, x_mm: NDArray[Any], y_mm: NDArray[Any]) -> NDArray[np.float64]:
        r = np.hypot(x_mm, y_mm)
        return np.where(r <= self.diameter_mm / 2, -r / np.tan(np.deg2rad(self.angle_deg) / 2), -np.inf)


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

    def face_mm(self, x_mm: NDArray[Any], y_mm: NDArray[Any]) -> NDArray[np.float64]:
        inside = self.tube_radius_mm**2 - (np.hypot(x_mm, y_mm) - self.ring_radius_mm) ** 2
        return np.where(inside > 0, np.sqrt(np.maximum(inside, 0)) - self.tube_radius_mm, -np.inf)


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
    capital_px = 48  # px, height of a capital letter in the map
    font, thickness = cv2.FONT_HERSHEY_SIMPLEX, 6
    scale = capital_px / 22.0  # this font's capitals are 22 px high at scale 1
    (width, height), below = cv2.getTextSize(text, font, scale, thickness)
    border = capital_px // 2
    drawing = np.zeros((height + below + 2 * border, width + 2 * border), dtype=np.uint8)
    cv2.putText(drawing, text, (border, border + height), font, scale, 255, thickness, cv2.LINE_AA)
    heights = cv2.GaussianBlur(drawing.astype(np.float64), (0, 0), 1.5) * (relief_mm / 255)
    return HeightMap(heights - heights.max(), height_mm / capital_px)


def _inside_star(r: NDArray[Any], angle: NDArray[Any], radius: float) -> NDArray[np.float64]:
    """Signed distance inside a five-pointed star's edges (their lines), positive inside."""
    sector = np.pi / 5
    folded = np.abs((angle + np.pi / 2 + sector) % (2 * sector) - sector)  # a point of the star at 0
    x, y = r * np.cos(folded), r * np.sin(folded)
    inner = 0.45 * radius
    edge = np.array([inner * np.cos(sector) - radius, inner * np.sin(sector)])
    nx, ny = np.array([edge[1], -edge[0]]) / np.hypot(*edge)
    return -((x - radius) * nx + y * ny)


def _smooth_step(t: NDArray[Any]) -> NDArray[np.float64]:
    """0 below 0, 1 above 1, a cubic between."""
    t = np.clip(t, 0, 1)
    return np.asarray(t * t * (3 - 2 * t), dtype=np.float64)
