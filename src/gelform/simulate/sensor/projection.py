"""Which point of the gel each pixel looks at: pinhole, distortion, and the surface's own height."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.simulate.sensor.sensor import SimulatedSensor

Maps = tuple[NDArray[np.float32], NDArray[np.float32]]


def maps_from_depth(sensor: SimulatedSensor, depth_mm: NDArray[Any]) -> Maps | None:
    """Where on the gel's grid each pixel looks, x and y (H, W) in pixels; None: each at its own place.

    A pinhole at height H over the middle sees the surface point at x (1 - z/H) where the plane's point x
    would be. It is found by two fixed-point steps, enough for depths of a tenth of H.
    """
    optics = sensor.optics
    if optics.is_plain:
        return None
    x, y = _undistorted(sensor)
    height, width = sensor.shape
    if optics.height_mm is None:
        return x, y
    cx, cy = np.float32((width - 1) / 2), np.float32((height - 1) / 2)
    depth = depth_mm.astype(np.float32)
    at_x, at_y = x, y
    for _ in range(2):
        z = cv2.remap(depth, at_x, at_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)
        scale = 1 - z / np.float32(optics.height_mm)
        at_x, at_y = cx + (x - cx) * scale, cy + (y - cy) * scale
    return at_x, at_y


def px_seen(sensor: SimulatedSensor, points_mm: NDArray[Any], depth_mm: float = 0.0) -> NDArray[np.float64]:
    """Pixels (N, 2) at which the camera sees points (N, 2) of the gel at one depth, mm from its centre."""
    points = np.asarray(points_mm, dtype=np.float64).reshape(-1, 2)
    if sensor.optics.height_mm is not None:
        points = points / (1 - depth_mm / sensor.optics.height_mm)
    diagonal = np.hypot(*sensor.shape) / 2 * sensor.mm_per_px
    k1, k2 = sensor.optics.distortion
    square = np.sum(points**2, axis=1, keepdims=True) / diagonal**2
    seen = points * (1 + k1 * square + k2 * square**2) / sensor.mm_per_px
    height, width = sensor.shape
    return np.asarray(seen + np.array([(width - 1) / 2, (height - 1) / 2]), dtype=np.float64)


@lru_cache(maxsize=8)
def _undistorted(sensor: SimulatedSensor) -> Maps:
    """Where on the plane each pixel looks, by Newton's method on the radius."""
    height, width = sensor.shape
    half = np.hypot(height, width) / 2
    x, y = np.meshgrid(np.arange(width) - (width - 1) / 2, np.arange(height) - (height - 1) / 2)
    seen = np.hypot(x, y) / half
    k1, k2 = sensor.optics.distortion
    r = seen.copy()
    for _ in range(8):
        r -= (r * (1 + k1 * r**2 + k2 * r**4) - seen) / (1 + 3 * k1 * r**2 + 5 * k2 * r**4)
    scale = r / np.maximum(seen, 1e-12)
    scale[seen < 1e-9] = 1
    at_x, at_y = (width - 1) / 2 + x * scale, (height - 1) / 2 + y * scale
    return at_x.astype(np.float32), at_y.astype(np.float32)
