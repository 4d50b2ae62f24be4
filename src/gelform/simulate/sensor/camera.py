"""What the camera makes of light: projection, blur, vignetting, crosstalk, noise, response, grey levels,
JPEG."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.special import ndtri

from gelform.simulate.sensor.sensor import SHADING_DEGREES, SimulatedSensor

_NO_NOISE = np.zeros(0, dtype=np.uint16)
_NO_CURVE = np.zeros(0, dtype=np.float32)
CURVE_STEPS = 4096
Maps = tuple[NDArray[np.float32], NDArray[np.float32]]


def levels_from_irradiance(
    sensor: SimulatedSensor, irradiance: NDArray[Any], *, maps: Maps | None = None
) -> NDArray[Any]:
    """Noise-free, unquantised, linear grey levels (H, W, 3) of the light (H, W, 3) from the gel.

    The dtype stays. `maps` says where in the light each pixel looks (see `maps_from_depth`); None:
    straight down.
    """
    light = irradiance
    if maps is not None:
        light = cv2.remap(light, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101)
    if sensor.blur_px > 0:
        light = cv2.GaussianBlur(light, (0, 0), sensor.blur_px, borderType=cv2.BORDER_REFLECT_101)
    dtype = irradiance.dtype
    mixing = np.asarray(sensor.crosstalk, dtype=np.float64) * np.asarray(sensor.white_balance)[:, None]
    mixing = (mixing * sensor.optics.exposure).astype(dtype)
    ambient = np.asarray(sensor.ambient, dtype=dtype)  # neither blur nor lens changes what is even
    levels = np.empty_like(light)
    _mix(light, ambient, _gain(sensor, dtype.name), mixing, levels)
    return levels


def image_from_levels(
    sensor: SimulatedSensor, levels: NDArray[Any], rng: np.random.Generator | None, *, quantise: bool = True
) -> NDArray[Any]:
    """The image of given levels: shot and read noise (none where `rng` is None), response, rounded, cut,
    JPEG.

    Without `quantise` levels that are neither rounded, cut at 0 and 255, nor compressed. Noise is normal, but
    for its 65536 steps: none is beyond 4.3 standard deviations.
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


def maps_from_depth(sensor: SimulatedSensor, depth_mm: NDArray[Any]) -> Maps | None:
    """Where on the gel's grid each pixel looks, x and y (H, W) in pixels; None: each at its own place.

    A pinhole at height H over the middle sees the surface point at x (1 - z/H) where the plane's point x
    would be; the
    point is found by two fixed-point steps, ample for depths of a tenth of H.
    """
    optics = sensor.optics
    if optics.is_plain:
        return None
    x, y = _undistorted(sensor)
    if optics.height_mm is None:
        return x, y
    height, width = sensor.shape
    cx, cy = (width - 1) / 2, (height - 1) / 2
    depth = depth_mm.astype(np.float32)
    at_x, at_y = x, y
    for _ in range(2):
        z = cv2.remap(depth, at_x, at_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)
        scale = 1 - z / np.float32(optics.height_mm)
        at_x, at_y = cx + (x - cx) * scale, cy + (y - cy) * scale
    return at_x.astype(np.float32), at_y.astype(np.float32)


def px_seen(sensor: SimulatedSensor, points_mm: NDArray[Any], depth_mm: float = 0.0) -> NDArray[np.float64]:
    """Pixels (N, 2) at which the camera sees points (N, 2) of the gel at one depth, mm from its centre."""
    points = np.asarray(points_mm, dtype=np.float64).reshape(-1, 2)
    if sensor.optics.height_mm is not None:
        points = points / (1 - depth_mm / sensor.optics.height_mm)
    diagonal = np.hypot(*sensor.shape) / 2 * sensor.mm_per_px
    k1, k2 = sensor.optics.distortion
    square = np.sum(points**2, axis=1, keepdims=True) / diagonal**2
    seen = points * (1 + k1 * square + k2 * square**2) / sensor.mm_per_px
    height, width = sensor.shape
    return np.asarray(seen + np.array([(width - 1) / 2, (height - 1) / 2]), dtype=np.float64)


def _compressed(grey: NDArray[np.uint8], quality: int) -> NDArray[np.uint8]:
    done, code = cv2.imencode(
        ".jpg", cv2.cvtColor(grey, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality]
    )
    if not done:
        raise ValueError(f"Expected an image that JPEG can hold, got one of shape {grey.shape}.")
    return np.asarray(cv2.cvtColor(cv2.imdecode(code, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB))


@lru_cache(maxsize=8)
def _gain(sensor: SimulatedSensor, dtype: str) -> NDArray[Any]:
    """Vignetting, 1 in the middle, 1 - vignetting in the corners, times each channel's shading: (H, W, 3)."""
    x, y = sensor.grid_mm()
    corner = float(x[0, -1] ** 2 + y[-1, 0] ** 2)
    vignette = (1 - sensor.vignetting * (x**2 + y**2) / corner)[..., None]
    if sensor.shading is None:
        return np.asarray(np.repeat(vignette, 3, axis=-1), dtype=dtype)
    u, v = np.broadcast_arrays(x / x[0, -1], y / y[-1, 0])
    degree = SHADING_DEGREES[len(sensor.shading[0])]
    terms = np.stack([u ** (d - k) * v**k for d in range(degree + 1) for k in range(d + 1)], axis=-1)
    coefficients = np.asarray(sensor.shading, dtype=np.float64)
    scaled = np.concatenate([coefficients[:, :1], coefficients[:, :1] * coefficients[:, 1:]], axis=1)
    return np.asarray(vignette * np.maximum(terms @ scaled.T, 0), dtype=dtype)


@lru_cache(maxsize=8)
def _undistorted(sensor: SimulatedSensor) -> Maps:
    """Where on the plane each pixel looks, by Newton's method on the radius."""
    height, width = sensor.shape
    half = np.hypot(height, width) / 2
    x, y = np.meshgrid(np.arange(width) - (width - 1) / 2, np.arange(height) - (height - 1) / 2)
    seen = np.hypot(x, y) / half
    k1, k2 = sensor.optics.distortion
    r = seen.copy()
    for _ in range(8):
        r -= (r * (1 + k1 * r**2 + k2 * r**4) - seen) / (1 + 3 * k1 * r**2 + 5 * k2 * r**4)
    scale = r / np.maximum(seen, 1e-12)
    scale[seen < 1e-9] = 1
    at_x, at_y = (width - 1) / 2 + x * scale, (height - 1) / 2 + y * scale
    return at_x.astype(np.float32), at_y.astype(np.float32)


@njit(cache=True, fastmath=True)  # type: ignore[untyped-decorator]
def _mix(light: Any, ambient: Any, gain: Any, mixing: Any, out: Any) -> None:
    """Ambient light, vignetting and shading, then crosstalk, white balance and exposure."""
    for i in range(light.shape[0]):
        for j in range(light.shape[1]):
            red = (light[i, j, 0] + ambient[0]) * gain[i, j, 0]
            green = (light[i, j, 1] + ambient[1]) * gain[i, j, 1]
            blue = (light[i, j, 2] + ambient[2]) * gain[i, j, 2]
            for c in range(3):
                out[i, j, c] = mixing[c, 0] * red + mixing[c, 1] * green + mixing[c, 2] * blue


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
