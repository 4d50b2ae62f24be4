"""Photometric stereo with three fixed lights, on the ratio of the image to the background image.

At rest the normal is (0, 0, 1), so `I/I0 = (l . n)/l_z`: albedo, vignetting and the lights' falloff cancel. The
three rows `l/l_z = (a, b, 1)` are the only unknowns (Woodham, Optical Engineering 19(1), 1980, eq. 7).
Crosstalk makes a channel record a mixture of lights, which acts as one light: the rows contain it, exactly if the
mixture is the same everywhere. A camera whose levels are light^response is made linear first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import scipy  # its parts load at first use
from numpy.typing import ArrayLike, NDArray

from gelform.foundations.checks import LARGEST, check_response, check_values
from gelform.slopes.color_models._shared.least_squares import HUBER_SLOPE, robust_ridge
from gelform.slopes.color_models.seam import Samples, Stored, Untuned

MAX_CONDITION = 1e4  # of a light matrix; with a larger one, lights count as coplanar
MAX_SLOPE = 5.0  # mm/mm, largest slope of pixels in shadow
DARKEST_RATIO = 0.02  # of the light at rest; a darker channel is in shadow, where the law does not hold
RESPONSES = (0.3, 1.6)  # range of exponents in a fit


def inverse_lights(lights: ArrayLike) -> NDArray[np.float64]:
    """Inverse of the light matrix; an error if the lights are coplanar or nearly so."""
    matrix = check_values(lights, "lights", (3, 3), np.float64)
    if matrix.ndim != 2:
        raise ValueError(f"Expected lights of shape (3, 3), one row per channel, got {matrix.shape}.")
    condition = float(np.linalg.cond(matrix))
    if not condition < MAX_CONDITION:
        raise ValueError(
            f"Expected three lights from directions that span space, got a light matrix of condition number "
            f"{condition:.3g} (limit {MAX_CONDITION:g}): the lights are coplanar or two are the same. "
            "Light the gel from three different sides."
        )
    inverse = np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    if np.abs(inverse).max() > LARGEST:
        raise ValueError(f"Expected lights that are not all dark, got {np.abs(matrix).max():.3g} at most.")
    return inverse


@dataclass(frozen=True)
class LambertianModel(Stored, Untuned):
    """Three fixed lights, each scaled to l_z = 1.

    Attributes
    ----------
    lights : (3, 3) float64, rows (a, b, 1) for the channels R, G, B
    response : exponent of the camera's response, I = light^response
    """

    lights: NDArray[np.float64]
    response: float = 1.0

    def __post_init__(self) -> None:
        check_response(self.response)

    name: ClassVar[str] = "lambertian"
    change_offset: ClassVar[float] = 0.0

    @classmethod
    def fit(cls, samples: Samples, *, response: float | None = None) -> LambertianModel:
        """Lights by robust least squares: `(I/I0) sqrt(1 + p^2 + q^2) - 1 = -(a p + b q)`, shadows left out.

        The response, if not given, is the exponent from 0.3 to 1.6 with the smallest median error.
        """
        if response is not None and not response > 0:
            raise ValueError(f"Expected a response > 0, got {response}.")
        if response is None:
            tried = scipy.optimize.minimize_scalar(
                lambda exponent: _misfit(samples, _fitted_lights(samples, exponent), exponent),
                bounds=RESPONSES, method="bounded", options={"xatol": 1e-4},
            )  # fmt: skip
            response = float(tried.x)
        lights = _fitted_lights(samples, response)
        inverse_lights(lights)
        return cls(lights, response)

    def gradients_at(
        self, color_change: NDArray[Any], x_px: NDArray[Any], y_px: NDArray[Any]
    ) -> NDArray[np.float64]:
        """Gradients (N, 2) of scattered pixels; with fixed lights they do not depend on the place."""
        change = linear_change(np.asarray(color_change, dtype=np.float64), self.response)
        return gradients_from_scaled(change, inverse_lights(self.lights))

    def prepare(self, background: NDArray[Any], shape: tuple[int, int]) -> PreparedLambertian:
        """Prepare the inverse light matrix, for frames of any shape."""
        return PreparedLambertian(inverse_lights(self.lights).astype(np.float32), self.response)


@dataclass(frozen=True)
class PreparedLambertian:
    """The inverse of the light matrix, (3, 3) float32, and the camera's response."""

    inverse: NDArray[np.float32]
    response: float = 1.0

    def gradients_from_color(self, color_change: NDArray[np.float32]) -> tuple[NDArray[np.float32], None]:
        """Gradients (H, W, 2) of a color change (H, W, 3); their deviation is in the calibration."""
        return gradients_from_scaled(linear_change(color_change, self.response), self.inverse), None

    def albedo_from_color(self, color_change: NDArray[np.float32]) -> NDArray[np.float32]:
        """Reflectance (H, W) relative to the gel at rest: the length of `L^-1 (1 + change)`."""
        g = linear_change(color_change, self.response) @ self.inverse.T + self.inverse.sum(axis=1)
        return np.linalg.norm(g, axis=-1).astype(np.float32)


def linear_change(change: NDArray[Any], response: float) -> NDArray[Any]:
    """The change of light for a change of gray levels: `(I/I0)^(1/response) - 1`."""
    if response == 1:
        return change
    ratio = np.maximum(1 + change, change.dtype.type(0))
    linear: NDArray[Any] = ratio ** change.dtype.type(1 / response) - 1
    return linear


def gradients_from_scaled(change: NDArray[Any], inverse: NDArray[Any]) -> NDArray[Any]:
    """Slopes -g_xy/g_z of `g = L^-1 (1 + change)`; a pixel in shadow, with g_z near 0, gets at most MAX_SLOPE.

    `inverse` is one matrix (3, 3), or one per pixel (..., 3, 3).
    """
    g = np.einsum("...ij,...j->...i", inverse, change) if inverse.ndim > 2 else change @ inverse.T
    g = g + inverse.sum(axis=-1)
    steepest = np.sqrt(g[..., 0] ** 2 + g[..., 1] ** 2) / MAX_SLOPE
    gradients: NDArray[Any] = -g[..., :2] / np.maximum(np.maximum(g[..., 2], steepest), 1e-6)[..., None]
    return gradients


def _fitted_lights(samples: Samples, response: float) -> NDArray[np.float64]:
    """Rows (a, b, 1) for a given response."""
    ratio = 1 + linear_change(np.asarray(samples.color_change, dtype=np.float64), response)
    length = np.sqrt(1 + np.sum(samples.gradients**2, axis=1))
    lights = np.ones((3, 3))
    for channel in range(3):
        lit = ratio[:, channel] > DARKEST_RATIO
        target = (ratio[lit, channel] * length[lit] - 1)[:, None]
        design, weight = -samples.gradients[lit], samples.weight[lit]
        lights[channel, :2] = robust_ridge(design, target, weight, ridge=1e-9, huber=HUBER_SLOPE)[:, 0]
    return lights


def _misfit(samples: Samples, lights: NDArray[np.float64], response: float) -> float:
    """Mean over the channels of the median |predicted - measured| color change where the gel is pressed."""
    pressed = np.any(samples.gradients != 0, axis=1)
    normals = np.concatenate([-samples.gradients, np.ones((len(samples.gradients), 1))], axis=1)[pressed]
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    predicted = np.maximum(normals @ lights.T, 0) ** response - 1
    return float(np.median(np.abs(predicted - samples.color_change[pressed]), axis=0).mean())
