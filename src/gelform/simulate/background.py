"""The image of the untouched gel, and the white balance that gives it wished grey levels."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.simulate.gel.gel import flat_surface
from gelform.simulate.light.render import render
from gelform.simulate.sensor.led import Triple
from gelform.simulate.sensor.sensor import SimulatedSensor


def simulate_background(
    sensor: SimulatedSensor, rng: np.random.Generator | None, *, frames: int = 1, quantise: bool = True
) -> NDArray[Any]:
    """The image of the untouched gel, the mean of `frames` images where there are several.

    Returns
    -------
    image : (H, W, 3), uint8; float32 for several frames; float64 where not quantised
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
    """The sensor with the white balance that gives its untouched image these mean grey levels."""
    flat = replace(sensor.linear(), white_balance=(1, 1, 1))
    light = simulate_background(flat, None, quantise=False)
    if light.mean(axis=(0, 1)).min() <= 0:
        raise ValueError(
            f"Expected light in every channel, got mean levels {light.mean(axis=(0, 1))} for {sensor.name!r}."
        )
    wanted = np.broadcast_to(np.asarray(levels, dtype=np.float64), 3)
    gamma = sensor.optics.response_gamma
    mean_root = np.mean((light / 255) ** (1 / gamma), axis=(0, 1))  # the response of a gain is a gain
    gains = (wanted / (255 * mean_root)) ** gamma
    return replace(sensor, white_balance=(float(gains[0]), float(gains[1]), float(gains[2])))
