"""Cast shadows: which part of each light a pixel sees past the surface, and where some light is lost."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gelform.simulate.gel.gel import Surface
from gelform.simulate.sensor.led import Led

RAISED = 0.02  # of the deepest point: lower surface casts no shadow worth marching for


def visible_from_surface(surface: Surface, leds: tuple[Led, ...]) -> NDArray[np.float32]:
    """The part of each light (lights, H, W), 0-1, that each sample of the surface sees.

    The ray from each sample to the light is followed a sample at a time until it is above the highest point.
    A light of diameter D at distance d is half hidden where the ray touches the surface. It is hidden where the
    surface stands s D/(2 d) above the ray at distance s along it, and seen in full where it stands as far
    below: the penumbra.
    """
    depth = surface.depth_mm.astype(np.float32)
    seen = np.ones((len(leds), *depth.shape), dtype=np.float32)
    top = float(depth.max())
    raised = depth > RAISED * top
    if top <= 0 or not raised.any():
        return seen
    rows, columns = np.flatnonzero(raised.any(axis=1)), np.flatnonzero(raised.any(axis=0))
    box = np.array([rows[0], rows[-1], columns[0], columns[-1]])
    table = np.array([(*led.position_mm, led.size_mm) for led in leds], dtype=np.float64)
    x0, y0 = float(surface.x_mm[0, 0]), float(surface.y_mm[0, 0])
    pitch = float(surface.x_mm[0, 1] - surface.x_mm[0, 0])
    _march(depth, x0, y0, pitch, table, box, top, seen)
    return seen


def shadowed_from_surface(
    surface: Surface, leds: tuple[Led, ...], visible: NDArray[np.float32] | None
) -> NDArray[np.bool_]:
    """Where (H, W) at least half of some light is lost: behind the surface, or hidden by another part of it."""
    lost = np.zeros(surface.depth_mm.shape, dtype=bool) if visible is None else visible.min(axis=0) < 0.5
    places = np.array([led.position_mm for led in leds], dtype=np.float64)
    _behind(surface.x_mm.ravel(), surface.y_mm.ravel(), surface.depth_mm, surface.gradients, places, lost)
    return lost


@njit(cache=True)  # type: ignore[untyped-decorator]
def _behind(x: Any, y: Any, z: Any, g: Any, leds: Any, lost: Any) -> None:
    """Row by row; a light that stands over the row's steepest possible plane is passed by."""
    for i in range(y.size):
        slope_x, slope_y, top = 0.0, 0.0, z[i, 0]
        for j in range(x.size):
            slope_x, slope_y = max(slope_x, abs(g[i, j, 0])), max(slope_y, abs(g[i, j, 1]))
            top = max(top, z[i, j])
        for k in range(leds.shape[0]):
            dy = leds[k, 1] - y[i]
            far = max(abs(leds[k, 0] - x[0]), abs(leds[k, 0] - x[-1]))
            if slope_x * far + slope_y * abs(dy) < leds[k, 2] - top:
                continue
            for j in range(x.size):
                reached = g[i, j, 0] * (leds[k, 0] - x[j]) + g[i, j, 1] * dy
                lost[i, j] |= leds[k, 2] - z[i, j] <= reached


@njit(cache=True, fastmath=True)  # type: ignore[untyped-decorator]
def _march(
    depth: Any, x0: float, y0: float, pitch: float, leds: Any, box: Any, top: float, seen: Any
) -> None:
    height, width = depth.shape
    for k in range(leds.shape[0]):
        reach = _reach(leds[k], x0, y0, pitch, height, width, top)
        for i in range(max(box[0] - reach, 0), min(box[1] + reach + 1, height)):
            for j in range(max(box[2] - reach, 0), min(box[3] + reach + 1, width)):
                dx, dy = (leds[k, 0] - x0) / pitch - j, (leds[k, 1] - y0) / pitch - i
                steps = max(abs(dx), abs(dy))
                if steps < 1:
                    continue
                step_x, step_y, step_z = dx / steps, dy / steps, (leds[k, 2] - depth[i, j]) / steps
                last = min(int((top - depth[i, j]) / step_z) + 1, int(steps))
                end_x, end_y = j + last * step_x, i + last * step_y
                if (
                    max(j, end_x) < box[2]
                    or min(j, end_x) > box[3]
                    or max(i, end_y) < box[0]
                    or min(i, end_y) > box[1]
                ):
                    continue
                soft = 0.5 * leds[k, 3] / steps + 1e-4 * pitch
                if abs(dx) >= abs(dy):
                    seen[k, i, j] = _least(depth, i, j, 1 if dx > 0 else -1, step_y, step_z, soft, last)
                else:
                    seen[k, i, j] = _least(depth.T, j, i, 1 if dy > 0 else -1, step_x, step_z, soft, last)


@njit(cache=True, fastmath=True)  # type: ignore[untyped-decorator]
def _least(
    depth: Any, i: int, j: int, along: int, aside: float, rise: float, soft: float, last: int
) -> float:
    """The least part of a light seen along a ray that goes one column a step and `aside` rows."""
    z, least, row = depth[i, j], 1.0, float(i)
    room = (depth.shape[1] - 1 - j) if along > 0 else j
    for s in range(1, min(last, room) + 1):
        row += aside
        n = int(row)
        if row < 0 or n + 1 >= depth.shape[0]:
            break
        v = row - n
        column = j + s * along
        there = (1 - v) * depth[n, column] + v * depth[n + 1, column]
        clear = z + s * rise - there
        if clear < s * soft * (2 * least - 1):
            least = 0.5 + 0.5 * clear / (s * soft)
            if least <= 0:
                return 0.0
    return least


@njit(cache=True)  # type: ignore[untyped-decorator]
def _reach(led: Any, x0: float, y0: float, pitch: float, height: int, width: int, top: float) -> int:
    """How many samples a shadow of the highest point can be long, for the pixel farthest from the light."""
    far_x = max(abs(led[0] - x0), abs(led[0] - x0 - pitch * (width - 1))) / pitch
    far_y = max(abs(led[1] - y0), abs(led[1] - y0 - pitch * (height - 1))) / pitch
    clear = max(led[2] - top, 1e-3)
    return int(min(max(far_x, far_y) * top / clear + 2, max(height, width)))
