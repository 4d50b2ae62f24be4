"""Light on a surface: near point lights with 1/d^2 falloff, beams, Lambertian and glossy shading."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.simulate.gel.gel import Surface
from gelform.simulate.sensor.led import Led

BLOCK_SAMPLES = 1 << 14  # of the surface at once in numpy: what the processor's cache holds

_irradiance = Kernel(
    "irradiance",
    "f64[w] x, f64[h] y, f64[h,w] z, f64[h,w,2] gradients, f32[h,w,2]? texture, f32[lights,10] leds, "
    "f32[lights,rows,columns]? visible, out f32[rows,columns,3] out, f32 specular, i32 doublings, i32 oversample",
)


def irradiance_from_surface(
    surface: Surface,
    leds: tuple[Led, ...],
    *,
    oversample: int = 1,
    texture: NDArray[Any] | None = None,
    specular: float = 0.0,
    shininess: int = 16,
    visible: NDArray[np.float32] | None = None,
    dtype: Any = np.float64,
) -> NDArray[Any]:
    """Light that a surface sends to the camera, averaged over each pixel.

    For an LED of strength I at d mm from a surface point with unit normal n, direction l:
    `E = I max(0, n . l)/d^2` (Lambert's cosine law and the inverse square law). Lights add up; one behind
    the surface gives nothing (the attached shadow). With a beam it is times cos^m of the angle to the LED's
    axis, with gloss `specular max(0, n . h)^s I/d^2` more, h halfway between l and the view (J. F. Blinn,
    Models of light reflection for computer synthesized pictures, SIGGRAPH 1977).

    Parameters
    ----------
    surface : Surface on the subpixel grid
    leds : lights; `color` is I per channel
    oversample : subpixels per pixel along each axis
    texture : (h, w, 2), slopes that shade beside those of the surface, on the subpixel grid
    specular, shininess : of the gloss
    visible : (lights, H, W), the part of each light that a pixel sees; see `shadows`
    dtype : of the result: float32 is twice as fast and good to 1e-6

    Returns
    -------
    irradiance : (H, W, 3), grey levels before vignetting
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
    rows = max(1, BLOCK_SAMPLES // (surface.depth_mm.shape[1] * oversample))
    for first in range(0, height, rows):
        at = slice(first, first + rows)
        fine = slice(first * oversample, (first + rows) * oversample)
        gradients = surface.gradients[fine] if texture is None else surface.gradients[fine] + texture[fine]
        part = Surface(surface.x_mm, surface.y_mm[fine], surface.depth_mm[fine], gradients, surface.contact)
        seen = None if visible is None else visible[:, at]
        out[at] = exact_irradiance(part, table, seen, oversample, specular, doublings)
    return out


def exact_irradiance(
    surface: Surface,
    table: NDArray[np.float64],
    visible: NDArray[np.float32] | None,
    oversample: int,
    specular: float,
    doublings: int,
) -> NDArray[np.float64]:
    """The same in double precision, of lights as rows of numbers: what the kernel is held to."""
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
def _table(leds: tuple[Led, ...]) -> NDArray[np.float64]:
    """Lights as rows of numbers: place, colour, axis, power of the beam."""
    axes = [np.subtract(led.aim_mm, led.position_mm) for led in leds]
    return np.array(
        [
            (*led.position_mm, *led.color, *(axis / np.linalg.norm(axis)), float(led.beam_power))
            for led, axis in zip(leds, axes)
        ]
    )
