"""From a gel surface to an image: light, gel, coating, camera, in the order in which light meets them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.simulate.gel.gel import Surface, flat_surface
from gelform.simulate.light import (
    irradiance_from_surface,
    shadowed_from_surface,
    spread_in_gel,
    visible_from_surface,
)
from gelform.simulate.sensor.camera import (
    Maps,
    image_from_levels,
    levels_from_irradiance,
    maps_from_depth,
    px_from_mm,
    saturated_from_levels,
)
from gelform.simulate.sensor.coating import albedo_map, texture_gradients, with_markers
from gelform.simulate.sensor.sensor import SimulatedSensor, Triple


@dataclass(frozen=True)
class Rendered:
    """An image and its truth, on the image's grid; see `SimulatedPress`."""

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
    rng : for the noise; None: no noise
    quantise : False: levels in double precision, neither rounded, cut nor compressed
    markers_mm : (N, 2), positions of the markers; None: at rest
    time_s : time since the LEDs were switched on, for their drift and flicker
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
    albedo = _albedo(sensor, markers)
    lamps: NDArray[Any] = sensor.timing.light_at(time_s, sensor.shape[0]).astype(dtype)
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


def _truth(
    surface: Surface, albedo: NDArray[np.float32], shadowed: NDArray[np.bool_], maps: Maps | None
) -> tuple[NDArray[Any], ...]:
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


def _albedo(sensor: SimulatedSensor, markers_mm: NDArray[np.float64]) -> NDArray[np.float32]:
    """Reflectance (H, W) on the gel's grid, with the markers at their present positions."""
    albedo = albedo_map(sensor.coating, sensor.shape, sensor.mm_per_px)
    if len(markers_mm) == 0:
        return albedo
    places = markers_mm / sensor.mm_per_px + (np.array(sensor.shape[::-1]) - 1) / 2
    bites = sensor.coating.marker_bites(len(places)) if sensor.coating.marker_broken else None
    return with_markers(albedo, places, sensor.coating.marker_radius_mm / sensor.mm_per_px, bites)


def simulate_background(
    sensor: SimulatedSensor, rng: np.random.Generator | None, *, frames: int = 1, quantise: bool = True
) -> NDArray[Any]:
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
