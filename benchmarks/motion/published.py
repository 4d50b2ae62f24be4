"""The published objective, written from its paper, on the same slopes: unit normals, unweighted, the depth by its mean.

Normalflow (Huang, Kaess, Yuan, IEEE RA-L 10, 2025): the normals of the first contact, turned, against those of the second
where the points move to; Gauss-Newton; z is the mean difference of heights afterwards. It states no covariance.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import map_coordinates

from gelform.motion.between import LEAST_SHARE, TouchedSurface, moved, pose_of_step
from gelform.result import Reconstruction

STEPS, LAST = 30, 1e-5


def published_pose(a: Reconstruction, b: Reconstruction, start: np.ndarray) -> np.ndarray | None:
    """The pose (4, 4) by this objective; None if less than a quarter of the contact is shared."""
    first, second = TouchedSurface(a), TouchedSurface(b)
    points, normals = first.points.astype(float), normals_of(first.slopes)
    pose = start.copy()
    for _ in range(STEPS):
        q, n = moved(pose, points), normals @ pose[:3, :3].T
        pixel = second.pixels_at(q).T[::-1]
        shared = sampled(second.contact.astype(float), pixel) > 0.5
        if shared.mean() < LEAST_SHARE:
            return None
        center = q[shared].mean(axis=0)
        q, n, pixel = q[shared], n[shared], pixel[:, shared]
        slopes = np.stack([sampled(second.gradients[..., k], pixel) for k in (0, 1)], axis=1)
        change = np.stack(
            [[sampled(along[..., k], pixel) for along in second.derivatives] for k in (0, 1)]
        ).transpose(2, 0, 1)
        length = np.sqrt(1 + np.sum(slopes**2, axis=1))[:, None, None]
        theirs = normals_of(slopes)
        # The change of a unit normal with the slopes, then with the place, then with the step.
        flat = np.zeros((len(q), 3, 2))
        flat[:, 0, 0] = flat[:, 1, 1] = -1
        of_slopes = (flat - theirs[:, :, None] * np.einsum("nij,ni->nj", flat, theirs)[:, None]) / length
        basis = np.eye(3)
        places = np.stack(
            [np.broadcast_to(e, q.shape) for e in basis] + [np.cross(e, q - center) for e in basis], 2
        )
        turns = np.stack([np.zeros_like(n)] * 3 + [np.cross(e, n) for e in basis], 2)
        rows = (of_slopes @ (change @ places[:, :2]) - turns).reshape(-1, 6)[:, [0, 1, 3, 4, 5]]
        step = np.zeros(6)
        step[[0, 1, 3, 4, 5]] = np.linalg.lstsq(rows, (n - theirs).ravel(), rcond=None)[0]
        step *= min(1, 0.5 / np.linalg.norm(step[:3]), 0.15 / max(np.linalg.norm(step[3:]), 1e-9))
        pose = pose_of_step(step, center) @ pose
        if np.abs(step).max() < LAST:
            break
    q = moved(pose, points)
    pixel = second.pixels_at(q).T[::-1]
    shared = sampled(second.contact.astype(float), pixel) > 0.5
    if shared.mean() < LEAST_SHARE:
        return None
    pose[2, 3] += np.mean(sampled(second.depth, pixel)[shared] - q[shared, 2])
    return pose


def normals_of(slopes: np.ndarray) -> np.ndarray:
    """Unit normals (N, 3) of slopes (N, 2)."""
    n = np.column_stack([-slopes, np.ones(len(slopes))]).astype(float)
    return n / np.linalg.norm(n, axis=1, keepdims=True)


def sampled(values: np.ndarray, pixel: np.ndarray) -> np.ndarray:
    """A map at rows and columns (2, N); 0 outside."""
    return map_coordinates(values, pixel, order=1)
