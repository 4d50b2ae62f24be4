"""Depth in LeRobot's 16 bits: v = 1000 + depth in um.

LeRobot writes depth images of integers as video of 12 bits, and takes them for millimetres. In this encoding its
default settings keep depth to a fraction of a micrometre; "mm" then means um. Depth in metres, as floats, is lost in it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.errors import DataError
from gelform.foundations.checks import check_values

ZERO_LEVEL, UM_PER_MM, MAX_LEVEL = 1000, 1000.0, 65535  # of 16 bits: 1 um a step


def lerobot_levels_from_depth(depth_mm: ArrayLike) -> NDArray[np.uint16]:
    """Levels (..., H, W) uint16 of depth in mm, rounded to whole um.

    Parameters
    ----------
    depth_mm : (..., H, W), finite, -0.999 to 64.535 mm; level 0 is left to those who mean unknown by it

    Raises
    ------
    DataError
        Depth out of range: nothing is clipped.
    ValueError, TypeError
        NaN, or no numbers.
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
    """Depth (..., H, W) float32, mm, of such levels: the nearest float32 to a whole number of um.

    Parameters
    ----------
    levels : (..., H, W) of whole numbers, or of floats where a video decoder gave parts of one

    Raises
    ------
    ValueError, TypeError
        NaN, or no numbers.
    """
    values = np.asarray(check_values(levels, "levels", (), np.float64))
    return ((values - ZERO_LEVEL) / UM_PER_MM).astype(np.float32)
