"""From a gel surface to an image: light, gel, coating, camera, in the order in which light meets them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from gelform.simulate.gel.gel import Surface
from gelform.simulate.light.irradiance import irradiance_from_surface
from gelform.simulate.light.scattering import spread_in_gel
from gelform.simulate.light.shadows import shadowed_from_surface, visible_from_surface
from gelform.simulate.sensor.camera import levels_from_irradiance
from gelform.simulate.sensor.coating import albedo_map, texture_gradients, with_markers
from gelform.simulate.sensor.grey_levels import image_from_levels, saturated_from_levels
from gelform.simulate.sensor.projection import Maps, maps_from_depth, px_seen
from gelform.simulate.sensor.sensor import SimulatedSensor


@dataclass(frozen=True)
class Rendered:
    """An image and what is true of it, on the image's grid; see `SimulatedPress`."""

    image: NDArray[Any]
    depth_mm: NDArray[np.float64]
    gradients: NDArray[np.float64]
    contact: NDArray[np.bool_]
    albedo: NDArray[np.float32]
    shadowed: NDArray[np.bool_]
    saturated: NDArray[np.bool_]
    markers_px: NDArray[np.float64]


def render(
    sensor: SimulatedSensor,
    surface: Surface,
    *,
    rng: np.random.Generator | None,
    oversample: int = 1,
    quantise: bool = True,
    markers_mm: NDArray[np.float64] | None = None,
    time_s: float = 0.0,
) -> Rendered:
    """The image of a gel surface.

    Parameters
    ----------
    surface : on the grid of `sensor.grid_mm(oversample)`
    rng : for the noise; None makes none
    quantise : False: levels in double precision, neither rounded, cut nor compressed
    markers_mm : (N, 2), where the markers are; None: at rest
    time_s : since the LEDs were switched on, for their drift and flicker
    """
    dtype = np.float32 if quantise else np.float64
    coarse = middle_samples(surface, oversample)
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
    albedo = _albedo(sensor, markers)
    _dim(light, albedo, sensor.timing.light_at(time_s, sensor.shape[0])[:, 0].astype(dtype))
    light = spread_in_gel(light, sensor.coating, sensor.mm_per_px)
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
        markers_px=px_seen(sensor, markers),
    )


def _truth(
    surface: Surface, albedo: NDArray[np.float32], shadowed: NDArray[np.bool_], maps: Maps | None
) -> tuple[NDArray[Any], ...]:
    """Depth, gradients, albedo, contact, shadowed where each pixel looks."""
    if maps is None:
        return surface.depth_mm, surface.gradients, albedo, surface.contact, shadowed
    numbers = np.empty((*albedo.shape, 4), dtype=np.float32)
    _packed(surface.depth_mm, surface.gradients, albedo, numbers)
    seen = cv2.remap(numbers, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101)
    flags = surface.contact.astype(np.uint8) + 2 * shadowed.astype(np.uint8)
    flags = cv2.remap(flags, *maps, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REFLECT_101)
    depth, gradients = np.empty_like(surface.depth_mm), np.empty_like(surface.gradients)
    bright = np.empty_like(albedo)
    _unpacked(seen, depth, gradients, bright)
    return depth, gradients, bright, (flags & 1) > 0, flags > 1


def middle_samples(surface: Surface, oversample: int) -> Surface:
    """The surface at the pixels' centres."""
    if oversample == 1:
        return surface
    at = slice(oversample // 2, None, oversample)
    return Surface(
        surface.x_mm[:, at],
        surface.y_mm[at],
        np.ascontiguousarray(surface.depth_mm[at, at]),
        np.ascontiguousarray(surface.gradients[at, at]),
        np.ascontiguousarray(surface.contact[at, at]),
    )


def _albedo(sensor: SimulatedSensor, markers_mm: NDArray[np.float64]) -> NDArray[np.float32]:
    """Reflectance (H, W) on the gel's grid, its markers where they are now."""
    albedo = albedo_map(sensor.coating, sensor.shape, sensor.mm_per_px)
    if len(markers_mm) == 0:
        return albedo
    places = np.array([sensor.px_from_mm((x, y)) for x, y in markers_mm])
    return with_markers(albedo, places, sensor.coating.marker_radius_mm / sensor.mm_per_px)


@njit(cache=True)  # type: ignore[untyped-decorator]
def _dim(light: Any, albedo: Any, lamps: Any) -> None:
    """Times the reflectance (H, W) and the LEDs' light (H, 3), in place."""
    for i in range(light.shape[0]):
        for j in range(light.shape[1]):
            for c in range(3):
                light[i, j, c] *= albedo[i, j] * lamps[i, c]


@njit(cache=True)  # type: ignore[untyped-decorator]
def _packed(depth: Any, gradients: Any, albedo: Any, out: Any) -> None:
    for i in range(depth.shape[0]):
        for j in range(depth.shape[1]):
            out[i, j, 0], out[i, j, 3] = depth[i, j], albedo[i, j]
            out[i, j, 1], out[i, j, 2] = gradients[i, j, 0], gradients[i, j, 1]


@njit(cache=True)  # type: ignore[untyped-decorator]
def _unpacked(seen: Any, depth: Any, gradients: Any, albedo: Any) -> None:
    for i in range(depth.shape[0]):
        for j in range(depth.shape[1]):
            depth[i, j], albedo[i, j] = seen[i, j, 0], seen[i, j, 3]
            gradients[i, j, 0], gradients[i, j, 1] = seen[i, j, 1], seen[i, j, 2]
