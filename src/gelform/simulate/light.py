"""From a gel surface to an image: light on the gel, then gel, coating and camera, as light meets them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import scipy  # its parts load at first use
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.arrays import Array, Floats, Map, Mask, Numbers, Slopes
from gelform.foundations.checks import check_is
from gelform.foundations.files import picture_bytes
from gelform.simulate.gel import Surface, flat_surface
from gelform.simulate.sensor import SHADING_DEGREES, Coating, Grid, Led, SimulatedSensor, Triple

_irradiance = Kernel(
    "irradiance",
    "f64[w] x, f64[h] y, f64[h,w] z, f64[h,w,2] gradients, f32[h,w,2]? texture, f32[lights,10] leds, "
    "f32[lights,rows,columns]? visible, out f32[rows,columns,3] out, f32 specular, i32 doublings, i32 oversample",
)

_visible_lights = Kernel(
    "visible_lights",
    "f32[h,w] depth, f64[lights,4] leds, i64[lights] reach, out f32[lights,h,w] seen, f64 top, f64 sharpest",
)


def irradiance_from_surface(
    surface: Surface,
    leds: tuple[Led, ...],
    *,
    oversample: int = 1,
    texture: Array | None = None,
    specular: float = 0.0,
    shininess: int = 16,
    visible: Map | None = None,
    dtype: Any = np.float64,
) -> Array:
    """Light from a surface to the camera, averaged over each pixel.

    For an LED of strength I at d mm from a surface point with unit normal n, direction l:
    `E = I max(0, n . l)/d^2` (Lambert's cosine law and the inverse square law). Lights add up; a light behind
    the surface gives nothing (the attached shadow). A beam multiplies E by cos^m of the angle to the LED's axis. Gloss
    adds `specular max(0, n . h)^s I/d^2`, with h halfway between l and the view (J. F. Blinn,
    Models of light reflection for computer synthesized pictures, SIGGRAPH 1977).

    `oversample` are the subpixels per pixel along each axis, on whose grid are the surface and `texture` (h, w, 2), slopes
    that shade in addition to those of the surface. `visible` (lights, H, W) is the part of each light that reaches a pixel
    (`visible_from_surface`). float32 as `dtype` is twice as fast as float64, and good to 1e-6. Returns (H, W, 3), gray
    levels before vignetting, where a light's `color` is I per channel.
    """
    doublings = int(shininess).bit_length() - 1
    table = _table(leds).astype(dtype)
    table[:, 3:6] /= oversample**2
    height, width = (n // oversample for n in surface.depth_mm.shape)
    if dtype == np.float32:
        out = np.zeros((height, width, 3), dtype=np.float32)
        x, y = surface.x_mm.ravel(), surface.y_mm.ravel()
        z, gradients = map(np.ascontiguousarray, (surface.depth_mm, surface.gradients))
        _irradiance(x, y, z, gradients, texture, table, visible, out, specular, doublings, oversample)
        return out
    out = np.empty((height, width, 3), dtype=dtype)
    rows = max(1, 2**14 // (surface.depth_mm.shape[1] * oversample))  # samples that fit the processor's cache
    for first in range(0, height, rows):
        at = slice(first, first + rows)
        fine = slice(first * oversample, (first + rows) * oversample)
        gradients = surface.gradients[fine] if texture is None else surface.gradients[fine] + texture[fine]
        part = Surface(surface.x_mm, surface.y_mm[fine], surface.depth_mm[fine], gradients, surface.contact)
        lit = None if visible is None else visible[:, at]
        out[at] = exact_irradiance(part, table, lit, oversample, specular, doublings)
    return out


def exact_irradiance(
    surface: Surface, table: Numbers, visible: Map | None, oversample: int, specular: float, doublings: int
) -> Numbers:
    """The same in double precision, with lights as rows of numbers: the reference for the kernel."""
    p, q = surface.gradients[..., 0], surface.gradients[..., 1]
    cosine = 1 / np.sqrt(1 + p**2 + q**2)
    height, width = (n // oversample for n in surface.depth_mm.shape)
    total = np.zeros((height, width, 3))
    for k, led in enumerate(table):
        dx, dy, dz = led[0] - surface.x_mm, led[1] - surface.y_mm, led[2] - surface.depth_mm
        near = 1 / np.sqrt(dx**2 + dy**2 + dz**2)
        lit = np.maximum(dz - p * dx - q * dy, 0) * cosine * near**3
        if specular > 0:
            half = np.maximum((1 + (dz - p * dx - q * dy) * near) * cosine, 0)
            gloss = (half**2 / (2 + 2 * dz * near)) ** (2.0 ** (doublings - 1))
            lit += np.where(lit > 0, specular * gloss * near**2, 0)
        if led[9] > 0:
            lit *= np.maximum(-(led[6] * dx + led[7] * dy + led[8] * dz) * near, 0) ** led[9]
        pixels = lit.reshape(height, oversample, width, oversample).sum(axis=(1, 3))
        total += (pixels if visible is None else pixels * visible[k])[..., None] * led[3:6]
    return total


@lru_cache(maxsize=8)
def _table(leds: tuple[Led, ...]) -> Numbers:
    """Lights as rows of numbers: position, color, axis, power of the beam."""
    axes = [np.subtract(led.aim_mm, led.position_mm) for led in leds]
    axes = [axis / np.linalg.norm(axis) for axis in axes]
    return np.array([(*led.position_mm, *led.color, *axis, led.beam_power) for led, axis in zip(leds, axes)])


def visible_from_surface(surface: Surface, leds: tuple[Led, ...]) -> Map | None:
    """The part of each light (lights, H, W), 0-1, that reaches each sample of the surface; None: all of it everywhere.

    The ray from each sample to the light is followed sample by sample until it is above the highest point.
    A light of diameter D at distance d is half hidden if the ray touches the surface. It is hidden if the surface stands
    s D/(2 d) above the ray at distance s along it, and fully visible if it stands as far below: the penumbra.
    """
    depth = surface.depth_mm.astype(np.float32)
    top = float(depth.max())
    if top <= 0:
        return None
    pitch = float(surface.x_mm[0, 1] - surface.x_mm[0, 0])
    table = np.array([(*led.position_mm, led.size_mm) for led in leds], dtype=np.float64)
    table[:, 0] = (table[:, 0] - surface.x_mm[0, 0]) / pitch
    table[:, 1] = (table[:, 1] - surface.y_mm[0, 0]) / pitch
    visible = np.ones((len(leds), *depth.shape), dtype=np.float32)
    hidden = _visible_lights(depth, table, _reach(table, depth.shape, top), visible, top, 1e-4 * pitch)
    return visible if hidden else None


def shadowed_from_surface(surface: Surface, leds: tuple[Led, ...], visible: Map | None) -> Mask:
    """Pixels (H, W) that lose at least half of some light: behind the surface, or hidden by another part of it."""
    lost = np.zeros(surface.depth_mm.shape, dtype=bool) if visible is None else visible.min(axis=0) < 0.5
    x, y, z, g = surface.x_mm.ravel(), surface.y_mm.ravel(), surface.depth_mm, surface.gradients
    places = np.array([led.position_mm for led in leds], dtype=np.float64)
    far = np.abs(places[:, None, :2] - np.array([(x[0], y[0]), (x[-1], y[-1])])).max(axis=1)
    # A light is behind the surface if `z + g . (light - place)` exceeds its height, which only steep pixels allow.
    needed = np.maximum(places[:, 2] - z.max(), 0) / np.linalg.norm(far, axis=1)
    steep = np.abs(g) >= needed.min() / np.sqrt(2)
    row, column = np.nonzero(steep[..., 0] | steep[..., 1])
    to_x, to_y = places[:, 0, None] - x[column], places[:, 1, None] - y[row]
    reached = g[row, column, 0] * to_x + g[row, column, 1] * to_y
    lost[row, column] |= (places[:, 2, None] - z[row, column] <= reached).any(axis=0)
    return lost


def _reach(leds: Numbers, shape: tuple[int, ...], top: float) -> NDArray[np.int64]:
    """Number of samples that a shadow of the highest point can be long, for the pixel farthest from each light."""
    height, width = shape
    far_x = np.maximum(np.abs(leds[:, 0]), np.abs(leds[:, 0] - (width - 1)))
    far_y = np.maximum(np.abs(leds[:, 1]), np.abs(leds[:, 1] - (height - 1)))
    clear = np.maximum(leds[:, 2] - top, 1e-3)
    reach = np.maximum(far_x, far_y) * top / clear + 2
    return np.minimum(reach, max(height, width)).astype(np.int64)


def spread_in_gel(light: Array, coating: Coating, mm_per_px: float) -> Array:
    """Light after scattering in the gel and one bounce between gel and walls.

    Both are wide blurs on a coarser grid; the first preserves the light's sum, the second adds to it.
    """
    spreads = (
        (coating.scattering, coating.scattering_mm / mm_per_px),
        (coating.interreflection, coating.interreflection_mm / mm_per_px),
    )
    wide = [(part, sigma) for part, sigma in spreads if part > 0]
    if not wide:
        return light
    width = light.shape[1]
    small = _coarser(light, min(sigma for _, sigma in wide) / 2)
    added = np.asarray(sum(part * _blurred(small, sigma * small.shape[1] / width) for part, sigma in wide))
    added = cv2.resize(added.astype(light.dtype), light.shape[1::-1], interpolation=cv2.INTER_CUBIC)
    return np.asarray(cv2.addWeighted(light, 1 - coating.scattering, added, 1, 0))


def _blurred(image: Array, sigma: float) -> Array:
    """Gaussian blur; a wide one uses a coarser grid."""
    if sigma < 6:
        return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma, borderType=cv2.BORDER_REFLECT))
    small = _coarser(image, sigma / 3)
    sigma = sigma * small.shape[1] / image.shape[1]
    small = cv2.GaussianBlur(small, (0, 0), sigma, borderType=cv2.BORDER_REFLECT)
    return np.asarray(cv2.resize(small, image.shape[1::-1], interpolation=cv2.INTER_CUBIC))


def _coarser(image: Array, factor: float) -> Array:
    """Means of an image over squares of as many whole pixels as the factor; not under two a side are left."""
    height, width = image.shape[:2]
    size = max(width // max(1, int(factor)), 2), max(height // max(1, int(factor)), 2)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))


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


def levels_from_irradiance(sensor: SimulatedSensor, light: Array, *, maps: Maps | None = None) -> Array:
    """Noise-free, unquantized, linear gray levels (H, W, 3) of the light (H, W, 3) from the gel.

    The dtype stays. `maps` has the position in the light that each pixel sees (see `maps_from_depth`); None: its
    own.
    """
    if maps is not None:
        light = cv2.remap(light, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101)
    if sensor.blur_px > 0:
        light = cv2.GaussianBlur(light, (0, 0), sensor.blur_px, borderType=cv2.BORDER_REFLECT_101)
    gain, mixing, ambient = _gain_and_mixing(sensor, light.dtype.name)
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


@lru_cache(maxsize=8)
def albedo_map(coating: Coating, shape: Grid, mm_per_px: float) -> Map:
    """Reflectance (H, W) of a gel without its markers: the albedo map and dust."""
    albedo = np.ones(shape, dtype=np.float32)
    if coating.albedo is not None:
        stretched = cv2.resize(coating.albedo.values, shape[::-1], interpolation=cv2.INTER_LINEAR)
        albedo = stretched.astype(np.float32)
    rng = np.random.default_rng([coating.seed, 1])
    for _ in range(coating.dust):
        at, size = rng.uniform(0, 1, 2) * shape[::-1], rng.uniform(0.04, 0.12) / mm_per_px
        level = rng.choice([rng.uniform(0.3, 0.8), rng.uniform(1.2, 1.8)])
        y, x = np.ogrid[: shape[0], : shape[1]]
        cover = np.clip(size + 0.5 - np.hypot(x - at[0], y - at[1]), 0, 1).astype(np.float32)
        albedo = np.asarray(albedo * (1 + cover * np.float32(level - 1)), dtype=np.float32)
    return albedo


def albedo_with_markers(sensor: SimulatedSensor, markers_mm: Numbers) -> Map:
    """Reflectance (H, W) on the gel's grid: dark dots with soft edges at the present positions (N, 2) of the markers."""
    coating, shape = sensor.coating, sensor.shape
    albedo = albedo_map(coating, shape, sensor.mm_per_px)
    if len(markers_mm) == 0:
        return albedo
    places = markers_mm / sensor.mm_per_px + (np.array(shape[::-1]) - 1) / 2
    radius, out = coating.marker_radius_mm / sensor.mm_per_px, albedo.copy()
    reach = int(radius) + 1
    row, column = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    x, y = (np.rint(places[:, k]).astype(np.intp)[:, None, None] for k in (0, 1))
    rows, columns = np.broadcast_arrays(y + row, x + column)
    away = np.hypot(columns - places[:, 0, None, None], rows - places[:, 1, None, None])
    cover = np.clip(radius + 0.5 - away, 0, 1)
    if coating.marker_broken:
        bites = coating.marker_bites(len(places))
        bitten = places + radius * np.where(np.isnan(bites), 9, bites)
        away = np.hypot(columns - bitten[:, 0, None, None], rows - bitten[:, 1, None, None])
        cover *= 1 - np.clip(0.6 * radius + 0.5 - away, 0, 1)
    shown = (cover > 0) & (rows >= 0) & (rows < shape[0]) & (columns >= 0) & (columns < shape[1])
    np.multiply.at(out, (rows[shown], columns[shown]), (1 - 0.9 * cover[shown]).astype(np.float32))
    return out


@lru_cache(maxsize=8)
def texture_gradients(coating: Coating, shape: Grid, mm_per_px: float, oversample: int) -> Slopes | None:
    """Slopes (h, w, 2) of roughness and scratches on the fine grid, or None where there are none.

    They are made on a grid of the pixels' pitch and stretched, so that the gel is the same for every oversample.
    """
    if coating.roughness == 0 and coating.scratches == 0:
        return None
    height = np.zeros(shape, dtype=np.float32)
    rng = np.random.default_rng([coating.seed, 2])
    if coating.roughness > 0:
        white = rng.standard_normal(shape).astype(np.float32)
        grain = cv2.GaussianBlur(white, (0, 0), max(coating.grain_mm / mm_per_px, 0.5))
        slope = np.std(np.gradient(grain, mm_per_px), dtype=np.float64)
        height += grain * np.float32(coating.roughness / slope)
    for _ in range(coating.scratches):  # grooves 2-8 um deep, 2-6 mm long, straight
        start = rng.uniform(0, 1, 2) * shape[::-1]
        angle, length = rng.uniform(0, np.pi), rng.uniform(2, 6) / mm_per_px
        end = start + length * np.array([np.cos(angle), np.sin(angle)])
        first, last = np.rint([start, end]).astype(int).tolist()
        groove = np.zeros(shape, dtype=np.float32)
        cv2.line(groove, first, last, 1.0, 1, cv2.LINE_8)
        height -= cv2.GaussianBlur(groove, (0, 0), 0.8) * np.float32(rng.uniform(0.002, 0.008))
    size = (shape[1] * oversample, shape[0] * oversample)
    slopes = [cv2.resize(s, size, interpolation=cv2.INTER_LINEAR) for s in np.gradient(height, mm_per_px)]
    return np.stack(slopes[::-1], axis=-1).astype(np.float32)


@dataclass(frozen=True)
class Rendered:
    """An image and its truth, on the image's grid; see `SimulatedPress`."""

    image: Array
    depth_mm: Numbers
    gradients: Numbers
    contact: Mask
    albedo: Map
    shadowed: Mask
    saturated: Mask
    markers_px: Numbers


def render(
    sensor: SimulatedSensor,
    surface: Surface,
    *,
    rng: np.random.Generator | None,
    oversample: int = 1,
    quantise: bool = True,
    markers_mm: Numbers | None = None,
    time_s: float = 0.0,
) -> Rendered:
    """The image of a gel surface on the grid of `sensor.grid_mm(oversample)`.

    Without `rng` there is no noise; without `quantise` levels are in double precision, neither rounded, cut nor compressed.
    `markers_mm` (N, 2) are the positions of the markers, at rest by default, and `time_s` is that since the LEDs were
    switched on, for their drift and flicker.
    """
    dtype = np.float32 if quantise else np.float64
    coarse = surface.middles(oversample)
    visible = visible_from_surface(coarse, sensor.leds) if sensor.cast_shadows else None
    light = irradiance_from_surface(
        surface,
        sensor.leds,
        oversample=oversample,
        texture=texture_gradients(sensor.coating, sensor.shape, sensor.mm_per_px, oversample),
        specular=sensor.coating.specular,
        shininess=sensor.coating.shininess,
        visible=visible,
        dtype=dtype,
    )
    markers = sensor.coating.markers_mm(sensor.shape, sensor.mm_per_px) if markers_mm is None else markers_mm
    albedo = albedo_with_markers(sensor, markers)
    lamps: Array = sensor.timing.light_at(time_s, sensor.shape[0]).astype(dtype)
    light = cv2.multiply(light, cv2.merge([albedo * lamps[..., channel] for channel in range(3)]))
    light = spread_in_gel(np.asarray(light), sensor.coating, sensor.mm_per_px)
    maps = maps_from_depth(sensor, coarse.depth_mm)
    levels = levels_from_irradiance(sensor, light, maps=maps)
    shadowed = shadowed_from_surface(coarse, sensor.leds, visible)
    depth, gradients, albedo, contact, shadowed = _truth(coarse, albedo, shadowed, maps)
    return Rendered(
        image=image_from_levels(sensor, levels, rng, quantise=quantise),
        depth_mm=depth,
        gradients=gradients,
        contact=contact,
        albedo=albedo,
        shadowed=shadowed,
        saturated=saturated_from_levels(levels),
        markers_px=px_from_mm(sensor, markers),
    )


def _truth(surface: Surface, albedo: Map, shadowed: Mask, maps: Maps | None) -> tuple[Array, ...]:
    """Depth, gradients, albedo, contact and shadow at the positions that the pixels see."""
    if maps is None:
        return surface.depth_mm, surface.gradients, albedo, surface.contact, shadowed
    numbers = [surface.depth_mm, surface.gradients[..., 0], surface.gradients[..., 1], albedo]
    packed = cv2.merge([np.asarray(number, dtype=np.float32) for number in numbers])
    looked_at = cv2.remap(packed, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101)
    flags = surface.contact.astype(np.uint8) + 2 * shadowed.astype(np.uint8)
    flags = cv2.remap(flags, *maps, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REFLECT_101)
    depth, bright = looked_at[..., 0].astype(np.float64), looked_at[..., 3].copy()
    return depth, looked_at[..., 1:3].astype(np.float64), bright, (flags & 1) > 0, flags > 1


def simulate_background(
    sensor: SimulatedSensor, rng: np.random.Generator | None, *, frames: int = 1, quantise: bool = True
) -> Array:
    """The background image, the mean of `frames` images if there are several.

    Returns
    -------
    image : (H, W, 3), uint8; float32 for several frames; float64 where not quantized
    """
    if frames < 1:
        raise ValueError(f"Expected frames >= 1, got {frames}.")
    surface = flat_surface(*sensor.grid_mm())
    images = [render(sensor, surface, rng=rng, quantise=quantise).image for _ in range(frames)]
    if frames == 1:
        return images[0]
    mean = np.mean(images, axis=0, dtype=np.float64)
    return np.asarray(mean, dtype=np.float32 if quantise else np.float64)


def exposed(sensor: SimulatedSensor, levels: float | Triple) -> SimulatedSensor:
    """The sensor with the white balance that gives its background image these mean gray levels."""
    flat = replace(sensor.linear(), white_balance=(1, 1, 1))
    light = simulate_background(flat, None, quantise=False)
    if light.mean(axis=(0, 1)).min() <= 0:
        raise ValueError(
            f"Expected light in every channel, got mean levels {light.mean(axis=(0, 1))} for {sensor.name!r}. "
            "Add an LED of the missing color (red, green, blue)."
        )
    wanted = np.broadcast_to(np.asarray(levels, dtype=np.float64), 3)
    gamma = sensor.optics.response_gamma
    mean_root = np.mean((light / 255) ** (1 / gamma), axis=(0, 1))  # the response of a gain is a gain
    gains = (wanted / (255 * mean_root)) ** gamma
    return replace(sensor, white_balance=(float(gains[0]), float(gains[1]), float(gains[2])))
