"""How far poses are off, and how often within their sigma."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from gelform.motion.between import Motion, about_other_center


def sigma_at(motion: Motion, point: np.ndarray) -> np.ndarray:
    """Covariance (6, 6) of a motion about a point (3,) of the second frame."""
    change = about_other_center(point - motion.center_mm)
    return change @ motion.covariance @ change.T


def yaw_of(pose: np.ndarray) -> float:
    """The turn of a pose in the image, rad."""
    return float(np.arctan2(pose[1, 0], pose[0, 0]))


def pose_at(x: float, y: float, z: float, yaw: float, point: np.ndarray) -> np.ndarray:
    """The pose that turns by a yaw about a point, then shifts."""
    c, s = np.cos(yaw), np.sin(yaw)
    pose = np.eye(4)
    pose[:2, :2] = [[c, -s], [s, c]]
    pose[:3, 3] = point + np.array([x, y, z]) - pose[:3, :3] @ point
    return pose


def two(values: Any, factor: float = 1.0) -> list[float]:
    """Median and 95 % quantile of absolute values."""
    return [factor * float(one) for one in np.quantile(np.abs(values), [0.5, 0.95])] if len(values) else []


def within(ratios: Any) -> list[float]:
    """Percent of errors over sigma below 1 and below 2."""
    return [float(100 * np.mean(np.abs(ratios) < k)) for k in (1, 2)] if len(ratios) else []


def timed(call: Callable[[], Any], clock: Callable[[], float], times: int) -> float:
    """Milliseconds of a call, the median of several."""
    found = []
    for _ in range(times):
        began = clock()
        call()
        found.append(1e3 * (clock() - began))
    return float(np.median(found))
