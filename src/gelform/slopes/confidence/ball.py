"""Slopes that a frame itself shows to be read right: those of a ball, from its top to where the gel leaves it.

A model that reads steep slopes too small bends what is straight: the first two components of a ball's normals are linear in
the place. The gentle part around the top tells the ball, and how far the readings follow it tells which slopes are right.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

REACH = 1 / 3  # of the image's shorter side, half the side of the square around the top that is looked at
LEAST_PX = 4  # px, radius of the gentle part; less says nothing of its shape
# RMS of a ball's normals off the fit over their own: .26 at most on presses of four sensors, from .6 on a cube's edge.
BALL_LIKE = 0.35
GEL_RADII = (
    2.0  # radii of the followed part; beyond, gel that hangs from the ball is gentle, or of something else
)
FOLLOWED = 0.85  # of the ball's slope that a ring reads; the same share is usual at the edge of contacts of the own unit


class ShownBall(NamedTuple):
    """Center and radius, px, of the disc that a ball and its gel fill, and the slope up to which the ball is followed."""

    ball_x: float
    ball_y: float
    ball_radius: float
    of_ball: float


NO_BALL = ShownBall(0.0, 0.0, 0.0, 0.0)


def slopes_of_ball(gradients: NDArray[np.float32], top: tuple[int, int], gentle: float) -> ShownBall | None:
    """How far gradients (H, W, 2) follow a ball around its top (row, column); None where they show none.

    `gentle` is the slope up to which they are trusted.
    """
    reach = int(REACH * min(gradients.shape[:2]))
    rows, columns = (slice(max(at - reach, 0), at + reach + 1) for at in top)
    gradients = gradients[rows, columns]
    y, x = (
        np.arange(n, dtype=np.float32) - (at - part.start)
        for n, at, part in zip(gradients.shape, top, (rows, columns))
    )
    squares = np.einsum("...i,...i", gradients, gradients)
    ring = np.hypot(y[:, None], x).astype(np.intp)
    steep = np.flatnonzero(_mean(np.sqrt(squares), ring) >= gentle)
    if not steep.size or steep[0] < LEAST_PX:
        return None
    inner = ring < steep[0]
    normals = -gradients / np.sqrt(1 + squares)[..., None]
    place = np.argwhere(inner)[:, ::-1] - np.array([top[1] - columns.start, top[0] - rows.start])
    turned = normals[inner]
    away, off = place - place.mean(axis=0), turned - turned.mean(axis=0)
    per_px = float(np.sum(away * off) / np.sum(np.square(away)))
    if per_px <= 0 or np.sum(np.square(off - per_px * away)) > BALL_LIKE**2 * np.sum(np.square(off)):
        return None
    center = place.mean(axis=0) - turned.mean(axis=0) / per_px
    v, u = y[:, None] - center[1], x - center[0]
    from_center = np.hypot(v, u)
    ring = from_center.astype(np.intp)
    outward = (normals[..., 0] * u + normals[..., 1] * v) / np.maximum(from_center, 1)
    share = _mean(outward, ring) / np.maximum(_mean(from_center, ring) * per_px, 1e-6)
    begin, end = steep[0] // 2, int(FOLLOWED / per_px)  # farther out a ball's slope grows without bound
    lost = np.flatnonzero(share[begin:end] < FOLLOWED)
    radius = float(begin + lost[0] if lost.size else min(end, len(share)))
    sine = per_px * radius
    slope = float(sine / np.sqrt(1 - sine**2))
    x_px, y_px = float(top[1] + center[0]), float(top[0] + center[1])
    return ShownBall(x_px, y_px, GEL_RADII * radius, max(slope, gentle))


def _mean(values: NDArray[np.float32], ring: NDArray[np.intp]) -> NDArray[np.float64]:
    """The mean of each ring."""
    rings = ring.ravel()
    return np.asarray(np.bincount(rings, values.ravel()) / np.maximum(np.bincount(rings), 1))
