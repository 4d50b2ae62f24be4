"""Specular: all channels brighter than any gradient makes them, as where a light is mirrored."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelform.confidence.causes.seen import BRIGHTER, Seen


def sigma(seen: Seen) -> NDArray[np.float32]:
    """Standard deviation (H, W), mm/mm, from what is unexplained where the channels are brighter in common."""
    return seen.beyond(seen.common() > BRIGHTER)
