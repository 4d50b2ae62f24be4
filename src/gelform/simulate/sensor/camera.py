"""Linear grey levels of the light from the gel: projection, blur, vignetting, crosstalk, white balance."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.simulate.sensor.projection import Maps
from gelform.simulate.sensor.sensor import SHADING_DEGREES, SimulatedSensor


def levels_from_irradiance(
    sensor: SimulatedSensor, irradiance: NDArray[Any], *, maps: Maps | None = None
) -> NDArray[Any]:
    """Noise-free, unquantised, linear grey levels (H, W, 3) of the light (H, W, 3) from the gel.

    The dtype stays. `maps` says where in the light each pixel looks (see `maps_from_depth`); None:
    straight down.
    """
    light = irradiance
    if maps is not None:
        light = cv2.remap(light, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101)
    if sensor.blur_px > 0:
        light = cv2.GaussianBlur(light, (0, 0), sensor.blur_px, borderType=cv2.BORDER_REFLECT_101)
    gain, mixing, ambient = _gain_and_mixing(sensor, irradiance.dtype.name)
    levels = cv2.transform(cv2.multiply(light, gain), mixing)
    levels += ambient
    return np.asarray(levels)


@lru_cache(maxsize=8)
def _gain_and_mixing(sensor: SimulatedSensor, dtype: str) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Gain over the image (H, W, 3), 3x3 mixing of the channels, and the levels (H, W, 3) of ambient light."""
    gain = _gain(sensor)
    mixing = np.asarray(sensor.crosstalk, dtype=np.float64) * np.asarray(sensor.white_balance)[:, None]
    mixing = mixing * sensor.optics.exposure
    ambient = (gain * np.asarray(sensor.ambient)) @ mixing.T  # neither blur nor lens changes what is even
    return gain.astype(dtype), mixing.astype(dtype), ambient.astype(dtype)


def _gain(sensor: SimulatedSensor) -> NDArray[np.float64]:
    """Vignetting, 1 in the middle, 1 - vignetting in the corners, times each channel's shading: (H, W, 3)."""
    x, y = sensor.grid_mm()
    corner = float(x[0, -1] ** 2 + y[-1, 0] ** 2)
    vignette = (1 - sensor.vignetting * (x**2 + y**2) / corner)[..., None]
    if sensor.shading is None:
        return np.asarray(np.repeat(vignette, 3, axis=-1), dtype=np.float64)
    u, v = np.broadcast_arrays(x / x[0, -1], y / y[-1, 0])
    degree = SHADING_DEGREES[len(sensor.shading[0])]
    terms = np.stack([u ** (d - k) * v**k for d in range(degree + 1) for k in range(d + 1)], axis=-1)
    coefficients = np.asarray(sensor.shading, dtype=np.float64)
    scaled = np.concatenate([coefficients[:, :1], coefficients[:, :1] * coefficients[:, 1:]], axis=1)
    return np.asarray(vignette * np.maximum(terms @ scaled.T, 0), dtype=np.float64)
