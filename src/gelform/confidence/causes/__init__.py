"""What makes a slope uncertain beyond the law of its size and place: one cause per file, each a map of sigma."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from gelform.confidence.causes import (
    compression,
    dark,
    inconsistent,
    marker,
    off_gamut,
    outside,
    saturated,
    shadow,
    specular,
    wall,
)
from gelform.confidence.causes.seen import Seen

CAUSES: dict[str, Callable[[Seen], NDArray[np.float32]]] = {
    "saturated": saturated.sigma,
    "dark": dark.sigma,
    "shadow": shadow.sigma,
    "specular": specular.sigma,
    "off_gamut": off_gamut.sigma,
    "inconsistent": inconsistent.sigma,
    "marker": marker.sigma,
    "outside": outside.sigma,
    "wall": wall.sigma,
    "compression": compression.sigma,
}
"""Standard deviation (H, W), mm/mm, that each cause adds (in squares) to that of the slopes of a frame."""
