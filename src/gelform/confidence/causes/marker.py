"""Marker: dots printed on the gel, which hide its colour."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelform.confidence.causes.seen import Seen


def sigma(seen: Seen) -> NDArray[np.float32]:
    """Standard deviation (H, W), mm/mm."""
    return seen.where(seen.markers)
