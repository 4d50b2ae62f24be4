"""Color models that know the lights: distant lights on a matt gel, and lamps near the gel.

Both are photometric stereo on the ratio of the image to the background image. At rest the normal is (0, 0, 1), so for fixed
lights `I/I0 = (l . n)/l_z`: albedo, vignetting and the lights' falloff cancel. The three rows `l/l_z = (a, b, 1)` are the
only unknowns (Woodham, Optical Engineering 19(1), 1980, eq. 7). Crosstalk makes a channel record a mixture of lights, which
acts as one light: the rows contain it, exactly if the mixture is the same everywhere. A camera whose levels are
light^response is made linear first.

A near light at S shines on a surface point X from the direction (S - X)/|S - X| with a strength that falls as
|S - X|^-falloff, so `E = n . (S - X)/|S - X|^(1 + falloff)` (R. Mecca et al., Near field photometric stereo with
point light sources, SIAM J. Imaging Sciences 7(4), 2014, eq. 3, at constant depth). Positions are in units of half the
image's larger side, about its center. Crosstalk mixes the lights into each channel; where all of them shine, the channel
is linear in the normal, with a separate light matrix at every pixel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np
import scipy  # its parts load at first use
from numpy.typing import ArrayLike

from gelform._native import Kernel
from gelform.arrays import Array, Map, Numbers, Slopes
from gelform.foundations.checks import LARGEST, check_response, check_values
from gelform.foundations.information import check_condition
from gelform.image.view import pixel_positions
from gelform.slopes.color_models.seam import (
    HUBER_SLOPE,
    Samples,
    Stored,
    Untuned,
    check_image_shape,
    robust_ridge,
    unit_position,
)

MAX_SLOPE = 5.0  # mm/mm, largest slope of pixels in shadow
DARKEST_RATIO = 0.02  # of the light at rest; a darker channel is in shadow, where the law does not hold
RESPONSES = (0.3, 1.6)  # range of exponents in a fit


def check_lights(lights: ArrayLike, dtype: Any = np.float32) -> Array:
    """Lights (3, 3), finite: row c is the direction toward the light of channel c times its strength."""
    matrix = check_values(lights, "lights", (3, 3), dtype)
    if matrix.ndim != 2:
        raise ValueError(f"Expected lights of shape (3, 3), one row per channel, got {matrix.shape}.")
    return matrix


def inverse_lights(lights: ArrayLike) -> Numbers:
    """Inverse of one light matrix (3, 3), checked; errors as of `inverted_lights`."""
    return inverted_lights(check_lights(lights, np.float64))


def inverted_lights(lights: Numbers) -> Numbers:
    """Inverses of light matrices (..., 3, 3); ValueError: lights are all dark, or coplanar or nearly so."""
    remedy = (
        "The lights are coplanar, or two are the same: light the gel from three different sides. If near lights were "
        "fitted, press at more places, or use the color model lambertian."
    )
    check_condition(lights, 1e4, "three lights from directions that span space", remedy)
    inverse = np.asarray(np.linalg.inv(lights), dtype=np.float64)
    if np.abs(inverse).max() > LARGEST:
        raise ValueError(f"Expected lights that are not all dark, got {np.abs(lights).max():.3g} at most.")
    return inverse


@dataclass(frozen=True)
class LambertianModel(Stored, Untuned):
    """Three fixed lights, each scaled to l_z = 1."""

    lights: Numbers  # (3, 3), rows (a, b, 1) for the channels R, G, B
    response: float = 1.0  # exponent of the camera's response, I = light^response

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

    def gradients_at(self, color_change: Array, x_px: Array, y_px: Array) -> Numbers:
        """Gradients (N, 2) of scattered pixels; with fixed lights they do not depend on the place."""
        change = linear_change(np.asarray(color_change, dtype=np.float64), self.response)
        return gradients_from_scaled(change, inverse_lights(self.lights))

    def prepare(self, background: Array, shape: tuple[int, int]) -> PreparedLambertian:
        """Prepare the inverse light matrix, for frames of any shape."""
        return PreparedLambertian(inverse_lights(self.lights).astype(np.float32), self.response)


@dataclass(frozen=True)
class PreparedLambertian:
    """The inverse of the light matrix, (3, 3) float32, and the camera's response."""

    inverse: Map
    response: float = 1.0

    def gradients_from_color(self, color_change: Map) -> tuple[Slopes, None]:
        """Gradients (H, W, 2) of a color change (H, W, 3); their deviation is in the calibration."""
        return gradients_from_scaled(linear_change(color_change, self.response), self.inverse), None

    def albedo_from_color(self, color_change: Map) -> Map:
        """Reflectance (H, W) relative to the gel at rest: the length of `L^-1 (1 + change)`."""
        g = linear_change(color_change, self.response) @ self.inverse.T + self.inverse.sum(axis=1)
        return np.linalg.norm(g, axis=-1).astype(np.float32)


def linear_change(change: Array, response: float) -> Array:
    """The change of light for a change of gray levels: `(I/I0)^(1/response) - 1`."""
    if response == 1:
        return change
    ratio = np.maximum(1 + change, change.dtype.type(0))
    linear: Array = ratio ** change.dtype.type(1 / response) - 1
    return linear


def gradients_from_scaled(change: Array, inverse: Array) -> Array:
    """Slopes -g_xy/g_z of `g = L^-1 (1 + change)`, of one matrix (3, 3) or one per pixel; MAX_SLOPE at most in shadow."""
    g = np.einsum("...ij,...j->...i", inverse, change) if inverse.ndim > 2 else change @ inverse.T
    g = g + inverse.sum(axis=-1)
    steepest = np.sqrt(g[..., 0] ** 2 + g[..., 1] ** 2) / MAX_SLOPE
    gradients: Array = -g[..., :2] / np.maximum(np.maximum(g[..., 2], steepest), 1e-6)[..., None]
    return gradients


def _fitted_lights(samples: Samples, response: float) -> Numbers:
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


def _misfit(samples: Samples, lights: Numbers, response: float) -> float:
    """Mean over the channels of the median |predicted - measured| color change where the gel is pressed."""
    pressed = np.any(samples.gradients != 0, axis=1)
    normals = np.concatenate([-samples.gradients, np.ones((len(samples.gradients), 1))], axis=1)[pressed]
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    predicted = np.maximum(normals @ lights.T, 0) ** response - 1
    return float(np.median(np.abs(predicted - samples.color_change[pressed]), axis=0).mean())


LEAST_RATIO = 1e-3  # of the light at rest; a channel with less is set to it
OFF_DIAGONAL = ~np.eye(3, dtype=bool)


class Toward(NamedTuple):
    """The vectors from pixels to the lights."""

    way: Numbers  # (N, 3 lights, 3) S - X
    # (N, 3 lights, 1) |S|^falloff / |S - X|^(1 + falloff): 1 over the distance, at the center
    strength: Numbers
    light: Numbers  # (N, 3 lights, 3), their product: the factor of a normal


def toward_lights(x: Numbers, y: Numbers, positions: Numbers, falloff: float) -> Toward:
    """Vectors from pixels (N,) to lights at positions (3, 3)."""
    way = positions - np.stack([x, y, np.zeros_like(x)], axis=-1)[:, None]
    square = np.einsum("nlk,nlk->nl", way, way)
    strength = (np.sum(positions**2, axis=1) / square) ** (falloff / 2) / np.sqrt(square)
    return Toward(way, strength[..., None], strength[..., None] * way)


def light_ratio(
    normals: Numbers, x: Numbers, y: Numbers, positions: Numbers, mixture: Numbers, falloff: float
) -> Numbers:
    """Light of each channel over that at rest, (N, 3), for normals (N, 3); a light behind the surface gives nothing."""
    light = toward_lights(x, y, positions, falloff).light
    lit = np.maximum(np.einsum("nlk,nk->nl", light, normals), 0)
    ratio: Numbers = lit @ mixture.T / (light[..., 2] @ mixture.T)
    return np.maximum(ratio, LEAST_RATIO)


def light_ratio_derivatives(
    normals: Numbers, x: Numbers, y: Numbers, positions: Numbers, mixture: Numbers, falloff: float
) -> tuple[Numbers, Numbers, Numbers]:
    """`light_ratio` (N, 3), and its derivatives by positions (N, 3, 9) and by the mixture off the diagonal (N, 3, 6)."""
    way, strength, light = toward_lights(x, y, positions, falloff)
    lit, rest = np.einsum("nlk,nk->nl", light, normals), light[..., 2]
    square = np.einsum("nlk,nlk->nl", way, way)
    growth = falloff * positions / np.sum(positions**2, axis=1)[:, None]
    growth = growth - (1 + falloff) * way / square[..., None]  # of the logarithm of the strength
    by_lit = (strength * normals[:, None] + lit[..., None] * growth) * (lit > 0)[..., None]
    by_rest = strength * np.array([0.0, 0.0, 1.0]) + rest[..., None] * growth
    lit = np.maximum(lit, 0)
    whole = rest @ mixture.T
    ratio = lit @ mixture.T / whole
    above = (ratio > LEAST_RATIO)[..., None] / whole[..., None]
    by_position = by_lit[:, None] - ratio[..., None, None] * by_rest[:, None]
    by_position *= (mixture * above)[..., None]
    by_mixture = np.zeros((len(x), 3, 3, 3))
    by_mixture[:, range(3), range(3)] = (lit[:, None] - ratio[..., None] * rest[:, None]) * above
    by_position = by_position.reshape(len(x), 3, -1)
    return np.maximum(ratio, LEAST_RATIO), by_position, by_mixture[:, :, OFF_DIAGONAL]


LEAST_PRESSED = 2 * (3 * 3 + np.count_nonzero(OFF_DIAGONAL) + 1)  # samples, twice the fitted parameters
FARTHEST = 20.0  # in half the image's larger side, height and distance of a light

_near_light_gradients = Kernel(
    "near_light_gradients",
    "f32[h,w,3] change, f32[3,3,h,w] inverse, out f32[h,w,2] gradients, f32 least_share",
)


@dataclass(frozen=True)
class NearLightModel(Stored, Untuned):
    """Three near lights, the mixture of them in each channel, and the camera's response."""

    # (3, 3), x, y from the image's center and height above the gel, of the main lights of R, G, B; times mm_per_px it is mm
    positions_px: Numbers
    mixture: Numbers  # (3, 3), row: channel, column: light; relative strength, 1 on the diagonal
    falloff: float  # exponent of the distance; 2 is a point light
    response: float  # exponent of the camera's response, I = light^response
    shape: tuple[int, int]  # (H, W) of the images it was fitted on

    name: ClassVar[str] = "near_light"
    change_offset: ClassVar[float] = 0.0

    @classmethod
    def fit(
        cls, samples: Samples, *, response: float | None = None, crosstalk: bool = True, falloff: float = 2.0
    ) -> NearLightModel:
        """Robust (soft l1) nonlinear least squares of the color change, from each channel's linear solution.

        The response is estimated within 0.3-1.6 by default. Give it if it is known, because on gentle slopes a smaller
        exponent looks like higher lights. Without `crosstalk` a channel records no more than its own light.
        """
        used = _pressed(samples)
        free = [value for c in range(3) for value in _start(used, c, response or 1.0)]
        low, high = [-FARTHEST, -FARTHEST, 0.05] * 3, [FARTHEST] * len(free)
        mixed = crosstalk * np.count_nonzero(OFF_DIAGONAL), 0.05, 0.0, 2.0
        for count, start, least, most in (mixed, (not response, 1.0, *RESPONSES)):
            free, low, high = free + count * [start], low + count * [least], high + count * [most]
        residuals, jacobian = _problem(used, crosstalk, response, falloff)
        limits = {"bounds": (low, high), "x_scale": "jac", "max_nfev": 60}
        fit = scipy.optimize.least_squares(residuals, free, jacobian, loss="soft_l1", f_scale=0.05, **limits)
        positions, mixture, exponent = _unpacked(fit.x, crosstalk, response)
        return cls(positions * max(samples.shape) / 2, mixture, falloff, exponent, samples.shape)

    def at_size(self, shape: tuple[int, int], wider: float) -> NearLightModel:
        """As `ColorModel.at_size`."""
        return replace(self, positions_px=self.positions_px / wider, shape=shape)

    def positions_mm(self, mm_per_px: float) -> Numbers:
        """Positions (3, 3) of the lights, mm from the point of the gel at the image's center."""
        return self.positions_px * mm_per_px

    def lights_at(self, x_px: Array, y_px: Array) -> Numbers:
        """Light matrices (N, 3, 3), rows (a, b, 1) for R, G, B, of equivalent fixed lights at each pixel."""
        x, y = unit_position(x_px, y_px, self.shape)
        light = toward_lights(x, y, 2 * self.positions_px / max(self.shape), self.falloff).light
        lights = np.einsum("cl,nlk->nck", self.mixture, light)
        return np.asarray(lights / lights[..., 2:], dtype=np.float64)

    def gradients_at(self, color_change: Array, x_px: Array, y_px: Array) -> Numbers:
        """Gradients (N, 2) of scattered pixels."""
        change = linear_change(np.asarray(color_change, dtype=np.float64), self.response)
        return gradients_from_scaled(change, inverted_lights(self.lights_at(x_px, y_px)))

    def prepare(self, background: Array, shape: tuple[int, int]) -> PreparedNearLight:
        """Prepare the inverse light matrix of every pixel."""
        check_image_shape(shape, self.shape)
        inverse = inverted_lights(self.lights_at(*pixel_positions(shape).T)).transpose(1, 2, 0)
        inverse_maps = np.ascontiguousarray(inverse.reshape(3, 3, *shape), dtype=np.float32)
        return PreparedNearLight(inverse_maps, self.response)


@dataclass(frozen=True)
class PreparedNearLight:
    """The inverse light matrix of every pixel, (3, 3, H, W) float32, and the camera's response."""

    inverse: Map
    response: float

    def gradients_from_color(self, color_change: Map) -> tuple[Slopes, None]:
        """Gradients (H, W, 2) of a color change (H, W, 3); their deviation is in the calibration."""
        gradients = np.empty((*color_change.shape[:2], 2), dtype=np.float32)
        light = np.ascontiguousarray(linear_change(color_change, self.response))
        _near_light_gradients(light, self.inverse, gradients, 1 / MAX_SLOPE)
        return gradients, None


def _pressed(samples: Samples) -> Samples:
    """Some 4000 samples that are pressed and lit, because at rest every light gives the ratio 1; neighbors say the same."""
    known = np.any(samples.gradients != 0, axis=1) & np.all(samples.color_change > DARKEST_RATIO - 1, axis=1)
    chosen = np.flatnonzero(known)
    if len(chosen) < LEAST_PRESSED:
        raise ValueError(f"Expected at least {LEAST_PRESSED} pressed and lit samples, got {len(chosen)}.")
    chosen = chosen[:: max(1, len(chosen) // 4000)]
    change = np.asarray(samples.color_change, dtype=np.float64)[chosen]
    x_px, y_px = samples.x_px[chosen], samples.y_px[chosen]
    return Samples(change, x_px, y_px, samples.gradients[chosen], samples.weight[chosen], samples.shape)


def _start(samples: Samples, channel: int, response: float) -> list[float]:
    """A light from one channel alone: `ratio length - 1 = -(a p + b q)` with a = (S_x - x)/S_z, b = (S_y - y)/S_z."""
    x, y = unit_position(samples.x_px, samples.y_px, samples.shape)
    p, q = samples.gradients.T
    ratio = 1 + linear_change(samples.color_change[:, channel], response)
    target = (ratio * np.sqrt(1 + p * p + q * q) - 1)[:, None]
    design = np.stack([-p, -q, p * x + q * y], axis=1)
    a, b, inverse_height = robust_ridge(design, target, samples.weight, ridge=1e-6, huber=HUBER_SLOPE)[:, 0]
    height = 1 / np.clip(inverse_height, 0.2, 5.0)
    inner = 0.9 * FARTHEST
    return [*np.clip([a * height, b * height], -inner, inner), float(height)]


def _problem(
    samples: Samples, crosstalk: bool, response: float | None, falloff: float
) -> tuple[Callable[[Numbers], Numbers], Callable[[Numbers], Numbers]]:
    """The least-squares problem for the fitted vector: residuals (3 N,) and their jacobian."""
    x, y = unit_position(samples.x_px, samples.y_px, samples.shape)
    normals = np.concatenate([-samples.gradients, np.ones((len(x), 1))], axis=1)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    weight = np.sqrt(samples.weight)[:, None]

    def residuals(values: Numbers) -> Numbers:
        positions, mixture, exponent = _unpacked(values, crosstalk, response)
        predicted = light_ratio(normals, x, y, positions, mixture, falloff) ** exponent - 1
        return ((predicted - samples.color_change) * weight).ravel()

    def jacobian(values: Numbers) -> Numbers:
        positions, mixture, exponent = _unpacked(values, crosstalk, response)
        ratio, by_position, by_mixture = light_ratio_derivatives(normals, x, y, positions, mixture, falloff)
        by_exponent = (ratio**exponent * np.log(ratio))[..., None]
        by_ratio = (exponent * ratio ** (exponent - 1))[..., None]
        parts = [by_ratio * by_position]
        parts += [by_ratio * by_mixture] if crosstalk else []
        parts += [] if response else [by_exponent]
        return (np.concatenate(parts, axis=-1) * weight[..., None]).reshape(3 * len(x), -1)

    return residuals, jacobian


def _unpacked(values: Numbers, crosstalk: bool, response: float | None) -> tuple[Numbers, Numbers, float]:
    """Positions (3, 3), mixture (3, 3), response from the fitted vector."""
    mixture = np.eye(3)
    if crosstalk:
        mixture[OFF_DIAGONAL] = values[9:15]
    return values[:9].reshape(3, 3), mixture, response or float(values[-1])
