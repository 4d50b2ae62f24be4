"""Light that changed smoothly over the whole image: for each channel a cubic of the place, fitted to untouched blocks."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.foundations.filters import SIGMA_OF_MEDIAN

DEGREE = 3  # of the polynomial
POWERS = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]  # of x and y
FIT_ROUNDS = 3  # of reweighting
TUKEY_SIGMAS = 4.0  # deviations of noise from which on a value no longer counts (Tukey's biweight)
# By how much the mean light, and its other coefficients, may change from fit to fit; matters where no block is untouched.
MEAN_STEP, STEP = 0.1, 3e-3
LEAST_NOISE = 0.02  # grey levels of a block's mean


class SmoothLight:
    """The light of now relative to the untouched image's, 1 + polynomial; third degree, for each channel.

    Warming LEDs change their own share of the light, which varies slowly over the image; so does the colour of a gel
    that relaxes over widths of many millimetres. A contact is far narrower, and its blocks are left out.

    Parameters
    ----------
    blocks : (h, w), how many blocks
    """

    def __init__(self, blocks: tuple[int, int]) -> None:
        in_y, in_x = (_legendre(n) for n in blocks)
        self._basis = np.stack([in_y[:, None, j] * in_x[None, :, i] for i, j in POWERS], axis=-1)
        self._steps = np.array([MEAN_STEP if power == (0, 0) else STEP for power in POWERS])
        self.coefficients = np.zeros((3, len(POWERS)))

    @property
    def gains(self) -> NDArray[np.float64]:
        """The mean light of each channel (3,), relative."""
        return np.asarray(1 + self.coefficients[:, 0], dtype=np.float64)

    def at(self, shape: tuple[int, int]) -> NDArray[np.float32]:
        """The light (H, W, 3), relative, at the centres of as many rows and columns over the image."""
        in_y, in_x = (_legendre(n).astype(np.float32) for n in shape)
        light = np.empty((*shape, 3), dtype=np.float32)
        for channel, values in enumerate(self.coefficients):
            square = np.zeros((DEGREE + 1, DEGREE + 1), dtype=np.float32)  # of y's and x's polynomials
            for value, (i, j) in zip(values, POWERS):
                square[j, i] = value
            light[..., channel] = 1 + in_y @ square @ in_x.T
        return light

    def fit(
        self, blocks: NDArray[np.float32], untouched: NDArray[np.float32], free: NDArray[np.bool_]
    ) -> None:
        """Follow the light of untouched blocks.

        Iteratively reweighted least squares with Tukey's biweight (P. J. Huber and E. M. Ronchetti, Robust Statistics,
        2009, chapter 7), and a prior that the light is as it was, which decides where blocks do not.

        Parameters
        ----------
        blocks, untouched : (h, w, 3), means of blocks now and of the untouched image, grey levels
        free : (h, w), blocks where nothing touches
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
    """Standard deviation of noise about 0, by the median magnitude: outliers do not count."""
    return SIGMA_OF_MEDIAN * np.median(np.abs(off), axis=axis)


def tukey_weights(off: NDArray[Any], least_noise: float) -> tuple[float, NDArray[Any]]:
    """Noise of residuals, at least `least_noise`, and their biweights."""
    noise = max(float(robust_sigma(off)), least_noise)
    return noise, np.square(np.clip(1 - np.square(off / (TUKEY_SIGMAS * noise)), 0, None))


def _legendre(count: int) -> NDArray[np.float64]:
    """Legendre polynomials (count, 4) at the centres of so many parts of -1..1."""
    centers = (np.arange(count) + 0.5) / count * 2 - 1
    return np.asarray(np.polynomial.legendre.legvander(centers, DEGREE), dtype=np.float64)


def block_means(image: NDArray[np.generic], block_px: int) -> NDArray[np.float32]:
    """Means of an image (H, W, 3) over square blocks of about `block_px`, (h, w, 3) float32."""
    height, width = image.shape[:2]
    size = max(1, round(width / block_px)), max(1, round(height / block_px))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.float32)
