"""Off gamut: a colour that no training press has shown, so that the color model extrapolates."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelform.confidence.causes.seen import Seen


def sigma(seen: Seen) -> NDArray[np.float32]:
    """Standard deviation (H, W), mm/mm: the distance to the nearest colour that was seen (`Gamut`)."""
    if seen.limits.gamut is None:
        return np.zeros(seen.shape, dtype=np.float32)
    return seen.limits.gamut.distance_of(seen.color_change)
