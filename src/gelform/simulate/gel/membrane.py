"""A membrane on an elastic bed over an obstacle: projected multigrid, coarse to fine."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import scipy  # its parts load at first use
from numpy.typing import NDArray

from gelform._native import Handle, Kernel
from gelform.errors import ConvergenceError

TOLERANCE = 1e-5  # largest change by a cycle over the deepest point: 5 nm for a press 0.5 mm deep
MAX_CYCLES = 100  # V-cycles before a solution fails
Map = NDArray[np.float64]

_membrane_cycles = Kernel(
    "membrane_cycles",
    "membrane* grids, out f64[gh,gw] u, out f64[gh,gw] before, f64[h,w] lowest, out bool[h,w] may_move, "
    "out f64[1] change, f64 spring, f64 target, i32 cycles",
)


def membrane_over(
    obstacle: NDArray[Any], *, relaxation_px: float, bulge: float = 0.0, bulge_px: float = 1.0
) -> tuple[Map, Map]:
    """The membrane w of least energy over an obstacle and the bulge b of its gel; no force across the border.

    Solves `w >= g + b`, `4 w - sum of neighbors + w/L^2 >= 0`, one of the two an equality at every sample. b is
    `bulge` times w spread over the length `bulge_px` by the kernel K0(r/h)/(2 pi h^2), whose integral is 1:
    `b - h^2 laplace(b) = bulge w`. The surface is w - b: the obstacle where they touch, and its volume over the
    whole grid is (1 - bulge) times that of w.

    Parameters
    ----------
    obstacle : (H, W), g; below 0 where the gel would be touched only if it rises
    relaxation_px, bulge_px : the lengths L and h in samples
    bulge : 0 (compressible) to 1 (incompressible), 1 excluded

    Returns
    -------
    membrane, bulge : (H, W) float64 each; without a bulge the obstacle itself bit for bit where they touch

    Raises
    ------
    ConvergenceError
        The cycles did not converge.

    Notes
    -----
    R. Kornhuber, Monotone multigrid methods for elliptic variational inequalities I, Numer. Math. 69, 1994,
    truncated: coarse grids correct only samples without contact. The smoother is C. W. Cryer's projected
    relaxation (SIAM J. Control 9(3), 1971), red-black.
    """
    g = np.ascontiguousarray(obstacle, dtype=np.float64)
    return _solved(g, relaxation_px, bulge=bulge, bulge_px=bulge_px)


class _Grids:
    """The grids of a multigrid solution, from the finest to one on which relaxation alone is fast."""

    def __init__(self, shape: tuple[int, ...], relaxation_px: float) -> None:
        height, width = shape
        self._handle = Handle("membrane", height, width)
        self._spring = relaxation_px**-2  # the bed's stiffness for a sample
        self._ghosted = np.zeros((height + 2, width + 2))  # the surface, with a border that the kernel fills
        self._before = np.empty_like(self._ghosted)
        self._change = np.zeros(1)
        self.u = self._ghosted[1:-1, 1:-1]
        self.lowest = np.full(shape, -np.inf)
        self.free = np.ones(shape, dtype=bool)

    def cycle(self, target: float, most: int) -> float:
        """Up to `most` V-cycles, until one changes `u` by no more than `target`; the last one's largest change."""
        _membrane_cycles(
            self._handle, self._ghosted, self._before, self.lowest, self.free, self._change,
            self._spring, target, most,
        )  # fmt: skip
        return float(self._change[0])


def _solved(
    g: Map, relaxation_px: float, *, bulge: float, bulge_px: float, guess: bool = False
) -> tuple[Map, Map]:
    """First guess from the grid of half the resolution, then cycles until the change is below the tolerance.

    A first guess may stop before that, because on a coarse relief two contacts can alternate forever.
    """
    u, b = _coarse_guess(g, relaxation_px, bulge, bulge_px)
    grids = _Grids(g.shape, relaxation_px)
    np.maximum(g + b, 0, out=grids.lowest)
    grids.u[:] = np.maximum(u, grids.lowest)
    target = TOLERANCE * max(float(g.max()), 1e-12)
    most = MAX_CYCLES // 4 if guess else MAX_CYCLES
    if bulge == 0:
        change = grids.cycle(target, most)
    for _ in range(most if bulge > 0 else 0):
        change = grids.cycle(target, 1)
        risen = spread(grids.u, bulge_px) * bulge
        change = max(change, float(np.abs(risen - b).max()))
        b = risen
        np.maximum(g + b, 0, out=grids.lowest)
        if change <= target:
            break
    if change > target and not guess:
        raise ConvergenceError(
            f"The gel's surface did not settle in {MAX_CYCLES} cycles (change {change:.3g}). "
            f"Its relaxation length is {relaxation_px:.3g} samples: simulate with another oversample."
        )
    return np.maximum(grids.u, grids.lowest), b


def spread(values: Map, length_px: float) -> Map:
    """Values smoothed by K0(r/h)/(2 pi h^2), mirrored at the border, so that their sum is preserved.

    By cosine transform on a coarser grid: the result is smooth over the length.
    """
    factor = max(
        1, int(length_px / 12)
    )  # twelve samples per length are enough for a result that is smooth over it
    height, width = values.shape
    small = cv2.resize(
        values, (max(2, width // factor), max(2, height // factor)), interpolation=cv2.INTER_AREA
    )
    rows, columns = small.shape
    ky = 2 - 2 * np.cos(np.pi * np.arange(rows) / rows)
    kx = 2 - 2 * np.cos(np.pi * np.arange(columns) / columns)
    hy, hx = length_px * rows / height, length_px * columns / width
    smooth = scipy.fft.idctn(
        scipy.fft.dctn(small, type=2) / (1 + hy**2 * ky[:, None] + hx**2 * kx[None, :]), type=2
    )
    if smooth.shape == values.shape:
        return np.asarray(smooth, dtype=np.float64)
    return np.asarray(cv2.resize(smooth, (width, height), interpolation=cv2.INTER_CUBIC), dtype=np.float64)


def carried_along(values: Map, fixed: NDArray[np.bool_], length_px: float) -> Map:
    """Values kept where `fixed` and falling off over a length elsewhere: v = h^2 laplace(v), no flux at the border.

    The values that are not fixed are the first guess; the result is good to a thousandth of the largest value.
    """
    grids = _Grids(values.shape, length_px)
    grids.u[:] = values
    np.logical_not(fixed, out=grids.free)
    target = 1e-3 * max(float(np.abs(values).max()), 1e-9)
    if grids.cycle(target, MAX_CYCLES) > target:
        raise ConvergenceError(f"The gel's drag did not settle in {MAX_CYCLES} cycles.")
    return grids.u.copy()


def _coarse_guess(g: Map, relaxation_px: float, bulge: float, bulge_px: float) -> tuple[Map, Map]:
    """The solution on a grid of half the resolution, interpolated to this one."""
    if relaxation_px < 2 or min(g.shape) < 8:
        return np.zeros(g.shape), np.zeros(g.shape)
    height, width = g.shape
    even = np.pad(g, ((0, height % 2), (0, width % 2)), mode="edge")
    halved = even.reshape(even.shape[0] // 2, 2, even.shape[1] // 2, 2).max(axis=(1, 3))
    coarse = _solved(halved, relaxation_px / 2, bulge=bulge, bulge_px=bulge_px / 2, guess=True)
    fine = [cv2.resize(part, even.shape[::-1], interpolation=cv2.INTER_LINEAR) for part in coarse]
    return np.asarray(fine[0][:height, :width]), np.asarray(fine[1][:height, :width])
