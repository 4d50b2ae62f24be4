"""Light that changed smoothly over the whole image: a cubic polynomial per channel, fitted to blocks without contact."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.foundations.filters import SIGMA_OF_MEDIAN

DEGREE = 3  # of the polynomial
POWERS = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]  # exponents of x and y
FIT_ROUNDS = 3  # rounds of reweighting
TUKEY_SIGMAS = 4.0  # standard deviations of noise beyond which a value has no weight (Tukey's biweight)
# Standard deviations of the change per fit: of the mean light, and of its other coefficients. Only blocks in contact
# feel it.
MEAN_STEP, STEP = 0.1, 3e-3
LEAST_NOISE = 0.02  # gray levels, noise of a block's mean


class SmoothLight:
    """The current light relative to the background's: 1 + a polynomial of third degree per channel.

    Warming LEDs change their share of the light, which varies slowly over the image. So does the color of a relaxing
    gel, over many millimeters. A contact is far narrower, and its blocks are left out.

    Parameters
    ----------
    blocks : (h, w), number of blocks
    """

    def __init__(self, blocks: tuple[int, int]) -> None:
        in_y, in_x = (_legendre(n) for n in blocks)
        self._basis = np.stack([in_y[:, None, j] * in_x[None, :, i] for i, j in POWERS], axis=-1)
        self._steps = np.array([MEAN_STEP if power == (0, 0) else STEP for power in POWERS])
        self.coefficients = np.zeros((3, len(POWERS)))

    @property
    def gains(self) -> NDArray[np.float64]:
        """The relative mean light of each channel (3,)."""
        return np.asarray(1 + self.coefficients[:, 0], dtype=np.float64)

    def at(self, shape: tuple[int, int]) -> NDArray[np.float32]:
        """The relative light (H, W, 3), at the centers of that many rows and columns of the image."""
        in_y, in_x = (_legendre(n).astype(np.float32) for n in shape)
        light = np.empty((*shape, 3), dtype=np.float32)
        for channel, values in enumerate(self.coefficients):
            square = np.zeros((DEGREE + 1, DEGREE + 1), dtype=np.float32)  # of the polynomials of y and x
            for value, (i, j) in zip(values, POWERS):
                square[j, i] = value
            light[..., channel] = 1 + in_y @ square @ in_x.T
        return light

    def fit(
        self, blocks: NDArray[np.float32], untouched: NDArray[np.float32], free: NDArray[np.bool_]
    ) -> None:
        """Fit the light to blocks without contact.

        Iteratively reweighted least squares with Tukey's biweight (P. J. Huber and E. M. Ronchetti, Robust Statistics, 2009,
        chapter 7). A prior keeps the previous light where no block determines it.

        Parameters
        ----------
        blocks, untouched : (h, w, 3), block means of now and of the background, gray levels
        free : (h, w), True for blocks that nothing touches
        """
        basis = self._basis[free]
        for channel in range(3):
            levels = untouched[free][:, channel].astype(np.float64)
            columns = basis * levels[:, None]
            wanted = blocks[free][:, channel] - levels
            coefficients = before = self.coefficients[channel]
            for _ in range(FIT_ROUNDS):
                off = wanted - columns @ coefficients
                noise, weights = tukey_weights(off, LEAST_NOISE)
                normal = (columns * weights[:, None]).T @ columns
                normal[np.diag_indices_from(normal)] += (noise / self._steps) ** 2
                right = columns.T @ (weights * (wanted - columns @ before))
                coefficients = before + np.linalg.solve(normal, right)
            self.coefficients[channel] = coefficients


def robust_sigma(off: NDArray[Any], axis: Any = None) -> Any:
    """Standard deviation of noise about 0, from the median magnitude: robust to outliers."""
    return SIGMA_OF_MEDIAN * np.median(np.abs(off), axis=axis)


def tukey_weights(off: NDArray[Any], least_noise: float) -> tuple[float, NDArray[Any]]:
    """The noise of residuals, at least `least_noise`, and their biweights."""
    noise = max(float(robust_sigma(off)), least_noise)
    return noise, np.square(np.clip(1 - np.square(off / (TUKEY_SIGMAS * noise)), 0, None))


def _legendre(count: int) -> NDArray[np.float64]:
    """Legendre polynomials (count, 4) at the centers of `count` equal parts of -1..1."""
    centers = (np.arange(count) + 0.5) / count * 2 - 1
    return np.asarray(np.polynomial.legendre.legvander(centers, DEGREE), dtype=np.float64)


def block_means(image: NDArray[np.generic], block_px: int) -> NDArray[np.float32]:
    """Means of an image (H, W, 3) over square blocks of about `block_px`, (h, w, 3) float32."""
    height, width = image.shape[:2]
    size = max(1, round(width / block_px)), max(1, round(height / block_px))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.float32)
