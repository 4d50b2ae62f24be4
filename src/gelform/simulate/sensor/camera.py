"""The camera: the light from the gel to an image, by perspective, lens, levels, noise, response curve, JPEG."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
import scipy  # its parts load at first use
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.arrays import Array, Floats, Map, Mask, Numbers
from gelform.foundations.checks import check_is
from gelform.foundations.pictures import picture_bytes
from gelform.simulate.sensor.sensor import SHADING_DEGREES, SimulatedSensor

Maps = tuple[Map, Map]

_gray_levels = Kernel(
    "gray_levels",
    "f32[...] levels, u16[...]? drawn, f32[65536] normal, f32[points]? curve, out u8[...] gray, f32 variance, "
    "f32 gain",
)


def maps_from_depth(sensor: SimulatedSensor, depth_mm: Array) -> Maps | None:
    """The position on the gel's grid that each pixel sees, x and y (H, W) in pixels; None: its own position.

    A pinhole at height H over the middle sees the surface point at x (1 - z/H) in place of the plane's point x.
    Two fixed-point steps find it, enough for depths of a tenth of H.
    """
    optics = sensor.optics
    if optics.height_mm is None and optics.distortion == (0, 0):
        return None
    x, y = _undistorted(sensor)
    height, width = sensor.shape
    if optics.height_mm is None:
        return x, y
    cx, cy = np.float32((width - 1) / 2), np.float32((height - 1) / 2)
    depth = depth_mm.astype(np.float32)
    at_x, at_y = x, y
    for _ in range(2):
        z = cv2.remap(depth, at_x, at_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT_101)
        scale = 1 - z / np.float32(optics.height_mm)
        at_x, at_y = cx + (x - cx) * scale, cy + (y - cy) * scale
    return at_x, at_y


def px_from_mm(sensor: SimulatedSensor, points_mm: Array, depth_mm: float = 0.0) -> Numbers:
    """Pixels (N, 2) at which the camera sees points (N, 2) of the gel at one depth, mm from its center."""
    points = np.asarray(points_mm, dtype=np.float64).reshape(-1, 2)
    if sensor.optics.height_mm is not None:
        points = points / (1 - depth_mm / sensor.optics.height_mm)
    diagonal = np.hypot(*sensor.shape) / 2 * sensor.mm_per_px
    k1, k2 = sensor.optics.distortion
    square = np.sum(points**2, axis=1, keepdims=True) / diagonal**2
    image_px = points * (1 + k1 * square + k2 * square**2) / sensor.mm_per_px
    height, width = sensor.shape
    return np.asarray(image_px + np.array([(width - 1) / 2, (height - 1) / 2]), dtype=np.float64)


@lru_cache(maxsize=8)
def _undistorted(sensor: SimulatedSensor) -> Maps:
    """The position on the plane that each pixel sees, by Newton's method on the radius."""
    height, width = sensor.shape
    half = np.hypot(height, width) / 2
    x, y = np.meshgrid(np.arange(width) - (width - 1) / 2, np.arange(height) - (height - 1) / 2)
    apparent = np.hypot(x, y) / half
    k1, k2 = sensor.optics.distortion
    r = apparent.copy()
    for _ in range(8):
        r -= (r * (1 + k1 * r**2 + k2 * r**4) - apparent) / (1 + 3 * k1 * r**2 + 5 * k2 * r**4)
    scale = r / np.maximum(apparent, 1e-12)
    scale[apparent < 1e-9] = 1
    at_x, at_y = (width - 1) / 2 + x * scale, (height - 1) / 2 + y * scale
    return at_x.astype(np.float32), at_y.astype(np.float32)


def levels_from_irradiance(sensor: SimulatedSensor, irradiance: Array, *, maps: Maps | None = None) -> Array:
    """Noise-free, unquantized, linear gray levels (H, W, 3) of the light (H, W, 3) from the gel.

    The dtype stays. `maps` has the position in the light that each pixel sees (see `maps_from_depth`); None: its
    own.
    """
    light = irradiance
    if maps is not None:
        light = cv2.remap(light, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101)
    if sensor.blur_px > 0:
        light = cv2.GaussianBlur(light, (0, 0), sensor.blur_px, borderType=cv2.BORDER_REFLECT_101)
    gain, mixing, ambient = _gain_and_mixing(sensor, irradiance.dtype.name)
    levels = cv2.transform(cv2.multiply(light, gain), mixing)
    levels += ambient
    return np.asarray(levels)


@lru_cache(maxsize=8)
def _gain_and_mixing(sensor: SimulatedSensor, dtype: str) -> tuple[Array, Array, Array]:
    """Gain over the image (H, W, 3), 3x3 mixing of the channels, and the levels (H, W, 3) of ambient light."""
    x, y = sensor.grid_mm()
    corner = float(x[0, -1] ** 2 + y[-1, 0] ** 2)
    # Vignetting, 1 in the middle, 1 - vignetting in the corners, times each channel's shading.
    gain = (1 - sensor.vignetting * (x**2 + y**2) / corner)[..., None].repeat(3, axis=-1)
    if sensor.shading is not None:
        u, v = np.broadcast_arrays(x / x[0, -1], y / y[-1, 0])
        degree = SHADING_DEGREES[len(sensor.shading[0])]
        terms = np.stack([u ** (d - k) * v**k for d in range(degree + 1) for k in range(d + 1)], axis=-1)
        coefficients = np.asarray(sensor.shading, dtype=np.float64)
        scaled = np.concatenate([coefficients[:, :1], coefficients[:, :1] * coefficients[:, 1:]], axis=1)
        gain = gain * np.maximum(terms @ scaled.T, 0)
    mixing = np.asarray(sensor.crosstalk, dtype=np.float64) * np.asarray(sensor.white_balance)[:, None]
    mixing = mixing * sensor.optics.exposure
    ambient = (gain * np.asarray(sensor.ambient)) @ mixing.T  # neither blur nor lens changes uniform light
    return gain.astype(dtype), mixing.astype(dtype), ambient.astype(dtype)


def image_from_levels(
    sensor: SimulatedSensor, levels: Array, rng: np.random.Generator | None, *, quantise: bool = True
) -> Array:
    """The image of given levels: shot and read noise, response curve, rounded to 0-255, JPEG.

    Without `rng` there is no noise; without `quantise` levels are neither rounded, cut nor compressed. Noise is
    normal in 65536 steps, within 4.3 standard deviations.
    """
    if rng is not None:
        check_is(rng, np.random.Generator, "rng")
    noisy = rng is not None and (sensor.noise_sd > 0 or sensor.noise_gain > 0)
    drawn = draws(rng, levels.size).reshape(levels.shape) if rng is not None and noisy else None
    variance, gain, gamma = sensor.noise_sd**2, sensor.noise_gain, sensor.optics.response_gamma
    if not quantise:
        if drawn is not None:
            levels = levels + np.sqrt(variance + gain * np.maximum(levels, 0)) * normal_table()[drawn]
        return levels if gamma == 1 else 255 * (np.maximum(levels, 0) / 255) ** (1 / gamma)
    gray = np.empty(levels.shape, dtype=np.uint8)
    curve = None if gamma == 1 else response_table(gamma)
    _gray_levels(levels, drawn, normal_table(), curve, gray, variance, gain)
    if sensor.optics.jpeg_quality is None:
        return gray
    code = picture_bytes(gray, ".jpg", [cv2.IMWRITE_JPEG_QUALITY, sensor.optics.jpeg_quality])
    compressed = cv2.imdecode(np.frombuffer(code, np.uint8), cv2.IMREAD_COLOR)
    return np.asarray(cv2.cvtColor(compressed, cv2.COLOR_BGR2RGB))


def draws(rng: np.random.Generator, count: int) -> NDArray[np.uint16]:
    """Uniform random numbers of 16 bits, as indices of `normal_table`: four times as fast as normal numbers."""
    words = rng.integers(0, 2**64 - 1, size=-(-count // 4), dtype=np.uint64, endpoint=True)
    return words.view(np.uint16)[:count]


@lru_cache(maxsize=1)
def normal_table() -> Floats:
    """The normal distribution in 65536 equally likely steps, of variance 1: its inverse at their middles."""
    steps = scipy.special.ndtri((np.arange(65536) + 0.5) / 65536)
    return np.asarray(steps / np.sqrt(np.mean(steps**2)), dtype=np.float32)


@lru_cache(maxsize=8)
def response_table(gamma: float) -> Floats:
    """Gray levels of the response curve at evenly spaced square roots of the linear level, 0 to 1; measured error 5e-5."""
    return np.asarray(255 * np.linspace(0, 1, 4097) ** (2 / gamma), dtype=np.float32)


def saturated_from_levels(levels: Array) -> Mask:
    """Pixels (H, W) with some channel cut at 0 or 255."""
    return cv2.inRange(levels, (-0.5,) * 3, (255.5,) * 3) == 0
