"""Light on a surface: near point lights with 1/d^2 falloff, beams, Lambertian and glossy shading."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gelform.simulate.gel.gel import Surface
from gelform.simulate.sensor.led import Led

NO_SHADOWS = np.ones((0, 1, 1), dtype=np.float32)


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
    table = np.array([_row(led) for led in leds], dtype=dtype)
    height, width = (n // oversample for n in surface.depth_mm.shape)
    out = np.zeros((height, width, 3), dtype=dtype)
    x, y = surface.x_mm.ravel().astype(dtype), surface.y_mm.ravel().astype(dtype)
    gradients = surface.gradients.astype(dtype)
    if texture is not None:
        gradients = gradients + texture.astype(dtype)
    numbers = np.array([0, 1, 2, 1 / oversample**2, specular], dtype=dtype)
    doublings = int(shininess).bit_length() - 1
    seen = NO_SHADOWS if visible is None else visible
    _shade(x, y, surface.depth_mm.astype(dtype), gradients, table, seen, oversample, numbers, doublings, out)
    return out


def _row(led: Led) -> tuple[float, ...]:
    axis = np.subtract(led.aim_mm, led.position_mm)
    axis = axis / np.linalg.norm(axis)
    return (*led.position_mm, *led.color, *axis, float(led.beam_power))


@njit(cache=True, fastmath=True)  # type: ignore[untyped-decorator]
def _shade(
    x: Any,
    y: Any,
    z: Any,
    g: Any,
    leds: Any,
    seen: Any,
    oversample: int,
    numbers: Any,
    doublings: int,
    out: Any,
) -> None:
    """Row by row and light by light, so that the innermost loops are plain vectors of one type."""
    zero, one, share, specular = numbers[0], numbers[1], numbers[3], numbers[4]
    width = x.size
    p, q, cosine, near = np.empty_like(x), np.empty_like(x), np.empty_like(x), np.empty_like(x)
    row, gloss = np.empty_like(x), np.empty_like(x)
    light = np.empty((3, width), dtype=x.dtype)
    for i in range(y.size):
        light[:] = zero
        for j in range(width):
            p[j], q[j] = g[i, j, 0], g[i, j, 1]
            cosine[j] = one / np.sqrt(one + p[j] * p[j] + q[j] * q[j])
        for k in range(leds.shape[0]):
            led, dy = leds[k], leds[k, 1] - y[i]
            _lambert(x, z[i], p, q, cosine, led, dy, zero, one, near, row)
            if specular > zero:
                _add_gloss(x, z[i], p, q, cosine, led, dy, numbers, doublings, near, gloss, row)
            for _ in range(int(led[9])):
                for j in range(width):
                    along = led[6] * (x[j] - led[0]) - led[7] * dy + led[8] * (z[i, j] - led[2])
                    row[j] *= max(along * near[j], zero)
            if seen.shape[0] > 0:
                for j in range(width):
                    row[j] *= seen[k, i // oversample, j // oversample]
            for c in range(3):
                strength = led[3 + c] * share
                if strength > zero:
                    for j in range(width):
                        light[c, j] += strength * row[j]
        for j in range(width):
            for c in range(3):
                out[i // oversample, j // oversample, c] += light[c, j]


@njit(cache=True, fastmath=True)  # type: ignore[untyped-decorator]
def _lambert(
    x: Any, z: Any, p: Any, q: Any, cosine: Any, led: Any, dy: Any, zero: Any, one: Any, near: Any, row: Any
) -> None:
    lx, lz = led[0], led[2]
    for j in range(x.size):
        dx, dz = lx - x[j], lz - z[j]
        near[j] = one / np.sqrt(dx * dx + dy * dy + dz * dz)
    for j in range(x.size):  # apart from the loop above: one that writes two arrays is not vectorised
        facing = max(lz - z[j] - p[j] * (lx - x[j]) - q[j] * dy, zero)
        row[j] = facing * cosine[j] * near[j] * near[j] * near[j]


@njit(cache=True, fastmath=True)  # type: ignore[untyped-decorator]
def _add_gloss(
    x: Any,
    z: Any,
    p: Any,
    q: Any,
    cosine: Any,
    led: Any,
    dy: Any,
    numbers: Any,
    doublings: int,
    near: Any,
    gloss: Any,
    row: Any,
) -> None:
    zero, one, two, specular = numbers[0], numbers[1], numbers[2], numbers[4]
    lx, lz = led[0], led[2]
    for j in range(x.size):
        dx, dz = (lx - x[j]) * near[j], (lz - z[j]) * near[j]
        half = (dz + one - p[j] * dx - q[j] * dy * near[j]) * cosine[j]
        gloss[j] = max(half, zero) * max(half, zero) / (two + two * dz)  # squared: no root needed
    if doublings == 0:
        for j in range(x.size):
            gloss[j] = np.sqrt(gloss[j])
    for _ in range(doublings - 1):
        for j in range(x.size):
            gloss[j] *= gloss[j]
    for j in range(x.size):
        lit = one if row[j] > zero else zero
        row[j] += specular * gloss[j] * near[j] * near[j] * lit
