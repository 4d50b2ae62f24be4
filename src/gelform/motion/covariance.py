"""The covariance of a pose: of errors that neighbors share, and of those that residuals cannot show.

No plain estimator is honest here, because errors of slopes are alike over many pixels and partly the same in both frames.
C = F S F + R D R' + p p' + (f d)^2 E: S from the sums of 16 px blocks (a sandwich), F and D factors that were
chosen on measured contacts (docs/motion-derivation.md), R the pose's response to slopes that are off everywhere, p the pull
of errors that stay at their place while the object moves a little, f d the error of a place on the sensor, in proportion to
the displacement; E = 1 for x and y, and for turns less, over the contact's radius, because the error changes along it.
"""

from __future__ import annotations

import numpy as np

from gelform.motion.rigid import Array, moved
from gelform.motion.surface import MOVED_PX, Equations, TouchedSurface

BLOCK_PX = 16  # px, side of the blocks whose errors count as independent
FACTORS = np.array([1, 1, 5.5, 2.8, 2.8, 1])  # of the sandwich's standard deviations: x, y, z, tilts, yaw
OFFSET, GAIN = 0.003, 0.02  # mm/mm, and of a slope: standard deviations of what all slopes have in common
# Of the error of a place, by which the ends of a contact err against each other, along it (tilts) and across it (yaw): the
# latter on pairs of a cube's edge.
PLACE_TILT, PLACE_YAW = 0.25, 0.7


def pose_covariance(surface: TouchedSurface, equations: Equations, inverse: Array, place_mm: float) -> Array:
    """Covariance (6, 6) of a step, from the equations at the best pose and the inverse (6, 6) of their information."""
    weighted = equations.jacobian * equations.weight[..., None]
    scores = np.einsum("nki,nk->ni", weighted, equations.residual)
    row, col = surface.pixels.T // BLOCK_PX
    block = row * (int(col.max()) + 1) + col
    sums = np.stack([np.bincount(block, of) for of in scores.T], axis=1)
    count = int(np.count_nonzero(np.bincount(block, equations.shared)))
    sandwich = inverse @ (sums.T @ sums) @ inverse * count / max(count - 6, 1)
    # Slopes off by a constant, and too steep by a factor, along x and along y; and the pull of what stays.
    common = [np.stack([np.ones_like(of), of]) @ weighted[:, k] for k, of in enumerate(surface.slopes.T)]
    response = inverse @ np.vstack([*common, _pull(surface, equations)]).T
    covariance = sandwich * np.outer(FACTORS, FACTORS)
    covariance += (response * np.square([OFFSET, GAIN, OFFSET, GAIN, 1])) @ response.T
    covariance += np.diag(np.square(place_mm * surface.scale * (1, 1, 0, PLACE_TILT, PLACE_TILT, PLACE_YAW)))
    return np.asarray(covariance, dtype=np.float64)


def _pull(surface: TouchedSurface, equations: Equations) -> Array:
    """The right side (6,) that draws the object back to where it was: errors that stay match best without a motion.

    They are taken to be as large as those that changed: s, the RMS of the slopes' residuals. With errors alike as
    exp(-d^2 / 2 l^2), l = 3 px, a point that moved by d is drawn back by d exp(-d^2 / 2 l^2) (s / l)^2.
    """
    weights, alike_mm = equations.weight[:, :2], MOVED_PX * surface.pitch
    variance = np.sum(weights * np.square(equations.residual[:, :2])) / np.sum(weights)
    there = moved(equations.pose, surface.points)
    shift = (there - surface.points)[:, :2] / alike_mm
    share = (weights[:, 0] + weights[:, 1]) * np.exp(-np.einsum("nk,nk->n", shift, shift) / 2)
    drawn = share[:, None] * shift * (variance / alike_mm)
    x, y = np.ones(len(drawn)) @ drawn
    lever = (there - equations.center).T @ drawn
    return np.array([x, y, 0, -lever[2, 1], lever[2, 0], lever[0, 1] - lever[1, 0]])
