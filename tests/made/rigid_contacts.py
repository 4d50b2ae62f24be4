"""Contacts of a rigid body that is known exactly, at any pose, as a Reconstructor would give them, with errors or none."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from gelform.motion.between import moved, pose_of_step
from gelform.result import Reconstruction

SHAPE, MM_PER_PX = (120, 150), 0.08
DEPTH_MM = 0.5  # of the body's foremost point
BALL_MM = 4.0  # radius
CENTER = np.array([0.0, 0.0, DEPTH_MM])  # of the body's turns
Face = Callable[[np.ndarray, np.ndarray], np.ndarray]


def ball(x, y):
    return np.sqrt(np.maximum(BALL_MM**2 - x**2 - y**2, 1e-9)) - BALL_MM


def cylinder(x, y):
    """Its axis lies along x."""
    return np.sqrt(np.maximum(BALL_MM**2 - y**2, 1e-9)) - BALL_MM


def plate(x, y):
    return 0 * (x + y)


def texture(seed: int = 0) -> Face:
    """A plate with bumps in all directions, some tens of micrometers high."""
    rng = np.random.default_rng(seed)
    waves = rng.uniform(1.5, 4, (12, 2)) * rng.choice([-1, 1], (12, 2))
    phases, heights = rng.uniform(0, 2 * np.pi, 12), rng.uniform(0.01, 0.03, 12)
    return lambda x, y: sum(h * np.sin(a * x + b * y + p) for h, (a, b), p in zip(heights, waves, phases))


def pose(x=0.0, y=0.0, z=0.0, tilt_x=0.0, tilt_y=0.0, yaw=0.0) -> np.ndarray:
    """A motion (4, 4) about the body's foremost point: mm and degrees."""
    return pose_of_step(np.array([x, y, z, *np.radians([tilt_x, tilt_y, yaw])]), CENTER)


def contact_of(
    face: Face,
    motion: np.ndarray | None = None,
    *,
    seed: int | None = None,
    radius_mm: float = 3.2,
    stays: bool = False,
    **fields,
) -> Reconstruction:
    """What the gel shows of a body after a motion; with a seed, slopes have errors of 0.02, alike over 2 px.

    A ball touches where it lies deeper than 0.1 mm, another face within `radius_mm` of its moved middle, or of the sensor's
    if it `stays` there, as where a sensor slides over a plate. The maps go on beyond the contact.
    """
    motion = np.eye(4) if motion is None else motion
    height, width = SHAPE
    y, x = (np.mgrid[:height, :width] - np.array(SHAPE)[:, None, None] / 2 + 0.5) * MM_PER_PX
    depth, back = np.full(SHAPE, DEPTH_MM), np.linalg.inv(motion)
    for _ in range(15):
        body = moved(back, np.dstack([x, y, depth]))
        depth += 0.7 * (face(body[..., 0], body[..., 1]) + DEPTH_MM - body[..., 2])
    middle = CENTER if stays else moved(motion, CENTER)
    touched = depth > 0.1 if face is ball else np.hypot(x - middle[0], y - middle[1]) < radius_mm
    slopes = np.dstack(np.gradient(depth, MM_PER_PX)[::-1])
    if seed is not None:
        rng = np.random.default_rng(seed)
        noise = cv2.GaussianBlur(rng.normal(size=(*SHAPE, 2)), (0, 0), 2)
        slopes = slopes + 0.02 * noise / noise.std()
    maps = {
        "depth": depth.astype(np.float32),
        "depth_sigma_mm": np.full(SHAPE, 0.01, np.float32),
        "gradients": slopes.astype(np.float32),
        "gradients_sigma": np.full((*SHAPE, 2), 0.02, np.float32),
        "confidence": np.ones(SHAPE, np.float32),
        "contact": touched,
        "known": np.ones(SHAPE, bool),
        "mm_per_px": MM_PER_PX,
    }
    return Reconstruction(**{**maps, **fields})
