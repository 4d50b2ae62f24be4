"""Light that spreads in the gel, and light that bounces between gel and walls, before it is seen."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.simulate.sensor.coating import Coating


def spread_in_gel(light: NDArray[Any], coating: Coating, mm_per_px: float) -> NDArray[Any]:
    """Light after scattering in the gel and one bounce between gel and walls.

    Both are wide blurs, made on a coarser grid: one keeps the light's sum, the other adds to it.
    """
    wide = [
        (part, length_mm / mm_per_px)
        for part, length_mm in (
            (coating.scattering, coating.scattering_mm),
            (coating.interreflection, coating.interreflection_mm),
        )
        if part > 0
    ]
    if not wide:
        return light
    height, width = light.shape[:2]
    factor = max(1, int(min(sigma for _, sigma in wide) / 2))
    size = (max(width // factor, 2), max(height // factor, 2))
    small = cv2.resize(light, size, interpolation=cv2.INTER_AREA)
    added = sum(part * _blurred(small, sigma * size[0] / width) for part, sigma in wide)
    wide_light = cv2.resize(
        np.asarray(added, dtype=light.dtype), (width, height), interpolation=cv2.INTER_CUBIC
    )
    return np.asarray(cv2.addWeighted(light, 1 - coating.scattering, wide_light, 1, 0))


def _blurred(small: NDArray[Any], sigma: float) -> NDArray[Any]:
    """Gaussian blur; a wide one on a coarser grid still."""
    factor = max(1, int(sigma / 3))
    if factor == 1:
        return np.asarray(cv2.GaussianBlur(small, (0, 0), sigma, borderType=cv2.BORDER_REFLECT))
    height, width = small.shape[:2]
    size = (max(width // factor, 2), max(height // factor, 2))
    tiny = cv2.resize(small, size, interpolation=cv2.INTER_AREA)
    tiny = cv2.GaussianBlur(tiny, (0, 0), sigma * size[0] / width, borderType=cv2.BORDER_REFLECT)
    return np.asarray(cv2.resize(tiny, (width, height), interpolation=cv2.INTER_CUBIC))
