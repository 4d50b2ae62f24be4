"""Distortion and perspective of a camera over a plane: from the rectified plane to the frame, and back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)  # homography, row by row
# Rounds of Newton's method at most; it ends with a smaller step, px.
UNDISTORTION_ROUNDS, UNDISTORTED_PX = 40, 1e-9
DIFFERENCE_PX = 1e-3  # px, step of central differences: far above rounding, far below a lens's curvature
LEAST_AREA = 1e-3  # px^2 per px^2; the map is folded where it changes area by less, and has no inverse there
KEYS = ("camera", "distortion", "perspective")


@dataclass(frozen=True)
class Lens:
    """A pinhole camera with Brown's distortion that views a plane from any side.

    Attributes
    ----------
    camera : (fx, fy, cx, cy), px
    distortion : (k1, k2, p1, p2, k3), in the order of OpenCV; missing ones at the end are 0
        Source: D. C. Brown, Photogrammetric Engineering 32(3), 1966.
    perspective : 9 numbers, row by row
        Homography from rectified pixels to the pixels of the undistorted frame; identity by default.

    Raises
    ------
    ValueError
        Another count of numbers, a number that is not finite, a focal length <= 0, or a singular perspective.
    """

    camera: tuple[float, ...]
    distortion: tuple[float, ...] = ()
    perspective: tuple[float, ...] = IDENTITY

    def __post_init__(self) -> None:
        for name, low, high in (("camera", 4, 4), ("distortion", 0, 5), ("perspective", 9, 9)):
            values = _numbers(getattr(self, name), name)
            if not low <= len(values) <= high:
                wanted = f"{low}" if low == high else f"up to {high}"
                raise ValueError(f"Expected the lens's {name} as {wanted} numbers, got {len(values)}.")
            object.__setattr__(self, name, values)
        if min(self.camera[:2]) <= 0:
            raise ValueError(f"Expected focal lengths > 0 px, got {self.camera[:2]}.")
        # Of rows of any length: a homography in px has rows of 1, 1000 and 1e-6.
        lengths = np.prod(np.linalg.norm(self._homography, axis=1))
        if not abs(np.linalg.det(self._homography)) > 1e-12 * lengths:
            raise ValueError(
                f"Expected a perspective that can be undone, got a singular one: {self.perspective}."
            )

    @property
    def _homography(self) -> NDArray[np.float64]:
        return np.asarray(self.perspective, dtype=np.float64).reshape(3, 3)

    def frame_px_from_rectified_px(self, points_px: NDArray[Any]) -> NDArray[np.float64]:
        """Positions (N, 2), x and y, in the frame of points of the rectified plane."""
        flat = cv2.perspectiveTransform(np.asarray(points_px, dtype=np.float64)[None], self._homography)[0]
        return self._distorted(flat)

    def _distorted(self, flat: NDArray[np.float64]) -> NDArray[np.float64]:
        """Positions in the frame of points of the undistorted frame."""
        fx, fy, cx, cy = self.camera
        k1, k2, p1, p2, k3 = (*self.distortion, *[0.0] * (5 - len(self.distortion)))
        x, y = (flat[:, 0] - cx) / fx, (flat[:, 1] - cy) / fy
        square = x * x + y * y
        radial = 1 + square * (k1 + square * (k2 + square * k3))
        return np.stack(
            [
                fx * (x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x)) + cx,
                fy * (y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y) + cy,
            ],
            axis=1,
        )

    def rectified_px_from_frame_px(self, points_px: NDArray[Any]) -> NDArray[np.float64]:
        """Positions (N, 2) in the rectified plane of points of the frame: the inverse of `frame_px_from_rectified_px`."""
        flat = self._undistorted(np.asarray(points_px, dtype=np.float64))
        back = cv2.perspectiveTransform(flat[None], np.linalg.inv(self._homography))
        return np.asarray(back[0], dtype=np.float64)

    def _undistorted(self, distorted: NDArray[np.float64]) -> NDArray[np.float64]:
        """The inverse of `_distorted`, by Newton's method: from the given point it approaches the answer from one side."""
        flat = distorted.copy()
        for _ in range(UNDISTORTION_ROUNDS):
            xx, yx, xy, yy = self._distortion_slopes(flat)
            excess_x, excess_y = (self._distorted(flat) - distorted).T
            area = np.maximum(xx * yy - xy * yx, LEAST_AREA)
            step = (
                np.stack([yy * excess_x - xy * excess_y, xx * excess_y - yx * excess_x], axis=1)
                / area[:, None]
            )
            flat -= np.clip(step, -min(self.camera[:2]), min(self.camera[:2]))
            if np.abs(step).max(initial=0) < UNDISTORTED_PX:
                break
        return flat

    def _distortion_slopes(self, flat: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
        """The derivatives dx/dx, dy/dx, dx/dy, dy/dy of `_distorted`, by central differences."""
        along_x, along_y = np.array([DIFFERENCE_PX, 0.0]), np.array([0.0, DIFFERENCE_PX])
        by_x = (self._distorted(flat + along_x) - self._distorted(flat - along_x)) / (2 * DIFFERENCE_PX)
        by_y = (self._distorted(flat + along_y) - self._distorted(flat - along_y)) / (2 * DIFFERENCE_PX)
        return by_x[:, 0], by_x[:, 1], by_y[:, 0], by_y[:, 1]

    def to_dict(self) -> dict[str, list[float]]:
        """The settings, as values that JSON and TOML can hold."""
        return {name: list(getattr(self, name)) for name in KEYS}

    @classmethod
    def from_dict(cls, settings: Mapping[str, Any]) -> Lens:
        """A lens from `to_dict` or the `[view.lens]` table of a `sensor.toml`; an unknown key is a ValueError."""
        if not isinstance(settings, Mapping):
            raise ValueError(f"Expected a lens as a table of {', '.join(KEYS)}, got {settings!r}.")
        unknown = [name for name in settings if name not in KEYS]
        if unknown or "camera" not in settings:
            raise ValueError(
                f"Expected settings of a lens among {', '.join(KEYS)} (camera is needed), got {', '.join(settings)}."
            )
        return cls(**{name: _numbers(value, name) for name, value in settings.items()})


def _numbers(values: Any, name: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(value) for value in values)
    except (TypeError, ValueError):
        raise ValueError(f"Expected the lens's {name} as numbers, got {values!r}.") from None
    if not all(np.isfinite(numbers)):
        raise ValueError(f"Expected the lens's {name} as finite numbers, got {values!r}.")
    return numbers
