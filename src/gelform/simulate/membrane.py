"""A membrane on an elastic bed over an obstacle: projected successive over-relaxation, coarse to fine."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from gelform.errors import ConvergenceError

TOLERANCE = 1e-5  # of the deepest point
MAX_SWEEPS = 5000


def membrane_over(obstacle: NDArray[Any], *, relaxation_px: float) -> NDArray[np.float64]:
    """The surface of least energy over an obstacle; no force across the border.

    Solves `u >= g`, `4 u - sum of neighbours + u/L^2 >= 0`, one of the two an equality at every sample.

    Parameters
    ----------
    obstacle : (H, W), >= 0
    relaxation_px : float
        The length L in samples.

    Returns
    -------
    surface : (H, W) float64, the obstacle itself bit for bit where they touch

    Raises
    ------
    ConvergenceError
        The sweeps did not settle.

    Notes
    -----
    C. W. Cryer, The solution of a quadratic programming problem using systematic overrelaxation,
    SIAM J. Control 9(3), 1971. The relaxation factor is D. M. Young's for the five-point operator.
    """
    start = _coarse_guess(obstacle, relaxation_px)
    surface = np.pad(np.maximum(start, obstacle), 1, mode="edge")
    spring = relaxation_px**-2
    jacobi = 4 / (4 + spring)
    omega = 2 / (1 + np.sqrt(1 - jacobi**2))
    target = TOLERANCE * (2 - omega) * max(float(obstacle.max()), 1e-12)
    change = _sweep_until(
        surface, np.ascontiguousarray(obstacle, dtype=np.float64), spring, omega, target, MAX_SWEEPS
    )
    if not change <= target:
        raise ConvergenceError(
            f"The gel's surface did not settle in {MAX_SWEEPS} sweeps (change {change:.3g}). "
            f"Its relaxation length is {relaxation_px:.3g} samples: simulate with a smaller oversample."
        )
    return surface[1:-1, 1:-1].copy()


def _coarse_guess(obstacle: NDArray[Any], relaxation_px: float) -> NDArray[np.float64]:
    """The solution on a grid of half the resolution, brought to this one."""
    if relaxation_px < 2 or min(obstacle.shape) < 8:
        return np.zeros(obstacle.shape)
    height, width = obstacle.shape
    even = np.pad(obstacle, ((0, height % 2), (0, width % 2)), mode="edge")
    halved = even.reshape(even.shape[0] // 2, 2, even.shape[1] // 2, 2).max(axis=(1, 3))
    coarse = membrane_over(halved, relaxation_px=relaxation_px / 2)
    fine = cv2.resize(coarse, even.shape[::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(fine[:height, :width], dtype=np.float64)


@njit(cache=True)  # type: ignore[untyped-decorator]
def _sweep_until(u: Any, obstacle: Any, spring: float, omega: float, target: float, max_sweeps: int) -> float:
    """Sweep in place over the ghost-bordered u until its largest change is small; returns that change."""
    height, width = obstacle.shape
    factor = omega / (4 + spring)
    change = np.inf
    for _ in range(max_sweeps):
        u[0, :], u[-1, :] = u[1, :], u[-2, :]
        u[:, 0], u[:, -1] = u[:, 1], u[:, -2]
        change = 0.0
        for i in range(height):
            for j in range(width):
                old = u[i + 1, j + 1]
                total = u[i, j + 1] + u[i + 2, j + 1] + u[i + 1, j] + u[i + 1, j + 2]
                new = max((1 - omega) * old + factor * total, obstacle[i, j])
                u[i + 1, j + 1] = new
                change = max(change, abs(new - old))
        if change <= target:
            break
    return change
