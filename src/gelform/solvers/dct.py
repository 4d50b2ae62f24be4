"""Exact uniform least squares with a free border, by the cosine transform.

Each edge between two neighbouring pixels says that their difference of depth is the pixel pitch times the
mean of their two slopes (trapezoid rule). The normal equations are a Poisson equation with a free border,
diagonal under the DCT-II with eigenvalues 4 sin^2(pi k/2W)/hx^2 + 4 sin^2(pi l/2H)/hy^2, k and l from 0
(Strang, The discrete cosine transform, SIAM Review 41, 1999).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dctn, idctn


class DctSolver:
    """Prepared once for a shape and pitch; gives zero-mean depth for frames singly or as a stack."""

    def __init__(self, shape: tuple[int, int], mm_per_px: tuple[float, float]) -> None:
        height, width = shape
        self.shape = shape
        self.mm_per_px = mm_per_px
        hx, hy = mm_per_px
        eigen_x = (2 * np.sin(np.pi * np.arange(width) / (2 * width)) / hx) ** 2
        eigen_y = (2 * np.sin(np.pi * np.arange(height) / (2 * height)) / hy) ** 2
        eigen = eigen_y[:, None] + eigen_x[None, :]
        eigen[0, 0] = np.inf
        self._inverse = (1 / eigen).astype(np.float32)

    def __call__(self, gradients: NDArray[Any]) -> NDArray[np.float32]:
        """Depth (..., H, W) in mm, mean 0, of gradients (..., H, W, 2)."""
        hx, hy = self.mm_per_px
        p, q = gradients[..., 0], gradients[..., 1]
        divergence = np.zeros(p.shape, dtype=np.float32)
        edge_x = (p[..., :, 1:] + p[..., :, :-1]) * np.float32(0.5 / hx)
        edge_y = (q[..., 1:, :] + q[..., :-1, :]) * np.float32(0.5 / hy)
        divergence[..., :, :-1] -= edge_x
        divergence[..., :, 1:] += edge_x
        divergence[..., :-1, :] -= edge_y
        divergence[..., 1:, :] += edge_y
        spectrum = dctn(divergence, axes=(-2, -1), norm="ortho", overwrite_x=True)
        spectrum *= self._inverse
        depth: NDArray[np.float32] = idctn(spectrum, axes=(-2, -1), norm="ortho", overwrite_x=True)
        return depth
