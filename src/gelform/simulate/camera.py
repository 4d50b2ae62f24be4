"""What the camera makes of light: projection, blur, vignetting, crosstalk, noise, response, grey levels,
JPEG."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from gelform.simulate.sensor import SHADING_DEGREES, SimulatedSensor

_NO_NOISE = np.zeros(0, dtype=np.float32)
Maps = tuple[NDArray[np.float32], NDArray[np.float32]]


def levels_from_irradiance(
    sensor: SimulatedSensor, irradiance: NDArray[Any], *, maps: Maps | None = None
) -> NDArray[Any]:
    """Noise-free, unquantised, linear grey levels (H, W, 3) of the light (H, W, 3) from the gel.

    The dtype stays. `maps` says where in the light each pixel looks (see `maps_from_depth`); None:
    straight down.
    """
    light = irradiance + np.asarray(sensor.ambient, dtype=irradiance.dtype)
    if maps is not None:
        light = cv2.remap(light, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101)
    if sensor.blur_px > 0:
        light = cv2.GaussianBlur(light, (0, 0), sensor.blur_px, borderType=cv2.BORDER_REFLECT_101)
    mixing = np.asarray(sensor.crosstalk, dtype=np.float64) * np.asarray(sensor.white_balance)[:, None]
    mixing = (mixing * sensor.optics.exposure).astype(irradiance.dtype)
    return np.asarray(cv2.transform(light * _gain(sensor, irradiance.dtype.name), mixing))


def image_from_levels(
    sensor: SimulatedSensor, levels: NDArray[Any], rng: np.random.Generator | None, *, quantise: bool = True
) -> NDArray[Any]:
    """The image of given levels: shot and read noise (none where `rng` is None), response, rounded, cut,
    JPEG.

    Without `quantise` levels that are neither rounded, cut at 0 and 255, nor compressed.
    """
    noise = _NO_NOISE
    if rng is not None and (sensor.noise_sd > 0 or sensor.noise_gain > 0):
        noise = rng.standard_normal(levels.shape, dtype=levels.dtype.type)
    image = np.empty_like(levels)
    numbers = np.array(
        [0, sensor.noise_sd**2, sensor.noise_gain, 255, 1 / 255, 1 / sensor.optics.response_gamma]
    )
    _expose(levels.reshape(-1), noise.reshape(-1), numbers.astype(levels.dtype), image.reshape(-1))
    if not quantise:
        return image
    grey = np.empty(levels.shape, dtype=np.uint8)
    _round(image.reshape(-1), grey.reshape(-1))
    return grey if sensor.optics.jpeg_quality is None else _compressed(grey, sensor.optics.jpeg_quality)


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
def _expose(levels: Any, noise: Any, numbers: Any, out: Any) -> None:
    """Noise of variance sd^2 + gain level, then the response curve."""
    zero, read, gain, full, unit, power = numbers
    noisy = noise.size > 0
    for k in range(levels.size):
        level = levels[k]
        if noisy:
            level += np.sqrt(read + gain * max(level, zero)) * noise[k]
        if power != 1:
            level = full * (max(level, zero) * unit) ** power
        out[k] = level


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
