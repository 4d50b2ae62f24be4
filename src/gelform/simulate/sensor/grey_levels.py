"""From linear levels to the image: noise, response curve, rounding, JPEG."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.special import ndtri

from gelform.simulate.sensor.sensor import SimulatedSensor

_NO_NOISE = np.zeros(0, dtype=np.uint16)
_NO_CURVE = np.zeros(0, dtype=np.float32)
CURVE_STEPS = 4096


def image_from_levels(
    sensor: SimulatedSensor, levels: NDArray[Any], rng: np.random.Generator | None, *, quantise: bool = True
) -> NDArray[Any]:
    """The image of given levels: shot and read noise, response curve, rounded to 0-255, JPEG.

    Without `rng` there is no noise; without `quantise` levels are neither rounded, cut nor compressed. Noise is
    normal in 65536 steps, so that none is beyond 4.3 standard deviations.
    """
    noise = _NO_NOISE
    if rng is not None and (sensor.noise_sd > 0 or sensor.noise_gain > 0):
        noise = draws(rng, levels.size)
    image = np.empty_like(levels)
    gamma = sensor.optics.response_gamma
    numbers = np.array([0, sensor.noise_sd**2, sensor.noise_gain, 255, 1 / 255, 1 / gamma, CURVE_STEPS])
    curve = response_table(gamma) if quantise and gamma != 1 else _NO_CURVE
    _expose(levels.reshape(-1), noise, normal_table(), numbers.astype(levels.dtype), curve, image.reshape(-1))
    if not quantise:
        return image
    grey = np.empty(levels.shape, dtype=np.uint8)
    _round(image.reshape(-1), grey.reshape(-1))
    return grey if sensor.optics.jpeg_quality is None else _compressed(grey, sensor.optics.jpeg_quality)


def draws(rng: np.random.Generator, count: int) -> NDArray[np.uint16]:
    """Even random numbers of 16 bits: places in `normal_table`, four times as fast as normal numbers."""
    words = rng.integers(0, 2**64 - 1, size=-(-count // 4), dtype=np.uint64, endpoint=True)
    return words.view(np.uint16)[:count]


@lru_cache(maxsize=1)
def normal_table() -> NDArray[np.float32]:
    """The normal distribution in 65536 equally likely steps, of variance 1: its inverse at their middles."""
    steps = ndtri((np.arange(65536) + 0.5) / 65536)
    return np.asarray(steps / np.sqrt(np.mean(steps**2)), dtype=np.float32)


@lru_cache(maxsize=8)
def response_table(gamma: float) -> NDArray[np.float32]:
    """Grey levels of the response curve at evenly spaced square roots of the linear level, 0 to 1."""
    return np.asarray(255 * np.linspace(0, 1, CURVE_STEPS + 1) ** (2 / gamma), dtype=np.float32)


def saturated_from_levels(levels: NDArray[Any]) -> NDArray[np.bool_]:
    """Where (H, W) some channel is cut at 0 or 255."""
    out = np.zeros(levels.shape[:2], dtype=bool)
    _cut(levels, out)
    return out


def _compressed(grey: NDArray[np.uint8], quality: int) -> NDArray[np.uint8]:
    done, code = cv2.imencode(
        ".jpg", cv2.cvtColor(grey, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality]
    )
    if not done:
        raise ValueError(f"Expected an image that JPEG can hold, got one of shape {grey.shape}.")
    return np.asarray(cv2.cvtColor(cv2.imdecode(code, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB))


@njit(cache=True, fastmath=True)  # type: ignore[untyped-decorator]
def _expose(levels: Any, noise: Any, normal: Any, numbers: Any, curve: Any, out: Any) -> None:
    """Noise of variance sd^2 + gain level, then the response curve: from its table where there is one."""
    zero, read, gain, full, unit, power, _ = numbers
    if noise.size > 0:
        for k in range(levels.size):  # apart from the look-up: a loop without one is a vector's
            out[k] = np.sqrt(read + gain * max(levels[k], zero))
        for k in range(levels.size):
            out[k] = levels[k] + out[k] * normal[noise[k]]
    else:
        out[:] = levels
    if curve.size > 0:
        last = numbers[6]
        for k in range(out.size):
            out[k] = last * np.sqrt(max(out[k], zero) * unit)
        for k in range(out.size):
            n = min(int(out[k]), curve.size - 2)
            out[k] = curve[n] + (out[k] - n) * (curve[n + 1] - curve[n])
    elif power != 1:
        for k in range(out.size):
            out[k] = full * (max(out[k], zero) * unit) ** power


@njit(cache=True)  # type: ignore[untyped-decorator]
def _round(values: Any, out: Any) -> None:
    for k in range(values.size):
        out[k] = np.uint8(min(max(np.rint(values[k]), 0), 255))


@njit(cache=True)  # type: ignore[untyped-decorator]
def _cut(levels: Any, out: Any) -> None:
    for i in range(levels.shape[0]):
        for j in range(levels.shape[1]):
            for c in range(3):
                if levels[i, j, c] < -0.5 or levels[i, j, c] > 255.5:
                    out[i, j] = True
