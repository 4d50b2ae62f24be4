"""Wall: slopes that change from pixel to pixel as no ball's do, so that the color change's blur mixes them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelform.confidence.causes.seen import BEND_FROM, Seen


def sigma(seen: Seen) -> NDArray[np.float32]:
    """Standard deviation (H, W), mm/mm, by how much slopes differ from those a little more than the blur away."""
    slopes, reach, square = seen.gradients, seen.limits.reach_px, np.zeros(seen.shape, dtype=np.float32)
    for apart in (slopes[:, reach:] - slopes[:, :-reach], slopes[reach:] - slopes[:-reach]):
        both, (rows, columns) = np.square(apart).sum(axis=-1), apart.shape[:2]
        square[:rows, :columns] += both
        square[-rows:, -columns:] += both
    bend = np.sqrt(square / 2)
    return np.asarray(seen.limits.per_bend * np.maximum(bend - BEND_FROM, 0), dtype=np.float32)
