"""Least squares with depth 0 on the frame's border, by the sine transform.

The assumption of many tactile packages. Where a contact is cut by the border, depth there is not 0, and the
whole frame pays: 90 um on a cut ball.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy  # its parts load at first use: a weighted solve needs none of them
from numpy.typing import NDArray

from gelform.solvers.edges import divergence, edges_from_gradients


class DstSolver:
    """Prepared once for a shape and a pitch; for frames singly or as a stack."""

    def __init__(self, shape: tuple[int, int], mm_per_px: tuple[float, float]) -> None:
        self.shape = shape
        self.mm_per_px = mm_per_px
        rows, cols = (np.arange(1, n - 1) / (n - 1) if n > 2 else np.zeros(0) for n in shape)
        eigen_y = (2 * np.sin(np.pi * rows / 2) / mm_per_px[1]) ** 2
        eigen_x = (2 * np.sin(np.pi * cols / 2) / mm_per_px[0]) ** 2
        self._inverse = (1 / (eigen_y[:, None] + eigen_x)).astype(np.float32)

    def __call__(self, gradients: NDArray[Any]) -> NDArray[np.float32]:
        """Depth (..., H, W) in mm, 0 on the border and of mean not 0, of gradients (..., H, W, 2)."""
        g = np.asarray(gradients, dtype=np.float32)
        depth = np.zeros(g.shape[:-1], dtype=np.float32)
        if min(self.shape) > 2:
            right = divergence(edges_from_gradients(g), self.mm_per_px)[..., 1:-1, 1:-1]
            spectrum = scipy.fft.dstn(right, type=1, axes=(-2, -1)) * self._inverse
            depth[..., 1:-1, 1:-1] = scipy.fft.idstn(spectrum, type=1, axes=(-2, -1))
        return depth
