"""Three ways to integrate slopes that other packages use, and gelform does not.

Each is a function (gradients (H, W, 2), mm_per_px (x, y)) -> depth (H, W) in mm. `examples/02_why_least_squares.py`
shows the errors of each.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from gelform.depth.solvers.seam import divergence, edges_from_gradients


def depth_along_lines(gradients: NDArray[Any], mm_per_px: tuple[float, float]) -> NDArray[np.float32]:
    """Line integration: along the middle row and from there along columns, and the reverse; the mean of both.

    It is exact on exact slopes, but the errors of all pixels on the way add up, in streaks.
    """
    ex, ey = edges_from_gradients(np.asarray(gradients, dtype=np.float64))
    along_x = np.pad(np.cumsum(ex * mm_per_px[0], axis=1), ((0, 0), (1, 0)))
    along_y = np.pad(np.cumsum(ey * mm_per_px[1], axis=0), ((1, 0), (0, 0)))
    row, col = gradients.shape[0] // 2, gradients.shape[1] // 2
    rows_first = along_x[row] - along_x[row, col] + along_y - along_y[row]
    columns_first = along_y[:, col : col + 1] - along_y[row, col] + along_x - along_x[:, col : col + 1]
    depth = (rows_first + columns_first) / 2
    return np.asarray(depth - depth.mean(), dtype=np.float32)


def depth_periodic(gradients: NDArray[Any], mm_per_px: tuple[float, float]) -> NDArray[np.float32]:
    """Least squares by the Fourier transform: the left border meets the right one, the top meets the bottom.

    R. T. Frankot and R. Chellappa, A method for enforcing integrability in shape from shading algorithms, IEEE Trans.
    PAMI 10(4), 1988, eq. 21. It is exact to all orders if the surface is periodic.
    """
    g = np.asarray(gradients, dtype=np.float32)
    height, width = g.shape[:2]
    # At the highest frequency of an even size a sampled derivative contains no information.
    u = 2 * np.pi * np.fft.rfftfreq(width, mm_per_px[0])
    v = 2 * np.pi * np.fft.fftfreq(height, mm_per_px[1])[:, None]
    u = np.where(np.arange(u.size) * 2 == width, 0, u)
    v = np.where(np.arange(height)[:, None] * 2 == height, 0, v)
    square = u**2 + v**2
    inverse = np.divide(1, square, out=np.zeros_like(square), where=square > 0)
    spectrum = -1j * inverse * (u * scipy.fft.rfft2(g[..., 0]) + v * scipy.fft.rfft2(g[..., 1]))
    return np.asarray(scipy.fft.irfft2(spectrum, s=(height, width)), dtype=np.float32)


def depth_zero_border(gradients: NDArray[Any], mm_per_px: tuple[float, float]) -> NDArray[np.float32]:
    """Least squares by the sine transform: depth is 0 on the border of the frame.

    Many tactile packages assume this. If the border cuts a contact, depth there is not 0.
    """
    g = np.asarray(gradients, dtype=np.float32)
    depth = np.zeros(g.shape[:2], dtype=np.float32)
    if min(depth.shape) < 3:
        return depth
    rows, cols = (np.arange(1, n - 1) / (n - 1) for n in depth.shape)
    eigen_y = (2 * np.sin(np.pi * rows / 2) / mm_per_px[1]) ** 2
    eigen_x = (2 * np.sin(np.pi * cols / 2) / mm_per_px[0]) ** 2
    right = divergence(edges_from_gradients(g), mm_per_px)[1:-1, 1:-1]
    spectrum = scipy.fft.dstn(right, type=1) / (eigen_y[:, None] + eigen_x)
    depth[1:-1, 1:-1] = scipy.fft.idstn(spectrum, type=1)
    return depth
