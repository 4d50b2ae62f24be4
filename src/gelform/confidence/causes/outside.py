"""Outside: pixels that show no gel, or gel that no light reaches."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.confidence.causes.seen import Seen

UNLIT_TO = 8  # grey levels of the untouched image's brightest channel
LEAST_PX = 25  # connected: less is dust


def sigma(seen: Seen) -> NDArray[np.float32]:
    """Standard deviation (H, W), mm/mm."""
    return seen.where(seen.limits.outside)


def outside_of_gel(background: NDArray[Any]) -> NDArray[np.bool_] | None:
    """Pixels (H, W) of an untouched image that no light reaches, in regions that are not dust; None: there are none."""
    unlit = (np.asarray(background).max(axis=-1) <= UNLIT_TO).astype(np.uint8)
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(unlit, connectivity=8)
    large = boxes[:, cv2.CC_STAT_AREA] >= LEAST_PX
    large[0] = False
    return large[labels] if count > 1 and large.any() else None
