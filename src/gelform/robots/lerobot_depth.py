"""Depth in 16 bits for LeRobot: v = 1000 + depth in um.

LeRobot writes integer depth images as 12-bit video and interprets them as millimeters. With this encoding its default
settings keep depth to a fraction of a micrometer, and "mm" means um. Depth in meters, as floats, is lost in that video.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.errors import DataError
from gelform.foundations.checks import check_values

ZERO_LEVEL, UM_PER_MM, MAX_LEVEL = 1000, 1000.0, 65535  # 16-bit levels: 1 um per step


def lerobot_levels_from_depth(depth_mm: ArrayLike) -> NDArray[np.uint16]:
    """Levels (..., H, W) uint16 of depth in mm, rounded to whole um.

    Parameters
    ----------
    depth_mm : (..., H, W), finite, -0.999 to 64.535 mm; level 0 is free to mean unknown

    Raises
    ------
    DataError
        Depth is out of range; nothing is clipped.
    ValueError, TypeError
        Depth contains NaN or is not numeric.
    """
    depth = np.asarray(check_values(depth_mm, "depth_mm", (), np.float64))
    levels = np.rint(depth * UM_PER_MM) + ZERO_LEVEL
    if levels.size and (levels.min() < 1 or levels.max() > MAX_LEVEL):
        raise DataError(
            f"Expected depth from -0.999 to 64.535 mm, which 1000 + depth in um holds in 16 bits, got {depth.min():.3f} "
            f"to {depth.max():.3f} mm. Look at the result's health: gels are not that thick."
        )
    return levels.astype(np.uint16)


def depth_from_lerobot_levels(levels: NDArray[Any]) -> NDArray[np.float32]:
    """Depth (..., H, W) float32, mm, from such levels: the nearest float32 to a whole number of um.

    Parameters
    ----------
    levels : (..., H, W), whole numbers, or floats if a video decoder interpolated

    Raises
    ------
    ValueError, TypeError
        The levels contain NaN or are not numeric.
    """
    values = np.asarray(check_values(levels, "levels", (), np.float64))
    return ((values - ZERO_LEVEL) / UM_PER_MM).astype(np.float32)
