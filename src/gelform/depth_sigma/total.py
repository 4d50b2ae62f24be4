"""What all slopes of a frame have wrong together, beside what each has: depth is off in proportion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.errors import ConvergenceError

_add_in_proportion = Kernel("add_in_proportion", "out f32[...] sigma, f32[...] depth, f32 share, f32 most")


def add_in_proportion(
    sigma: NDArray[np.float32], depth: NDArray[np.float32], share: float, most: float
) -> NDArray[np.float32]:
    """A standard deviation of depth (H, W) with an error of a share of the depth beside it, within `most`; in place.

    Raises
    ------
    ConvergenceError
        Beyond what float32 holds.
    """
    if _add_in_proportion(sigma, depth, share, most):
        raise ConvergenceError(
            "Expected a finite standard deviation of depth, got infinity or NaN. Slopes, their deviation or "
            "mm_per_px differ by more than float32 holds: check the calibration's scales."
        )
    return sigma
