"""The forward response: what colour change a gradient gives at a place, and how noisy it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.color_models.least_squares import polynomial_terms, robust_ridge, unit_position
from gelform.color_models.seam import Samples

HUBER_CHANGE = 0.05


@dataclass(frozen=True)
class ForwardResponse:
    """Color change as a polynomial in the gradient whose coefficients vary over the image.

    Attributes
    ----------
    coefficients : (terms, 3) float64
    position_degrees : degree in (x, y) of the linear, quadratic, cubic gradient terms
    shape : (H, W)
    noise : (3,) float64, standard deviation of the color change about it, per channel
    """

    coefficients: NDArray[np.float64]
    position_degrees: tuple[int, ...]
    shape: tuple[int, int]
    noise: NDArray[np.float64]

    @classmethod
    def fit(cls, samples: Samples, position_degrees: tuple[int, ...] = (3, 2, 1)) -> ForwardResponse:
        """Robust ridge regression of the color change on the gradient terms."""
        x, y = unit_position(samples.x_px, samples.y_px, samples.shape)
        design = polynomial_terms(samples.gradients, x, y, position_degrees)
        change = np.asarray(samples.color_change, dtype=np.float64)
        coefficients = robust_ridge(design, change, samples.weight, ridge=1e-5, huber=HUBER_CHANGE)
        noise = 1.4826 * np.median(np.abs(design @ coefficients - change), axis=0)
        return cls(coefficients, tuple(position_degrees), samples.shape, noise)

    def color_from_gradients(
        self, gradients: NDArray[Any], x_px: NDArray[Any], y_px: NDArray[Any]
    ) -> NDArray[np.float64]:
        """Expected color change (N, 3) of gradients (N, 2) at pixel positions (N,)."""
        x, y = unit_position(x_px, y_px, self.shape)
        change: NDArray[np.float64] = (
            polynomial_terms(gradients, x, y, self.position_degrees) @ self.coefficients
        )
        return change
