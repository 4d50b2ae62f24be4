"""Shadow: all channels darker than any gradient makes them, as where the object or the gel stands in the light."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelform.confidence.causes.seen import DARKER, Seen


def sigma(seen: Seen) -> NDArray[np.float32]:
    """Standard deviation (H, W), mm/mm, of cast shadows and of what is unexplained where all channels are darker."""
    common = seen.beyond(seen.common() < DARKER)
    return common if seen.cast is None else np.hypot(common, seen.cast)
