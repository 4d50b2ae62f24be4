"""How far a pixel's slope is to be trusted: its standard deviation, and the confidence that follows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.optimize import nnls

SATURATED_SIGMA = 1.0


@dataclass(frozen=True)
class SlopeSigma:
    """Standard deviation of a slope component, `sqrt(rest^2 + (growth |gradient|)^2)`.

    Attributes
    ----------
    rest : at slope 0, mm/mm
    growth : per unit of slope; what a color model gets wrong grows with the slope
    clean : the value on a good pixel in contact: confidence is 1 up to it
    correlation_px : over which slope errors are alike
    """

    rest: float
    growth: float
    clean: float
    correlation_px: float

    @classmethod
    def fit(cls, slopes: NDArray[Any], errors: NDArray[Any], correlation_px: float) -> SlopeSigma:
        """From held-out slopes |g| (N,) and the errors (N, 2) of their components, by robust binned variance."""
        edges = np.linspace(0, max(float(np.percentile(slopes, 99)), 0.1), 9)
        bins = np.digitize(slopes, edges[1:-1])
        rows = []
        for b in range(8):
            members = errors[bins == b].ravel()
            if members.size >= 50:
                spread = 1.4826 * float(np.median(np.abs(members)))
                rows.append((float(np.mean(slopes[bins == b])) ** 2, spread**2, members.size))
        square, variance, count = np.array(rows).T
        relative = np.sqrt(count) / variance  # a bin counts by its relative error: the small ones at rest too
        design = np.stack([np.ones_like(square), square], axis=1) * relative[:, None]
        rest, growth = np.maximum(nnls(design, variance * relative)[0], 1e-6)
        clean = float(np.sqrt(np.average(variance, weights=count)))
        return cls(float(np.sqrt(rest)), float(np.sqrt(growth)), clean, correlation_px)

    def at(
        self, gradients: NDArray[np.float32], image: NDArray[Any]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Standard deviation (H, W, 2), the same for both components, and confidence (H, W) of a frame's slopes.

        A pixel with a channel at 0 or 255 is clipped: its slope is not known better than `SATURATED_SIGMA`.
        """
        sigma = np.empty(gradients.shape[:2], dtype=np.float32)
        confidence = np.empty(gradients.shape[:2], dtype=np.float32)
        _sigma_and_confidence(
            gradients, image, self.rest**2, self.growth**2, self.clean**2, sigma, confidence
        )
        return np.broadcast_to(sigma[..., None], gradients.shape), confidence


@njit(cache=True, fastmath=True, nogil=True)
def _sigma_and_confidence(gradients, image, rest2, growth2, clean2, sigma, confidence):  # type: ignore[no-untyped-def]
    height, width, _ = gradients.shape
    rest, growth, clean = np.float32(rest2), np.float32(growth2), np.float32(clean2)
    clipped = np.float32(SATURATED_SIGMA**2)
    for y in range(height):
        for x in range(width):
            p, q = gradients[y, x, 0], gradients[y, x, 1]
            variance = rest + growth * (p * p + q * q)
            darkest = min(image[y, x, 0], image[y, x, 1], image[y, x, 2])
            brightest = max(image[y, x, 0], image[y, x, 1], image[y, x, 2])
            variance = max(variance, clipped if (darkest <= 0) | (brightest >= 255) else variance)
            sigma[y, x] = np.sqrt(variance)
            confidence[y, x] = min(np.float32(1), clean / variance)
