"""What some ten seconds showed, for the checks that take too long for each frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Evidence:
    """The mean of the frames of some ten seconds.

    Attributes
    ----------
    time_s : when the last of them was captured
    image : (H, W, 3) float32, their mean, 0-255
    frames : how many
    start : (H, W, 3) float32, the untouched image from which the sequence started
    light : (H, W, 3) float32, how much brighter the smooth light is than then
    touched : (H, W) bool, where something may have touched meanwhile, with a margin
    contact : (H, W) bool, where a frame showed contact
    different : float, 0-1, share of the frames that differ from the untouched image nearly everywhere
    """

    time_s: float
    image: NDArray[np.float32]
    frames: int
    start: NDArray[np.float32]
    light: NDArray[np.float32]
    touched: NDArray[np.bool_]
    contact: NDArray[np.bool_]
    different: float = 0.0
