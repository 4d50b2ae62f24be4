"""The covariance of a pose: of errors that neighbors share, of slopes wrong everywhere alike, and of the place.

No plain estimator is honest here, because errors of slopes are alike over many pixels and partly the same in both frames.
C = F S F + R D R' + (f d)^2 on x and y: S from the sums of 16 px blocks (a sandwich), F and D factors that were chosen on
simulated and real contacts (docs/motion.md), R the pose's response to slopes that are off everywhere, f d the error of a
place on the sensor, in proportion to the displacement.
"""

from __future__ import annotations

import numpy as np

from gelform.motion.rigid import Array
from gelform.motion.surface import Equations, TouchedSurface

BLOCK_PX = 16  # px, side of the blocks whose errors count as independent
FACTORS = np.array([1, 1, 5.5, 2.8, 2.8, 1])  # of the sandwich's standard deviations: x, y, z, tilts, yaw
OFFSET, GAIN = 0.003, 0.02  # mm/mm, and of a slope: standard deviations of what all slopes have in common


def pose_covariance(surface: TouchedSurface, equations: Equations, seen: Array, place_mm: float) -> Array:
    """Covariance (6, 6) of a step, from the equations at the best pose; `seen` (6, k): where it was fitted."""
    inverse = seen @ np.linalg.inv(seen.T @ equations.information @ seen) @ seen.T
    weighted = equations.jacobian * equations.weight[..., None]
    scores = np.einsum("nki,nk->ni", weighted, equations.residual)
    row, col = surface.pixels.T // BLOCK_PX
    block = row * (int(col.max()) + 1) + col
    sums = np.stack([np.bincount(block, of) for of in scores.T], axis=1)
    count = int(np.count_nonzero(np.bincount(block, equations.shared)))
    sandwich = inverse @ (sums.T @ sums) @ inverse * count / max(count - 6, 1)
    # Slopes off by a constant, and too steep by a factor, along x and along y.
    common = [
        np.stack([np.ones_like(slope), slope]) @ weighted[:, k] for k, slope in enumerate(surface.slopes.T)
    ]
    response = inverse @ np.concatenate(common).T
    covariance = sandwich * np.outer(FACTORS, FACTORS)
    covariance += (response * np.square([OFFSET, GAIN, OFFSET, GAIN])) @ response.T
    covariance[[0, 1], [0, 1]] += place_mm**2
    return np.asarray(covariance, dtype=np.float64)
