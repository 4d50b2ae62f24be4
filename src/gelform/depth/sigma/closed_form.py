"""Variance of depth from white or correlated slope errors of one size, in closed form: cosine modes.

`Var z = sum C_l[i]^2 C_k[j]^2 (Kx_k, Ky_l)/lambda^2` over cosine modes C, with lambda the eigenvalue of the
normal equations and K that of the averaged slopes' divergence, sin^2(pi k/W).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

TRIAL_BLOCKS = 32  # blocks across a square frame; the errors of a uniform frame are taken from its middle


@lru_cache(maxsize=8)
def variance_of_white(
    shape: tuple[int, int], pitch: tuple[float, float], length: float = 0.0
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Variance (H, W) of zero-mean depth per unit variance of white errors of p, and of q.

    With a length, in pixels, the errors have the correlation exp(-d^2/(2 length^2)); the result holds far from the border.
    """
    modes = [_modes(n) for n in shape]
    eigen, gain = zip(*(_eigenvalues(n, h) for n, h in zip(shape, pitch[::-1])))
    square = (eigen[0][:, None] + eigen[1]) ** 2
    square[0, 0] = np.inf
    if length > 0:
        spectrum = [_extent(length) * np.exp(-0.5 * (length * np.pi * np.arange(n) / n) ** 2) for n in shape]
        square /= spectrum[0][:, None] * spectrum[1]
    return modes[0].T @ (gain[1] / square) @ modes[1], modes[0].T @ (gain[0][:, None] / square) @ modes[1]


@lru_cache(maxsize=64)
def variance_within_blocks(aspect: float, block: int) -> tuple[float, float]:
    """Variance of depth per unit of white slope errors (of p, of q) and pixel area that a grid of blocks misses.

    It is the variance of pixels minus that of blocks, in the middle of a uniform frame; `aspect` is the pitch along x over
    that along y, `block` the pixels across a block. (Blocks miss almost nothing of correlated errors.)
    """
    fine, coarse = _variance_in_middle(aspect, block), _variance_in_middle(aspect, 1)
    return fine[0] - coarse[0], fine[1] - coarse[1]


@lru_cache(maxsize=64)
def white_as_blurred(aspect: float, block: int, length: float) -> tuple[float, float]:
    """Variances of the white errors, of blocks and within them, that move depth as far as blurred errors of variance 1.

    Errors with a correlation that falls to exp(-1/2) over `length` pixels, less than a block, have the power of
    `2 pi length^2` white ones at the wavelengths of blocks, and little within them. If that exceeds their whole effect on
    depth, blocks get that effect instead.
    """
    if length == 0:
        return 1.0, 1.0
    of_blocks, white = sum(_variance_in_middle(aspect, 1)), sum(variance_within_blocks(aspect, block))
    whole = sum(_variance_in_middle(aspect, block, length))
    power = min(max(1.0, 2 * np.pi * length**2), whole / of_blocks)
    return power, max(whole - power * of_blocks, 0.0) / white


def _variance_in_middle(aspect: float, block: int, length: float = 0.0) -> tuple[float, float]:
    """Variance of depth by errors of p, and of q, in the middle of a uniform frame of many blocks, per pixel area.

    The mean errors of whole blocks move depth as far as those of as many pixels (`block` 1).
    """
    size = TRIAL_BLOCKS * block
    middle = slice(3 * size // 8, 5 * size // 8)
    fine = variance_of_white((size, size), (np.sqrt(aspect), 1 / np.sqrt(aspect)), length)
    return float(fine[0][middle, middle].mean()), float(fine[1][middle, middle].mean())


@lru_cache(maxsize=64)
def fading_within_blocks(aspect: float, block: int) -> tuple[float, float, float, float]:
    """The decrease of `variance_within_blocks` where an anchor holds: coefficients of a ratio of polynomials.

    Anchor over weight, x, adds to every eigenvalue. The variance that a grid of blocks misses is then nearly
    `(1 + c0 x)/(1 + c1 x + c2 x^2 + c3 x^3)` of that without anchor, within 2 % for x from 0 to 100.
    """
    x = np.concatenate([[0], np.logspace(-4, 2, 30)])
    left = _missed(aspect, block, x)
    left /= left[0]
    denominator = np.ones_like(x)
    for _ in range(8):  # linear in the coefficients, once the equations are weighted by the last denominator
        scale = 1 / (left * denominator)
        columns = np.stack([x, *(-left * x**power for power in (1, 2, 3))], axis=1)
        c = np.linalg.lstsq(columns * scale[:, None], (left - 1) * scale, rcond=None)[0]
        denominator = 1 + c[1] * x + c[2] * x**2 + c[3] * x**3
    return float(c[0]), float(c[1]), float(c[2]), float(c[3])


def _missed(aspect: float, block: int, anchors: NDArray[Any]) -> NDArray[Any]:
    """Mean variance of pixels minus that of blocks over a frame, for each anchor, both slopes together."""
    missed = np.zeros(anchors.size)
    for size, pixels, sign in ((TRIAL_BLOCKS * block, 1, 1), (TRIAL_BLOCKS, block, -1)):
        eigen, gain = zip(*(_eigenvalues(size, pixels * pitch) for pitch in (aspect**-0.5, aspect**0.5)))
        gains = gain[0][:, None] + gain[1]
        for i, anchor in enumerate(anchors):
            square = (eigen[0][:, None] + eigen[1] + anchor) ** 2
            square[0, 0] = np.inf
            missed[i] += sign * np.mean(gains / square) / pixels**2
    return missed


def correlation_of_blocks(correlation_px: float, block: int) -> tuple[float, float]:
    """Length, in blocks, and variance of correlated errors of length `correlation_px` > 0 and variance 1.

    Averaging over a block acts as a Gaussian of the same second moment: the errors become longer and weaker, with
    the same power at low frequencies.
    """
    length = np.sqrt(correlation_px**2 / block**2 + 1 / 6)
    return float(length), float((_extent(correlation_px) / (block * _extent(length))) ** 2)


def _extent(length: float) -> float:
    """Sum of exp(-d^2/(2 length^2)) along a row: 1 below a twentieth of a pixel, where the square could underflow."""
    length = max(length, 0.05)
    distance = np.arange(-int(8 * length) - 1, int(8 * length) + 2)
    return float(np.sum(np.exp(-(distance**2) / (2 * length**2))))


def _modes(count: int) -> NDArray[Any]:
    """Squares of the cosine modes (mode, place)."""
    k = np.arange(count)
    return np.asarray(
        np.cos(np.pi * k[:, None] * (k + 0.5) / count) ** 2 * np.where(k == 0, 1, 2)[:, None] / count
    )


def _eigenvalues(count: int, pitch: float) -> tuple[NDArray[Any], NDArray[Any]]:
    """The cosine modes' eigenvalues, and the gain of averaged slopes."""
    k = np.arange(count)
    return (2 * np.sin(np.pi * k / (2 * count)) / pitch) ** 2, (np.sin(np.pi * k / count) / pitch) ** 2
