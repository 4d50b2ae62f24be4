"""Rigid motions (4, 4) in mm, and small steps (shift x, y, z in mm; turn about x, y, z in rad) about a center.

The axes are those of a depth map: x to the right, y down, z toward the camera; (0, 0, 0) is the image's middle on the gel
at rest. A positive turn about z leads from x to y, clockwise in the image.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.foundations.checks import check_values

Array = NDArray[Any]  # of numbers, whatever their precision
ORTHONORMAL = 1e-6  # largest entry of R'R - 1 of a rotation, and error of the last row


def pose_of_step(step: Array, center: Array) -> Array:
    """The motion (4, 4) that turns by step[3:] about the center, then shifts by step[:3]."""
    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(np.asarray(step[3:], np.float64))[0]
    pose[:3, 3] = center + step[:3] - pose[:3, :3] @ center
    return pose


def step_of_pose(pose: Array, center: Array) -> Array:
    """The step (6,) about a center that is a motion (4, 4); the inverse of `pose_of_step`."""
    return np.concatenate([moved(pose, center) - center, cv2.Rodrigues(pose[:3, :3])[0].ravel()])


def moved(pose: Array, points: Array) -> Array:
    """Points (..., 3) after a motion."""
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3], dtype=np.float64)


def about_other_center(offset: Array) -> Array:
    """The matrix (6, 6) that makes a step about a center one about another, which is `offset` (3,) away."""
    x, y, z = offset
    change = np.eye(6)
    change[:3, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]  # turn x offset
    return change


def turn_deg(pose: Array) -> float:
    """The angle of a motion's rotation, degrees."""
    return float(np.degrees(np.linalg.norm(cv2.Rodrigues(pose[:3, :3])[0])))


def checked_pose(pose: ArrayLike, name: str) -> Array:
    """A rigid motion (4, 4); ValueError or TypeError for anything else."""
    matrix: Array = np.asarray(check_values(pose, name), dtype=np.float64)
    wrong = matrix.shape != (4, 4) or np.abs(matrix[3] - (0, 0, 0, 1)).max() > ORTHONORMAL
    turn = np.zeros((3, 3)) if wrong else matrix[:3, :3]
    if np.abs(turn.T @ turn - np.eye(3)).max() > ORTHONORMAL or np.linalg.det(turn) < 0:
        raise ValueError(
            f"Expected {name} as a rigid motion (4, 4): a rotation, a shift in mm and 0, 0, 0, 1."
        )
    return matrix
