"""What the camera makes of light: blur, vignetting, crosstalk, white balance, noise, grey levels."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.simulate.sensor import SimulatedSensor


def levels_from_irradiance(sensor: SimulatedSensor, irradiance: NDArray[Any]) -> NDArray[np.float64]:
    """Noise-free, unquantised grey levels (H, W, 3) float64 of the light (H, W, 3) on the gel."""
    light = irradiance + np.asarray(sensor.ambient, dtype=np.float64)
    if sensor.blur_px > 0:
        light = cv2.GaussianBlur(light, (0, 0), sensor.blur_px, borderType=cv2.BORDER_REFLECT_101)
    mixing = np.asarray(sensor.crosstalk, dtype=np.float64) * np.asarray(sensor.white_balance)[:, None]
    return np.asarray((light * _vignette(sensor)[..., None]) @ mixing.T, dtype=np.float64)


def image_from_levels(
    sensor: SimulatedSensor, levels: NDArray[Any], rng: np.random.Generator | None, *, quantise: bool = True
) -> NDArray[Any]:
    """The image of given levels: shot and read noise (none where `rng` is None), rounded, cut at 0 and 255.

    Without `quantise` float64 levels that are neither rounded nor cut.
    """
    image = np.array(levels, dtype=np.float64)
    if rng is not None and (sensor.noise_sd > 0 or sensor.noise_gain > 0):
        variance = sensor.noise_sd**2 + sensor.noise_gain * np.maximum(levels, 0)
        image += np.sqrt(variance) * rng.standard_normal(levels.shape)
    if not quantise:
        return image
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def _vignette(sensor: SimulatedSensor) -> NDArray[np.float64]:
    """1 in the middle, 1 - vignetting in the corners (H, W)."""
    x, y = sensor.grid_mm()
    corner = float(x[0, -1] ** 2 + y[-1, 0] ** 2)
    return np.asarray(1 - sensor.vignetting * (x**2 + y**2) / corner, dtype=np.float64)
