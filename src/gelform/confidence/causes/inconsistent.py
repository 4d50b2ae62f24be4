"""Inconsistent: a colour that the slope which was read from it does not give by the forward response; torn data too."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelform.confidence.causes import dark, saturated
from gelform.confidence.causes.seen import BRIGHTER, DARKER, Seen


def sigma(seen: Seen) -> NDArray[np.float32]:
    """Standard deviation (H, W), mm/mm, of what the channels do not have in common, and of lost parts not clipped."""
    torn = seen.where(seen.lost)
    torn[(saturated.sigma(seen) > 0) | (dark.sigma(seen) > 0)] = 0
    common = seen.common()
    mixed = (common >= DARKER) & (common <= BRIGHTER)
    return np.maximum(seen.beyond(mixed), torn)
