"""Faces in closed form: cylinder, edge of a box, punch, pyramid, cone, torus; and raised text."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.simulate.indenters.faces import HeightMap, check_size

TEXT_PX = 48  # height of a capital letter in the map that text is made of


@dataclass(frozen=True)
class Cylinder:
    """A cylinder lying on its side, its axis along x."""

    radius_mm: float
    length_mm: float

    def __post_init__(self) -> None:
        check_size(self.radius_mm, "radius_mm")
        check_size(self.length_mm, "length_mm")

    def face_mm(self, x_mm: NDArray[Any], y_mm: NDArray[Any]) -> NDArray[np.float64]:
        inside = self.radius_mm**2 - y_mm**2
        there = (inside > 0) & (np.abs(x_mm) <= self.length_mm / 2)
        return np.where(there, np.sqrt(np.maximum(inside, 0)) - self.radius_mm, -np.inf)


@dataclass(frozen=True)
class BoxEdge:
    """A long edge of a box, along x: a roof whose two sides fall off alike.

    Attributes
    ----------
    length_mm : of the edge
    angle_deg : between the two sides, 90 for a box
    """

    length_mm: float
    angle_deg: float = 90.0

    def __post_init__(self) -> None:
        check_size(self.length_mm, "length_mm")
        check_angle(self.angle_deg, "angle_deg")

    def face_mm(self, x_mm: NDArray[Any], y_mm: NDArray[Any]) -> NDArray[np.float64]:
        fall = np.abs(y_mm) / np.tan(np.deg2rad(self.angle_deg) / 2)
        return np.where(np.abs(x_mm) <= self.length_mm / 2, -fall, -np.inf)


@dataclass(frozen=True)
class Punch:
    """A flat punch: a disc, or a rectangle where `width_mm` is given; its edge is sharp."""

    diameter_mm: float
    width_mm: float | None = None

    def __post_init__(self) -> None:
        check_size(self.diameter_mm, "diameter_mm")
        if self.width_mm is not None:
            check_size(self.width_mm, "width_mm")

    def face_mm(self, x_mm: NDArray[Any], y_mm: NDArray[Any]) -> NDArray[np.float64]:
        if self.width_mm is None:
            there = x_mm**2 + y_mm**2 <= (self.diameter_mm / 2) ** 2
        else:
            there = (np.abs(x_mm) <= self.diameter_mm / 2) & (np.abs(y_mm) <= self.width_mm / 2)
        return np.where(there, 0.0, -np.inf)


@dataclass(frozen=True)
class Pyramid:
    """A square pyramid, its point towards the camera.

    Attributes
    ----------
    base_mm : side of the base
    angle_deg : between opposite sides at the point
    """

    base_mm: float
    angle_deg: float = 120.0

    def __post_init__(self) -> None:
        check_size(self.base_mm, "base_mm")
        check_angle(self.angle_deg, "angle_deg")

    def face_mm(self, x_mm: NDArray[Any], y_mm: NDArray[Any]) -> NDArray[np.float64]:
        away = np.maximum(np.abs(x_mm), np.abs(y_mm))
        fall = away / np.tan(np.deg2rad(self.angle_deg) / 2)
        return np.where(away <= self.base_mm / 2, -fall, -np.inf)


@dataclass(frozen=True)
class Cone:
    """A cone, its point towards the camera.

    Attributes
    ----------
    diameter_mm : of the base
    angle_deg : the opening at the point
    """

    diameter_mm: float
    angle_deg: float = 120.0

    def __post_init__(self) -> None:
        check_size(self.diameter_mm, "diameter_mm")
        check_angle(self.angle_deg, "angle_deg")

    def face_mm(self, x_mm: NDArray[Any], y_mm: NDArray[Any]) -> NDArray[np.float64]:
        r = np.hypot(x_mm, y_mm)
        return np.where(r <= self.diameter_mm / 2, -r / np.tan(np.deg2rad(self.angle_deg) / 2), -np.inf)


@dataclass(frozen=True)
class Torus:
    """A ring lying flat.

    Attributes
    ----------
    ring_radius_mm : from the axis to the middle of the tube
    tube_radius_mm : of the tube
    """

    ring_radius_mm: float
    tube_radius_mm: float

    def __post_init__(self) -> None:
        check_size(self.ring_radius_mm, "ring_radius_mm")
        check_size(self.tube_radius_mm, "tube_radius_mm")

    def face_mm(self, x_mm: NDArray[Any], y_mm: NDArray[Any]) -> NDArray[np.float64]:
        inside = self.tube_radius_mm**2 - (np.hypot(x_mm, y_mm) - self.ring_radius_mm) ** 2
        return np.where(inside > 0, np.sqrt(np.maximum(inside, 0)) - self.tube_radius_mm, -np.inf)


def text_relief(text: str, *, height_mm: float, relief_mm: float = 0.3) -> HeightMap:
    """Raised letters on a plate, as on a stamp that reads right in the image.

    Parameters
    ----------
    text : printable ASCII
    height_mm : of a capital letter
    relief_mm : how far the letters stand over the plate

    Raises
    ------
    ValueError
        Text that is empty or holds a character that the font has not.
    """
    if not text.strip() or not all(32 <= ord(letter) < 127 for letter in text):
        raise ValueError(f"Expected text of printable ASCII letters, got {text!r}.")
    check_size(height_mm, "height_mm")
    check_size(relief_mm, "relief_mm")
    font, thickness = cv2.FONT_HERSHEY_SIMPLEX, 6
    scale = TEXT_PX / 22.0  # this font's capitals are 22 px high at scale 1
    (width, height), below = cv2.getTextSize(text, font, scale, thickness)
    border = TEXT_PX // 2
    drawing = np.zeros((height + below + 2 * border, width + 2 * border), dtype=np.uint8)
    cv2.putText(drawing, text, (border, border + height), font, scale, 255, thickness, cv2.LINE_AA)
    heights = cv2.GaussianBlur(drawing.astype(np.float64), (0, 0), 1.5) * (relief_mm / 255)
    return HeightMap(heights - heights.max(), height_mm / TEXT_PX)


def check_angle(value: float, name: str) -> float:
    """Return an opening angle in degrees, more than 0 and less than 180."""
    if not 0 < value < 180:
        raise ValueError(f"Expected {name} in 0-180 degrees (both excluded), got {value}.")
    return float(value)
