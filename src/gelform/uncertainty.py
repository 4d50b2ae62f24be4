"""How well depth is known: one standard deviation per pixel against the zero reference.

Slope errors have a white part, which integration averages out, and a part that is correlated over some pixels
(a color model's bias), which it does not: at equal size the second moves depth far more.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.checks import check_map, check_mask, check_mm_per_px
from gelform.depth import Level, Zero, checked_anchor, fitted_surface, zero_region
from gelform.gradients import fill
from gelform.solvers.multigrid import Hierarchy
from gelform.solvers.system import FLOOR, load_right_side, problem_from_gradients

# Probes are solved on a coarser grid (sigma is smooth), to a tolerance that matches their number.
COARSER = 4
TOLERANCE = 2e-2
# Variance of the probes is averaged over so many pixels of the frame (standard deviation).
SMOOTHING_PX = 3.0


def depth_sigma(
    gradients_sigma: ArrayLike,
    *,
    mm_per_px: float | Sequence[float],
    weights: ArrayLike | None = None,
    mask: ArrayLike | None = None,
    anchor: ArrayLike | None = None,
    zero: Zero | NDArray[np.bool_] = "mean",
    level: Level | None = None,
    correlation_px: float = 0.0,
    correlated_share: float = 0.5,
    probes: int = 32,
    rng: np.random.Generator | None = None,
) -> NDArray[np.float32]:
    """One standard deviation of the depth that `depth_from_gradients` gives with the same arguments.

    Parameters
    ----------
    gradients_sigma : (H, W, 2), mm/mm, > 0
        Standard deviation of the slopes, all causes included.
    mm_per_px, weights, mask, anchor, zero, level
        As for `depth_from_gradients`; weights per pixel.
    correlation_px : float, >= 0
        Distance over which the correlated part of the slope errors falls to exp(-1/2) (a Gaussian); 0: all of
        the error is white.
    correlated_share : float, 0-1
        Share of the variance that is correlated, if `correlation_px` > 0.
    probes : int
        Random slope errors that are integrated; the relative error of the result is about 0.6/sqrt(probes).
    rng : numpy Generator
        Draws the probes; a fixed seed if None, so that the same arguments give the same map.

    Returns
    -------
    depth_sigma_mm : (H, W) float32, mm; without the uncertainty of the scale. Outside the mask: of the
        pixels it was filled from.

    Notes
    -----
    Uniform slope errors without weights, mask, anchor and correlation have a closed form in cosine modes; the
    rest is Monte Carlo on a grid 4 times coarser; what that grid cannot see is added from the closed form.
    """
    pitch = check_mm_per_px(mm_per_px)
    sigma = _checked_sigma(gradients_sigma)
    shape = sigma.shape[:2]
    uniform = weights is None and mask is None and anchor is None and level is None
    constant = bool(np.all(sigma == sigma[0, 0]))
    if uniform and constant and correlation_px == 0 and isinstance(zero, str) and zero == "mean":
        per_x, per_y = _closed_form(shape, pitch)
        return np.sqrt(sigma[0, 0, 0] ** 2 * per_x + sigma[0, 0, 1] ** 2 * per_y).astype(np.float32)
    share = _checked_share(correlation_px, correlated_share)
    weight = np.ones(shape, dtype=np.float32)
    if weights is not None:
        weight = check_map(weights, "weights", shape=shape, nonnegative=True)
    inside = np.ones(shape, dtype=bool) if mask is None else check_mask(mask, shape=shape)
    hold = None if anchor is None else checked_anchor(anchor, shape)
    coarse = _Coarse(sigma, pitch, weight, inside, hold, zero_region(zero, shape))
    variance = coarse.probed_variance(share, correlation_px, level, probes, rng or np.random.default_rng(0))
    told = inside & (weight >= FLOOR * weight.max())
    total = _refined(variance, shape) + _unseen_variance(sigma, told, pitch, share, correlation_px)
    return np.sqrt(total) * (1 if hold is None else _freedom(weight, hold))


def _checked_sigma(gradients_sigma: ArrayLike) -> NDArray[np.float32]:
    sigma = np.asarray(gradients_sigma)
    if sigma.ndim != 3 or sigma.shape[2] != 2:
        raise ValueError(f"Expected gradients_sigma of shape (H, W, 2), got {sigma.shape}.")
    sigma = np.moveaxis(check_map(np.moveaxis(sigma, -1, 0), "gradients_sigma", nonnegative=True), 0, -1)
    if sigma.min() == 0:
        raise ValueError("Expected gradients_sigma > 0, got 0: no slope is known exactly.")
    return sigma


def _checked_share(correlation_px: float, correlated_share: float) -> float:
    if not 0 <= correlation_px < np.inf:
        raise ValueError(f"Expected correlation_px >= 0, got {correlation_px}.")
    if not 0 <= correlated_share <= 1:
        raise ValueError(f"Expected correlated_share within 0-1, got {correlated_share}.")
    return correlated_share if correlation_px > 0 else 0.0


class _Coarse:
    """The integration problem on cells of COARSER x COARSER pixels."""

    def __init__(
        self,
        sigma: NDArray[np.float32],
        pitch: tuple[float, float],
        weights: NDArray[np.float32],
        mask: NDArray[np.bool_],
        anchor: NDArray[np.float32] | None,
        region: NDArray[np.bool_],
    ) -> None:
        self.pitch = pitch[0] * COARSER, pitch[1] * COARSER
        # Slopes of less weight are replaced by a fill from their neighbours: they bring no error.
        told = weights * (mask & (weights >= FLOOR * weights.max()))
        count = _sums(mask)
        total = _sums(told)
        self.mask = count > 0
        self.weights = (total / np.maximum(count, 1)).astype(np.float32)
        self.anchor = None if anchor is None else _sums(anchor * mask).astype(np.float32)
        covered = _sums(region & mask)
        self.region = covered > 0.5 * count if np.any(covered > 0.5 * count) else covered > 0
        # Standard deviation of the weighted mean slope of a cell: of independent errors, and of common ones.
        # Holes make independent errors go round: worse by the unevenness of the weights in the cell.
        scale = (1 / np.maximum(total, 1e-30))[..., None]
        uneven = np.sqrt(count * _sums(told**2))[..., None] * scale
        self.white = np.sqrt(_sums((told[..., None] * sigma) ** 2)) * scale * np.where(uneven > 0, uneven, 1)
        self.common = _sums(told[..., None] * sigma) * scale
        self.white[total == 0] = self.common[total == 0] = 0

    def probed_variance(
        self, share: float, correlation_px: float, level: Level | None, probes: int, rng: np.random.Generator
    ) -> NDArray[np.float32]:
        """Mean square of the depth of random slope errors."""
        shape = (probes, *self.white.shape)
        # Signs do, and are quickly drawn, except where a median is to be taken of them.
        draw = rng.standard_normal(shape) if level == "slope" else _signs(shape, rng)
        errors = np.sqrt(1 - share) * self.white[None] * draw
        if share > 0:
            common = np.sqrt(share * _cell_power(correlation_px)) * self.common
            errors += common * _correlated(probes, self.mask.shape, correlation_px / COARSER, rng)
        if level == "slope":
            errors -= np.median(errors[:, self.region], axis=1)[:, None, None, :]
        total = np.zeros(self.mask.shape, dtype=np.float32)
        for depth in self._depths(errors.astype(np.float32)):
            if self.anchor is None:
                depth -= depth[self.region].mean()
            if level in ("plane", "quadratic"):
                depth -= fitted_surface(depth, self.region, 1 if level == "plane" else 2)
            total += depth**2
        return self._smoothed(total / np.float32(probes))

    def _depths(self, errors: NDArray[np.float32]) -> Iterator[NDArray[np.float32]]:
        """Depth of each field of slope errors; the coarse levels are computed once."""
        hierarchy = Hierarchy(self.mask.shape)
        hierarchy.load(problem_from_gradients(errors[0], self.weights, self.mask, self.anchor), self.pitch)
        told = self.weights >= FLOOR * self.weights.max()
        for field in errors:
            load_right_side(hierarchy.data, field if told.all() else fill(field, told), self.pitch)
            yield hierarchy.solve(TOLERANCE, 1000)[0]

    def _smoothed(self, variance: NDArray[np.float32]) -> NDArray[np.float32]:
        """Averaged over neighbours inside the mask."""
        blur = SMOOTHING_PX / COARSER
        inside = cv2.GaussianBlur(self.mask.astype(np.float32), (0, 0), blur)
        smooth = cv2.GaussianBlur(np.where(self.mask, variance, 0).astype(np.float32), (0, 0), blur)
        return np.asarray(smooth / np.maximum(inside, 1e-6), dtype=np.float32)


def _unseen_variance(
    sigma: NDArray[np.float32],
    told: NDArray[np.bool_],
    pitch: tuple[float, float],
    share: float,
    correlation_px: float,
) -> NDArray[np.float32]:
    """What errors do within a cell: from the closed form, with the usual variance of each pixel's neighbours.

    The usual variance is the geometric mean over 3x3 pixels: one bad pixel among good ones is held by them.
    """
    known = told[..., None] * np.log(sigma**2)
    near = cv2.blur(known, (3, 3)) / np.maximum(cv2.blur(told.astype(np.float32), (3, 3)), 1e-6)[..., None]
    usual = np.where(near != 0, np.exp(near), 0).reshape(sigma.shape)
    white, common = (_unseen(pitch[0] / pitch[1], length) for length in (0.0, correlation_px))
    per_x, per_y = ((1 - share) * w + share * c for w, c in zip(white, common))
    variance = (usual[..., 0] * per_x + usual[..., 1] * per_y) * (pitch[0] * pitch[1])
    return np.asarray(variance, dtype=np.float32)


def _freedom(weights: NDArray[np.float32], anchor: NDArray[np.float32]) -> NDArray[np.float32]:
    """How far a pixel follows its neighbours where an anchor holds it: ties over ties and anchor."""
    around = np.pad(np.maximum(weights, FLOOR * weights.max()), 1, mode="edge")
    here = around[1:-1, 1:-1]
    ties = np.zeros_like(here)
    for other in (around[:-2, 1:-1], around[2:, 1:-1], around[1:-1, :-2], around[1:-1, 2:]):
        ties += 2 * here * other / (here + other)
    return np.asarray(ties / (ties + anchor), dtype=np.float32)


def _refined(values: NDArray[np.float32], shape: tuple[int, int]) -> NDArray[np.float32]:
    """Bilinear, from cells to pixels."""
    height, width = values.shape
    fine = cv2.resize(values, (width * COARSER, height * COARSER)).reshape(height * COARSER, -1)
    return np.asarray(fine[: shape[0], : shape[1]])


def _sums(values: NDArray[Any]) -> NDArray[np.float32]:
    """Sums over cells; those at the far border may be partial."""
    height, width = values.shape[:2]
    padding = [(0, -height % COARSER), (0, -width % COARSER)] + [(0, 0)] * (values.ndim - 2)
    whole = np.pad(values.astype(np.float32), padding)
    size = whole.shape[1] // COARSER, whole.shape[0] // COARSER
    means = cv2.resize(whole, size, interpolation=cv2.INTER_AREA)
    return np.asarray(means * COARSER**2).reshape(size[1], size[0], *values.shape[2:])


def _signs(shape: tuple[int, ...], rng: np.random.Generator) -> NDArray[np.float32]:
    """Independent +1 or -1: variance 1, and cheaper than Gaussians."""
    bits = np.unpackbits(np.frombuffer(rng.bytes(int(np.prod(shape)) // 8 + 1), dtype=np.uint8))
    return (2 * bits[: int(np.prod(shape))].astype(np.float32) - 1).reshape(shape)


def _correlated(
    count: int, shape: tuple[int, int], length: float, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Fields (count, *shape, 2) of correlation exp(-d^2/(2 length^2)) and power 1 at low frequencies."""
    blur = max(length / np.sqrt(2), 0.1)
    margin = int(np.ceil(4 * blur))
    kernel = cv2.getGaussianKernel(2 * margin + 1, blur, cv2.CV_32F)
    noise = _signs((count, shape[0] + 2 * margin, shape[1] + 2 * margin, 2), rng)
    inner = slice(margin, margin + shape[0]), slice(margin, margin + shape[1])
    return np.stack([cv2.sepFilter2D(field, -1, kernel, kernel)[inner] for field in noise])


@lru_cache(maxsize=64)
def _cell_power(correlation_px: float) -> float:
    """Power, per cell, of correlated pixel errors of variance 1 at low frequencies."""
    distance = np.arange(-int(6 * correlation_px) - 1, int(6 * correlation_px) + 2)
    along = np.sum(np.exp(-(distance**2) / (2 * correlation_px**2)))
    return float(along**2 / COARSER**2)


@lru_cache(maxsize=8)
def _closed_form(shape: tuple[int, int], pitch: tuple[float, float]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Variance of zero-mean depth per unit variance of white errors of p, and of q.

    `Var z = sum C_l[i]^2 C_k[j]^2 (Kx_k, Ky_l)/lambda^2` over cosine modes C, with lambda the eigenvalue of
    the normal equations and K that of the averaged slopes' divergence, sin^2(pi k/W).
    """
    return _variance_of_modes(shape, pitch, np.ones(shape))


def _variance_of_modes(
    shape: tuple[int, int], pitch: tuple[float, float], spectrum: NDArray[Any]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Variance of depth, for errors of p and of q of the given variance per mode (H, W)."""
    modes, eigen, gain = zip(*(_modes(n, h) for n, h in zip(shape, pitch[::-1])))
    square = (eigen[0][:, None] + eigen[1]) ** 2
    square[0, 0] = np.inf
    per_x = modes[0].T @ (spectrum * gain[1] / square) @ modes[1]
    per_y = modes[0].T @ (spectrum * gain[0][:, None] / square) @ modes[1]
    return per_x, per_y


def _modes(count: int, pitch: float) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Squares of the cosine modes (mode, place), their eigenvalues, the gain of averaged slopes."""
    k = np.arange(count)
    modes = np.cos(np.pi * k[:, None] * (k + 0.5) / count) ** 2 * np.where(k == 0, 1, 2)[:, None] / count
    return modes, (2 * np.sin(np.pi * k / (2 * count)) / pitch) ** 2, (np.sin(np.pi * k / count) / pitch) ** 2


@lru_cache(maxsize=64)
def _unseen(aspect: float, correlation_px: float) -> tuple[float, float]:
    """Variance per unit slope variance and pixel area that cells miss, in the middle of a uniform frame.

    White errors: of pixels minus of cells. Correlated ones: of the modes that are too fine for cells.
    """
    size = 32 * COARSER
    middle = slice(3 * size // 8, 5 * size // 8)
    pitch = np.sqrt(aspect), 1 / np.sqrt(aspect)
    if correlation_px == 0:
        fine = _closed_form((size, size), pitch)
        coarse = _closed_form((32, 32), (COARSER * pitch[0], COARSER * pitch[1]))
        x, y = (
            float(f[middle, middle].mean() - c[12:20, 12:20].mean() / COARSER**2)
            for f, c in zip(fine, coarse)
        )
        return x, y
    decay = np.exp(-((np.pi * np.arange(size) / size * correlation_px) ** 2) / 2)
    spectrum = decay[:, None] * decay / decay.mean() ** 2
    spectrum[: size // COARSER, : size // COARSER] = 0
    per_x, per_y = _variance_of_modes((size, size), pitch, spectrum)
    return float(per_x[middle, middle].mean()), float(per_y[middle, middle].mean())
