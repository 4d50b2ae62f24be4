"""The forward response: what colour change a gradient gives at a place, and how noisy it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.checks import check_within
from gelform.color_models._shared.least_squares import (
    polynomial_terms,
    position_powers,
    robust_ridge,
    term_count,
    unit_position,
)
from gelform.color_models.seam import Samples

HUBER_CHANGE = 0.05
RIDGE = 1e-5
DEPTH_DEGREE = 3
NOISES_OF_PRESSES = ("held_out_noise", "shadow_noise")


@dataclass(frozen=True)
class ForwardResponse:
    """Color change as a polynomial in the gradient whose coefficients vary over the image.

    Where it was fitted with depths it holds a second polynomial, in the normal's x and y and the depth. A
    pressed gel changes its colour where it is level too: on a real sensor by 3 to 25 %, the same at one place
    for balls of different size. No gradient can say that; the depth can. The normal's components stay under 1
    at the steepest rim, where a polynomial in the gradient runs away.

    Attributes
    ----------
    coefficients : (terms, 3) float64
        Of the gradient's terms; with depths, those of the normal's terms and of the depth's follow.
    position_degrees : degree in (x, y) of the linear, quadratic, cubic terms
    shape : (H, W)
    noise : (3,) float64, standard deviation of the color change about it, per channel
    held_out_noise : the same on presses that it was fitted without, about the slopes that a color model reads there which
        has not seen them either; RMS of the channels. None where nobody has looked
    shadow_noise : standard deviation of the darkness that slopes in contacts leave unexplained (`CastShadows`), of color
        change; None: presses of this sensor cast no shadows, or nobody has looked
    """

    coefficients: NDArray[np.float64]
    position_degrees: tuple[int, ...]
    shape: tuple[int, int]
    noise: NDArray[np.float64]
    held_out_noise: float | None = None
    shadow_noise: float | None = None

    @classmethod
    def fit(
        cls,
        samples: Samples,
        position_degrees: tuple[int, ...] = (3, 2, 1),
        *,
        depth_mm: NDArray[Any] | None = None,
    ) -> ForwardResponse:
        """Robust ridge regression of the color change on the terms; depth_mm (N,) where it is known."""
        x, y = unit_position(samples.x_px, samples.y_px, samples.shape)
        change = np.asarray(samples.color_change, dtype=np.float64)
        designs = [polynomial_terms(samples.gradients, x, y, position_degrees)]
        if depth_mm is not None:
            designs.append(_terms_with_depth(samples.gradients, depth_mm, x, y, position_degrees))
        parts = [robust_ridge(d, change, samples.weight, ridge=RIDGE, huber=HUBER_CHANGE) for d in designs]
        noise = 1.4826 * np.median(np.abs(designs[0] @ parts[0] - change), axis=0)
        return cls(np.concatenate(parts), tuple(position_degrees), samples.shape, noise)

    def __post_init__(self) -> None:
        if self.held_out_noise is not None:
            check_within(self.held_out_noise, "held_out_noise", 0, 1e3)
        if self.shadow_noise is not None:
            check_within(self.shadow_noise, "shadow_noise", 1e-6, 1e3)

    def settings(self) -> dict[str, Any]:
        """What is not an array, as a calibration keeps it."""
        noises = {name: getattr(self, name) for name in NOISES_OF_PRESSES}
        return {"position_degrees": list(self.position_degrees), **noises}

    @classmethod
    def from_settings(
        cls,
        coefficients: NDArray[np.float64],
        noise: NDArray[np.float64],
        shape: tuple[int, int],
        settings: dict[str, Any],
    ) -> ForwardResponse:
        """The response of two arrays and its `settings`; older ones lack some."""
        noises = {name: settings.get(name) for name in NOISES_OF_PRESSES}
        return cls(coefficients, tuple(settings["position_degrees"]), shape, noise, **noises)

    @property
    def knows_depth(self) -> bool:
        """Whether it was fitted with depths."""
        return len(self.coefficients) > self._gradient_terms

    def color_from_gradients(
        self,
        gradients: NDArray[Any],
        x_px: NDArray[Any],
        y_px: NDArray[Any],
        *,
        depth_mm: NDArray[Any] | None = None,
    ) -> NDArray[np.float64]:
        """Expected color change (N, 3) of gradients (N, 2), and depths (N,), at pixel positions (N,).

        Raises
        ------
        ValueError
            Depths are given and the response was fitted without.
        """
        x, y = unit_position(x_px, y_px, self.shape)
        count = self._gradient_terms
        if depth_mm is None:
            terms, coefficients = polynomial_terms(gradients, x, y, self.position_degrees), slice(count)
        elif self.knows_depth:
            terms = _terms_with_depth(gradients, depth_mm, x, y, self.position_degrees)
            coefficients = slice(count, None)
        else:
            raise ValueError(
                "Expected no depth_mm: this forward response was fitted without. Calibrate again."
            )
        change: NDArray[np.float64] = terms @ self.coefficients[coefficients]
        return change

    @property
    def _gradient_terms(self) -> int:
        return term_count(2, self.position_degrees)


def _terms_with_depth(
    gradients: NDArray[Any], depth_mm: NDArray[Any], x: Any, y: Any, position_degrees: tuple[int, ...]
) -> NDArray[np.float64]:
    """Terms of the normal's x and y, and the depth times terms of the place; all 0 where nothing is pressed."""
    slopes = np.asarray(gradients, dtype=np.float64)
    normals = slopes / np.sqrt(1 + np.sum(slopes**2, axis=-1, keepdims=True))
    depth = np.asarray(depth_mm, dtype=np.float64)
    place = [depth * x**i * y**j for i, j in position_powers(DEPTH_DEGREE)]
    return np.concatenate(
        [polynomial_terms(normals, x, y, position_degrees), np.stack(place, axis=1)], axis=1
    )
