"""From linear levels to the image: noise, response curve, rounding, JPEG."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import scipy  # its parts load at first use
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.simulate.sensor.sensor import SimulatedSensor

CURVE_STEPS = 4096

_grey_levels = Kernel(
    "grey_levels",
    "f32[...] levels, u16[...]? drawn, f32[65536] normal, f32[points]? curve, out u8[...] grey, f32 variance, "
    "f32 gain",
)


def image_from_levels(
    sensor: SimulatedSensor, levels: NDArray[Any], rng: np.random.Generator | None, *, quantise: bool = True
) -> NDArray[Any]:
    """The image of given levels: shot and read noise, response curve, rounded to 0-255, JPEG.

    Without `rng` there is no noise; without `quantise` levels are neither rounded, cut nor compressed. Noise is
    normal in 65536 steps, so that none is beyond 4.3 standard deviations.
    """
    noisy = rng is not None and (sensor.noise_sd > 0 or sensor.noise_gain > 0)
    drawn = draws(rng, levels.size).reshape(levels.shape) if rng is not None and noisy else None
    variance, gain, gamma = sensor.noise_sd**2, sensor.noise_gain, sensor.optics.response_gamma
    if not quantise:
        return _unrounded(levels, drawn, variance, gain, gamma)
    grey = np.empty(levels.shape, dtype=np.uint8)
    curve = None if gamma == 1 else response_table(gamma)
    _grey_levels(levels, drawn, normal_table(), curve, grey, variance, gain)
    return grey if sensor.optics.jpeg_quality is None else _compressed(grey, sensor.optics.jpeg_quality)


def _unrounded(
    levels: NDArray[Any], drawn: NDArray[np.uint16] | None, variance: float, gain: float, gamma: float
) -> NDArray[Any]:
    """Levels with noise of a variance that grows with the level, behind the response curve itself."""
    if drawn is not None:
        levels = levels + np.sqrt(variance + gain * np.maximum(levels, 0)) * normal_table()[drawn]
    return levels if gamma == 1 else 255 * (np.maximum(levels, 0) / 255) ** (1 / gamma)


def draws(rng: np.random.Generator, count: int) -> NDArray[np.uint16]:
    """Even random numbers of 16 bits: places in `normal_table`, four times as fast as normal numbers."""
    words = rng.integers(0, 2**64 - 1, size=-(-count // 4), dtype=np.uint64, endpoint=True)
    return words.view(np.uint16)[:count]


@lru_cache(maxsize=1)
def normal_table() -> NDArray[np.float32]:
    """The normal distribution in 65536 equally likely steps, of variance 1: its inverse at their middles."""
    steps = scipy.special.ndtri((np.arange(65536) + 0.5) / 65536)
    return np.asarray(steps / np.sqrt(np.mean(steps**2)), dtype=np.float32)


@lru_cache(maxsize=8)
def response_table(gamma: float) -> NDArray[np.float32]:
    """Grey levels of the response curve at evenly spaced square roots of the linear level, 0 to 1."""
    return np.asarray(255 * np.linspace(0, 1, CURVE_STEPS + 1) ** (2 / gamma), dtype=np.float32)


def saturated_from_levels(levels: NDArray[Any]) -> NDArray[np.bool_]:
    """Where (H, W) some channel is cut at 0 or 255."""
    return cv2.inRange(levels, (-0.5,) * 3, (255.5,) * 3) == 0


def _compressed(grey: NDArray[np.uint8], quality: int) -> NDArray[np.uint8]:
    done, code = cv2.imencode(
        ".jpg", cv2.cvtColor(grey, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality]
    )
    if not done:
        raise ValueError(f"Expected an image that JPEG can hold, got one of shape {grey.shape}.")
    return np.asarray(cv2.cvtColor(cv2.imdecode(code, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB))
