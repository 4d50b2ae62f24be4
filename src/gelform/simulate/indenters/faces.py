"""What is pressed into the gel: each indenter is the height of its face over a plane.

An indenter answers `face_mm(x_mm, y_mm)`: how far its face stands back from its foremost point, in mm, 0 at
that point, negative elsewhere, -inf where there is nothing. x to the right, y down, the origin at its centre.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy  # its parts load at first use
from numpy.typing import ArrayLike, NDArray

from gelform.checks import check_map, check_mm_per_px, check_positive

MAX_SIZE_MM = 1000.0


class Indenter(Protocol):
    """Anything with a face."""

    def face_mm(self, x_mm: NDArray[Any], y_mm: NDArray[Any]) -> NDArray[np.float64]:
        """Height of the face over its foremost point, mm: <= 0, -inf where there is nothing."""
        ...


@dataclass(frozen=True)
class Ball:
    """A ball of the given radius in mm."""

    radius_mm: float

    def __post_init__(self) -> None:
        check_size(self.radius_mm, "radius_mm")

    def face_mm(self, x_mm: NDArray[Any], y_mm: NDArray[Any]) -> NDArray[np.float64]:
        inside = self.radius_mm**2 - x_mm**2 - y_mm**2
        face = np.sqrt(np.maximum(inside, 0)) - self.radius_mm
        return np.where(inside > 0, face, -np.inf)


@dataclass(frozen=True)
class HeightMap:
    """A measured or made face: heights in mm on a grid, larger is nearer to the camera.

    Between the samples the face is a cubic spline; beside the grid there is nothing.

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
class Coin:
    """A coin-like relief: a raised rim, a star and a ring of beads on a flat disc.

    Attributes
    ----------
    diameter_mm : float
    relief_mm : float
        How far rim, star and beads stand over the disc; their flanks are twice as wide as they are high.
    """

    diameter_mm: float = 8.0
    relief_mm: float = 0.15

    def __post_init__(self) -> None:
        check_size(self.diameter_mm, "diameter_mm")
        check_size(self.relief_mm, "relief_mm")

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
class Screw:
    """A metric screw thread lying on its side, its axis along x.

    A V thread of the given pitch, flanks at 60 degrees (30 from the normal of the axis each), cut to five
    eighths of the sharp V's height as in ISO 68-1; the helix is that of the crest's cylinder.
    """

    major_diameter_mm: float = 8.0
    pitch_mm: float = 1.25
    length_mm: float = 12.0

    def __post_init__(self) -> None:
        check_size(self.major_diameter_mm, "major_diameter_mm")
        check_size(self.pitch_mm, "pitch_mm")
        check_size(self.length_mm, "length_mm")

    def face_mm(self, x_mm: NDArray[Any], y_mm: NDArray[Any]) -> NDArray[np.float64]:
        major = self.major_diameter_mm / 2
        turn = np.arcsin(np.clip(y_mm / major, -1, 1)) / (2 * np.pi)
        phase = np.abs((x_mm / self.pitch_mm - turn) % 1 - 0.5) * 2  # 0 at the crest, 1 in the groove
        sharp = np.sqrt(3) / 2 * self.pitch_mm
        radius = major - np.clip(phase * sharp - sharp / 8, 0, 0.625 * sharp)
        inside = radius**2 - y_mm**2
        there = (inside > 0) & (np.abs(x_mm) <= self.length_mm / 2)
        return np.where(there, np.sqrt(np.maximum(inside, 0)) - major, -np.inf)


def check_size(value: float, name: str) -> float:
    """Return a length in mm; one over a metre is a mistaken unit."""
    size = check_positive(value, name)
    if size > MAX_SIZE_MM:
        raise ValueError(
            f"Expected {name} in mm, at most {MAX_SIZE_MM:g}, got {value:g}. Is it in another unit?"
        )
    return size


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
