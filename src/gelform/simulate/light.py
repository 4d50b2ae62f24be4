"""Lights on a surface: Lambertian shading under near point lights with 1/d^2 falloff."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gelform.simulate.gel import Surface
from gelform.simulate.sensor import Led


def irradiance_from_surface(
    surface: Surface, leds: tuple[Led, ...], *, oversample: int = 1
) -> NDArray[np.float64]:
    """Light that a surface receives, averaged over each pixel.

    For an LED of strength I at d mm from a surface point with unit normal n, direction l:
    `E = I max(0, n . l)/d^2` (Lambert's cosine law and the inverse square law). Lights add up; one behind
    the surface gives nothing (the attached shadow).

    Parameters
    ----------
    surface : Surface on the subpixel grid
    leds : lights; `color` is I per channel
    oversample : subpixels per pixel along each axis

    Returns
    -------
    irradiance : (H, W, 3) float64, grey levels before vignetting
    """
    table = np.array([(*led.position_mm, *led.color) for led in leds], dtype=np.float64)
    height, width = (n // oversample for n in surface.depth_mm.shape)
    out = np.zeros((height, width, 3))
    x, y = surface.x_mm.ravel(), surface.y_mm.ravel()
    _shade(x, y, surface.depth_mm, surface.gradients, table, oversample, out)
    return out


@njit(cache=True)  # type: ignore[untyped-decorator]
def _shade(x: Any, y: Any, z: Any, gradients: Any, leds: Any, oversample: int, out: Any) -> None:
    share = 1.0 / (oversample * oversample)
    for i in range(out.shape[0] * oversample):
        for j in range(out.shape[1] * oversample):
            p, q = gradients[i, j, 0], gradients[i, j, 1]
            scale = share / np.sqrt(1 + p * p + q * q)
            pixel = out[i // oversample, j // oversample]
            for k in range(leds.shape[0]):
                dx, dy, dz = leds[k, 0] - x[j], leds[k, 1] - y[i], leds[k, 2] - z[i, j]
                facing = dz - p * dx - q * dy
                if facing > 0:
                    square = dx * dx + dy * dy + dz * dz
                    shading = scale * facing / (square * np.sqrt(square))
                    for c in range(3):
                        pixel[c] += leds[k, 3 + c] * shading
