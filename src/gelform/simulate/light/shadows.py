"""Cast shadows: which part of each light a pixel sees past the surface, and where some light is lost."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.simulate.gel.gel import Surface
from gelform.simulate.sensor.led import Led

SHARPEST = 1e-4  # of a sample: the penumbra of a light without size

_visible_lights = Kernel(
    "visible_lights",
    "f32[h,w] depth, f64[lights,4] leds, i64[lights] reach, out f32[lights,h,w] seen, f64 top, f64 sharpest",
)


def visible_from_surface(surface: Surface, leds: tuple[Led, ...]) -> NDArray[np.float32] | None:
    """The part of each light (lights, H, W), 0-1, that each sample of the surface sees; None: all of all.

    The ray from each sample to the light is followed a sample at a time until it is above the highest point.
    A light of diameter D at distance d is half hidden where the ray touches the surface. It is hidden where the
    surface stands s D/(2 d) above the ray at distance s along it, and seen in full where it stands as far
    below: the penumbra.
    """
    depth = surface.depth_mm.astype(np.float32)
    top = float(depth.max())
    if top <= 0:
        return None
    pitch = float(surface.x_mm[0, 1] - surface.x_mm[0, 0])
    table = np.array([(*led.position_mm, led.size_mm) for led in leds], dtype=np.float64)
    table[:, 0] = (table[:, 0] - surface.x_mm[0, 0]) / pitch
    table[:, 1] = (table[:, 1] - surface.y_mm[0, 0]) / pitch
    seen = np.ones((len(leds), *depth.shape), dtype=np.float32)
    hidden = _visible_lights(depth, table, _reach(table, depth.shape, top), seen, top, SHARPEST * pitch)
    return seen if hidden else None


def shadowed_from_surface(
    surface: Surface, leds: tuple[Led, ...], visible: NDArray[np.float32] | None
) -> NDArray[np.bool_]:
    """Where (H, W) at least half of some light is lost: behind the surface, or hidden by another part of it."""
    lost = np.zeros(surface.depth_mm.shape, dtype=bool) if visible is None else visible.min(axis=0) < 0.5
    x, y, z, g = surface.x_mm.ravel(), surface.y_mm.ravel(), surface.depth_mm, surface.gradients
    places = np.array([led.position_mm for led in leds], dtype=np.float64)
    far = np.abs(places[:, None, :2] - np.array([(x[0], y[0]), (x[-1], y[-1])])).max(axis=1)
    # A light is behind the surface where `z + g . (light - place)` is over it: possible on steep pixels alone.
    needed = np.maximum(places[:, 2] - z.max(), 0) / np.linalg.norm(far, axis=1)
    steep = np.abs(g) >= needed.min() / np.sqrt(2)
    row, column = np.nonzero(steep[..., 0] | steep[..., 1])
    to_x, to_y = places[:, 0, None] - x[column], places[:, 1, None] - y[row]
    reached = g[row, column, 0] * to_x + g[row, column, 1] * to_y
    lost[row, column] |= (places[:, 2, None] - z[row, column] <= reached).any(axis=0)
    return lost


def _reach(leds: NDArray[np.float64], shape: tuple[int, ...], top: float) -> NDArray[np.int64]:
    """How many samples a shadow of the highest point can be long, for the pixel farthest from each light."""
    height, width = shape
    far_x = np.maximum(np.abs(leds[:, 0]), np.abs(leds[:, 0] - (width - 1)))
    far_y = np.maximum(np.abs(leds[:, 1]), np.abs(leds[:, 1] - (height - 1)))
    clear = np.maximum(leds[:, 2] - top, 1e-3)
    reach = np.maximum(far_x, far_y) * top / clear + 2
    return np.minimum(reach, max(height, width)).astype(np.int64)
