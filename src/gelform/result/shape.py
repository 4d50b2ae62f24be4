"""How the errors of one frame's depth hang together, which the deviation of each pixel does not say: errors of shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy  # its parts load at first use

from gelform.arrays import Array, Map, Mask, Numbers
from gelform.depth.coarse import coarse_of


@dataclass(frozen=True, eq=False)
class ShapeErrors:
    """What differences of depths are uncertain by. Maps are on the grid (r, c) of `gelform.depth.coarse`.

    Attributes
    ----------
    variance : (k, r, c) float32, mm^2, of the depth by the errors of single slopes; k is 1, or 2 for the difference of two
        frames, whose errors are independent
    common_mm : (k, r, c) float32, mm, depth that slopes in proportion, and steep ones, may be off by together, one
        standard deviation each
    gain_sigma : relative error that all slopes share, one standard deviation
    correlation_px : distance over which the correlated part of the slopes' errors falls to exp(-1/2)
    correlated_share : fraction of their variance that is correlated
    blur_px : standard deviation of the Gaussian that the color change was blurred by
    """

    variance: Map
    common_mm: Map
    gain_sigma: float
    correlation_px: float
    correlated_share: float
    blur_px: float

    def difference_sigma(self, region: Mask) -> Map:
        """Standard deviation (H, W), mm, of the depth minus its mean over a region (H, W) of some pixels."""
        at_pixels = coarse_of((region.shape[0], region.shape[1])).at_pixels
        apart = np.zeros(region.shape, dtype=np.float32)
        for own, common in zip(map(at_pixels, self.variance), map(at_pixels, self.common_mm)):
            apart += np.abs(own - own[region].mean()) + np.square(common - common[region].mean())
        return np.asarray(np.sqrt(apart))

    def slope_sigma(self, weights: Numbers, gradients_sigma: Map) -> float:
        """Standard deviation of `sum(weights * depth)`, per mm of a pixel's width, by the errors of single slopes.

        Least-squares depth answers an error e of the slopes by the sum of e grad u, where u has the Laplacian -weights and
        a free border. Weights (H, W) have the sum 0; deviations of the slopes are (H, W, 2).
        """
        height, width = weights.shape
        answer = scipy.fft.dctn(weights, norm="ortho") / _laplacian(height, width)
        answer[0, 0] = 0.0
        answer = scipy.fft.idctn(answer, norm="ortho")
        each = np.zeros((height, width, 2))
        each[:, :-1, 0], each[:-1, :, 1] = np.diff(answer, axis=1), np.diff(answer, axis=0)
        each *= gradients_sigma
        # exp(-r^2/(2 L^2)) is 2 pi L^2 times the autocorrelation of a Gaussian of L/sqrt(2).
        length = self.correlation_px / np.sqrt(2)
        together = scipy.ndimage.gaussian_filter(each, (length, length, 0), mode="constant")
        correlated, white = np.sum(together**2) * self._cell, np.sum(each**2)
        return float(np.sqrt(self.correlated_share * correlated + (1 - self.correlated_share) * white))

    def waves(self, height: int, width: int, l_filter_px: float | None = None) -> Numbers:
        """Variance (h, w) of each cosine wave of the depth of h x w pixels, px^2, where all slopes have the variance 1.

        Their mean is the variance of a pixel. A Gaussian L-filter leaves half the height of waves of its cut-off length.
        """
        laplacian = _laplacian(height, width)
        correlated = self._cell * np.exp(-laplacian * self.correlation_px**2 / 2)
        left = 1.0
        if l_filter_px is not None:
            left = 1 - np.exp(-np.log(2) * laplacian * (l_filter_px / (2 * np.pi)) ** 2)
        return np.asarray(
            (1 - self.correlated_share + self.correlated_share * correlated) / laplacian * left**2
        )

    @property
    def _cell(self) -> float:
        """Pixels whose errors are as one; a pixel at least."""
        return max(2 * np.pi * self.correlation_px**2, 1.0)


def _laplacian(height: int, width: int) -> Array:
    """Eigenvalues (h, w) of the negative Laplacian with a free border, 1 in the place of the 0 of a constant."""
    y, x = (2 - 2 * np.cos(np.pi * np.arange(n) / n) for n in (height, width))
    values = y[:, np.newaxis] + x
    values[0, 0] = 1.0
    return values
