"""Surfaces of known depth and slopes, and faults of slopes, for tests and benchmarks.

Each surface is a function `(x, y) -> depth, dz/dx, dz/dy` of positions in mm, so that it can be sampled on any grid: for
convergence, for pixels of any shape, for any frame. All values are float64.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

Array = NDArray[np.float64]
Surface = Callable[[Array, Array], tuple[Array, Array, Array]]

SHAPE = (240, 320)
MM_PER_PX = 0.0634


class Scene(NamedTuple):
    """A surface sampled at pixel centers: depth (H, W) in mm, slopes (H, W, 2) in mm/mm, exact."""

    depth_mm: Array
    gradients: Array
    mm_per_px: tuple[float, float]


def scene(
    surface: Surface, shape: tuple[int, int] = SHAPE, mm_per_px: float | tuple[float, float] = MM_PER_PX
) -> Scene:
    """Sample a surface at pixel centers; (0, 0) mm is the middle of the frame."""
    pitch = (mm_per_px, mm_per_px) if isinstance(mm_per_px, (int, float)) else mm_per_px
    height, width = shape
    x = (np.arange(width) - (width - 1) / 2) * pitch[0]
    y = (np.arange(height) - (height - 1) / 2) * pitch[1]
    depth, p, q = surface(*np.meshgrid(x, y))
    return Scene(depth, np.stack([p, q], axis=-1), pitch)


def ball(
    radius_mm: float = 4.0, contact_radius_mm: float = 2.5, center_mm: tuple[float, float] = (0.0, 0.0)
) -> Surface:
    """A ball pressed until its contact circle has the given radius; flat around, with a kink at the rim."""

    def surface(x: Array, y: Array) -> tuple[Array, Array, Array]:
        u, v = x - center_mm[0], y - center_mm[1]
        square = u**2 + v**2
        inside = square < contact_radius_mm**2
        height = np.sqrt(radius_mm**2 - np.where(inside, square, 0))
        rim = np.sqrt(radius_mm**2 - contact_radius_mm**2)
        return (
            np.where(inside, height - rim, 0),
            np.where(inside, -u / height, 0),
            np.where(inside, -v / height, 0),
        )

    return surface


def total(*surfaces: Surface) -> Surface:
    """Sum of surfaces (presses that do not overlap)."""

    def surface(x: Array, y: Array) -> tuple[Array, Array, Array]:
        parts = [part(x, y) for part in surfaces]
        return sum(p[0] for p in parts), sum(p[1] for p in parts), sum(p[2] for p in parts)  # type: ignore[return-value]

    return surface


def gaussian(peak_mm: float, sigma_mm: float, center_mm: tuple[float, float] = (0.0, 0.0)) -> Surface:
    """A smooth bump, or a smooth dent if the peak is negative."""

    def surface(x: Array, y: Array) -> tuple[Array, Array, Array]:
        u, v = x - center_mm[0], y - center_mm[1]
        z = peak_mm * np.exp(-(u**2 + v**2) / (2 * sigma_mm**2))
        return z, -u / sigma_mm**2 * z, -v / sigma_mm**2 * z

    return surface


def waves(amplitude_mm: float, wavelength_mm: float) -> Surface:
    """Fine texture: crossed sine waves."""

    def surface(x: Array, y: Array) -> tuple[Array, Array, Array]:
        k = 2 * np.pi / wavelength_mm
        sx, sy, cx, cy = np.sin(k * x), np.sin(k * y), np.cos(k * x), np.cos(k * y)
        return amplitude_mm * sx * sy, amplitude_mm * k * cx * sy, amplitude_mm * k * sx * cy

    return surface


def polynomial(coefficients: dict[tuple[int, int], float]) -> Surface:
    """Sum of `c x^i y^j` for entries (i, j): c; includes planes and quadratics."""

    def surface(x: Array, y: Array) -> tuple[Array, Array, Array]:
        zero = np.zeros_like(x)
        z = sum((c * x**i * y**j for (i, j), c in coefficients.items()), zero)
        p = sum((c * i * x ** max(i - 1, 0) * y**j for (i, j), c in coefficients.items()), zero)
        q = sum((c * j * x**i * y ** max(j - 1, 0) for (i, j), c in coefficients.items()), zero)
        return z, p, q

    return surface


BALL = ball(4.0, 2.5, (0.4, -0.3))
SMALL_BALL = ball(2.0, 1.0, (0.4, -0.3))
CUT_BALL = ball(4.0, 2.5, (9.0, -0.3))
BALLS = total(ball(4.0, 2.5, (0.4, -0.3)), ball(4.0, 2.5, (9.0, 5.0)), ball(3.0, 2.0, (-9.5, -4.0)))
PEAKS = total(
    gaussian(0.9, 1.5, (-2.0, 1.0)), gaussian(-0.5, 1.2, (3.0, -2.0)), gaussian(0.6, 2.0, (8.5, 5.0))
)
TEXTURE = total(gaussian(0.8, 2.5), waves(0.012, 0.6))
BUMP = gaussian(1.0, 1.5, (0.4, -0.3))
PLANE = polynomial({(1, 0): 0.05, (0, 1): -0.03})
QUADRATIC = polynomial({(1, 0): 0.05, (0, 1): -0.03, (2, 0): 0.02, (1, 1): -0.015, (0, 2): 0.01})

SCENES: dict[str, Surface] = {
    "ball": BALL,
    "small ball": SMALL_BALL,
    "cut ball": CUT_BALL,
    "balls": BALLS,
    "peaks": PEAKS,
    "texture": TEXTURE,
    "bump": BUMP,
    "plane": PLANE,
}


def with_noise(gradients: Array, sigma: float, rng: np.random.Generator) -> Array:
    """Slopes with independent Gaussian noise."""
    return gradients + sigma * rng.standard_normal(gradients.shape)


class Corrupted(NamedTuple):
    """Slopes with outliers where `valid` is False."""

    gradients: Array
    valid: NDArray[np.bool_]


def with_outliers(gradients: Array, fraction: float, rng: np.random.Generator) -> Corrupted:
    """Slopes with specks (0 to 2 px in radius) of outliers in `fraction` of the pixels: dust, highlights.

    The wrong slopes scatter by 0.7 around the true ones plus (0.15, 0.1), because outliers with a common direction
    tilt depth over the whole frame.
    """
    height, width = gradients.shape[:2]
    valid = np.ones((height, width), dtype=bool)
    while np.count_nonzero(~valid) < fraction * valid.size:
        for _ in range(max(1, valid.size // 500)):
            _clear_disc(valid, rng.integers(0, height), rng.integers(0, width), rng.integers(0, 3))
    lies = gradients + (0.15, 0.1) + 0.7 * rng.standard_normal(gradients.shape)
    return Corrupted(np.where(valid[..., None], gradients, lies), valid)


def with_patches(gradients: Array, fraction: float, rng: np.random.Generator) -> Corrupted:
    """Slopes with discs (2 to 9 px in radius) of coherent outliers in `fraction` of the pixels: shadows.

    Half of the discs have one wrong slope (scatter 0.85) throughout, a quarter have slopes of 0, and a quarter are
    independent noise. Coherent outliers nearly form a surface: only their rim shows.
    """
    height, width = gradients.shape[:2]
    valid = np.ones((height, width), dtype=bool)
    corrupt = gradients.copy()
    while np.count_nonzero(~valid) < fraction * valid.size:
        disc = np.ones((height, width), dtype=bool)
        _clear_disc(disc, rng.integers(0, height), rng.integers(0, width), rng.integers(2, 10))
        kind = rng.integers(0, 4)
        if kind < 2:
            corrupt[~disc] = gradients[~disc] + 0.85 * rng.standard_normal(2)
        else:
            corrupt[~disc] = 0 if kind == 2 else 0.85 * rng.standard_normal((np.count_nonzero(~disc), 2))
        valid &= disc
    return Corrupted(corrupt, valid)


def _clear_disc(flags: NDArray[np.bool_], row: int, col: int, radius: int) -> None:
    rows, cols = slice(max(row - radius, 0), row + radius + 1), slice(max(col - radius, 0), col + radius + 1)
    i, j = np.ogrid[: flags.shape[0], : flags.shape[1]]
    flags[rows, cols] &= (i[rows] - row) ** 2 + (j[:, cols] - col) ** 2 > radius**2


def confidence_from_valid(valid: NDArray[np.bool_], *, low: float = 1e-3, blur_px: float = 0.0) -> Array:
    """1 where valid, `low` elsewhere, optionally with soft edges."""
    soft: Array = gaussian_filter(valid.astype(np.float64), blur_px) if blur_px else valid.astype(np.float64)
    return low + (1 - low) * soft


def rmse_um(depth_mm: NDArray[Any], truth_mm: NDArray[Any], where: NDArray[np.bool_] | None = None) -> float:
    """RMS difference in um after removing the mean difference, over all or the given pixels."""
    difference = (np.asarray(depth_mm, dtype=np.float64) - truth_mm)[... if where is None else where]
    return float(1e3 * np.std(difference))
