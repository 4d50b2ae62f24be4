"""Dark: a channel at the camera's lower end, where a slope no longer darkens it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelform.confidence.causes import saturated
from gelform.confidence.causes.seen import Seen, lost_level

DARK_TO = 2  # grey levels
LOST_DARK_TO = 16  # of a lost part's mean


def sigma(seen: Seen) -> NDArray[np.float32]:
    """Standard deviation (H, W), mm/mm; 0 where a channel is saturated, a marker is, or no light comes at rest."""
    dark = seen.reached_from(np.any(seen.pixels <= DARK_TO, axis=-1))
    if seen.lost is not None:
        dark |= seen.lost & (lost_level(seen).min(axis=-1) <= LOST_DARK_TO)
    return seen.where(dark & (saturated.sigma(seen) == 0))
