"""Photometric stereo with three fixed lights."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

MAX_CONDITION = 1e4


def inverse_lights(lights: ArrayLike) -> NDArray[np.float64]:
    """Inverse of the light matrix, refused where the lights are coplanar or nearly so."""
    matrix = np.asarray(lights, dtype=np.float64)
    if matrix.shape != (3, 3):
        raise ValueError(f"Expected lights of shape (3, 3), one row per channel, got {matrix.shape}.")
    if not np.all(np.isfinite(matrix)):
        raise ValueError("Expected finite lights, got NaN or infinity.")
    condition = float(np.linalg.cond(matrix))
    if not condition < MAX_CONDITION:
        raise ValueError(
            f"Expected three lights from directions that span space, got a light matrix of condition number "
            f"{condition:.3g} (limit {MAX_CONDITION:g}): the lights are coplanar or two are the same. "
            "Light the gel from three different sides."
        )
    return np.linalg.inv(matrix)
