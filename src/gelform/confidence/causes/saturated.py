"""Saturated: a channel at the camera's upper end, which hides how much brighter it was, and the pixels it blooms into."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelform.confidence.causes.seen import Seen, lost_level

SATURATED_FROM = 254  # grey levels
LOST_SATURATED_FROM = 240  # of a lost part's mean


def sigma(seen: Seen) -> NDArray[np.float32]:
    """Standard deviation (H, W), mm/mm."""
    saturated = seen.reached_from(np.any(seen.pixels >= SATURATED_FROM, axis=-1))
    if seen.lost is not None:
        saturated |= seen.lost & (lost_level(seen).max(axis=-1) >= LOST_SATURATED_FROM)
    return seen.where(saturated)
