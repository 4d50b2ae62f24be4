"""What a touch left alone, and what slope and depth are measured against there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.foundations.filters import MIN_UNTOUCHED, lattice_step, medians_where
from gelform.foundations.findings import Finding

EXPOSURE_STEP_PX = 8  # of the lattice for the common change

_near_common = Kernel(
    "near_common",
    "f32[h,w,3] change, bool[h,w]? hidden, f32[3] common, out bool[h,w] near, f32 square, i64 step",
)


class Reference(NamedTuple):
    """What untouched pixels have in common.

    Attributes
    ----------
    common_change : (3,) float32, the color change of most pixels: an exposure step moves all alike and touches none
    threshold : color changes that differ from it by less mean: not touched
    bias : (2,) float32, median slope of the untouched pixels: colour that drifted everywhere is no slope
    given : (H, W) bool, the untouched pixels where the threshold leaves too few: those that changed least; or None
    findings : one, where the threshold leaves too few
    """

    common_change: NDArray[np.float32]
    threshold: float
    bias: NDArray[np.float32]
    given: NDArray[np.bool_] | None
    findings: tuple[Finding, ...]


def reference_from_color_change(
    color_change: NDArray[np.float32],
    gradients: NDArray[np.float32],
    threshold: float,
    hidden: NDArray[np.bool_] | None = None,
) -> Reference:
    """What the untouched pixels of a frame have in common, from a lattice of some 5000 pixels.

    Of a color change (H, W, 3) and the slopes (H, W, 2) that a color model read; changes smaller than the threshold mean
    not
    touched, and pixels that markers hide (H, W) are never untouched.
    """
    common = medians_where(color_change, step=EXPOSURE_STEP_PX)[0]
    height, width = gradients.shape[:2]
    step = lattice_step(height * width)
    near = np.zeros((height, width), dtype=bool)
    count = _near_common(color_change, hidden, common, near, threshold**2, step)
    fraction = count / (-(-height // step) * -(-width // step))
    if fraction >= MIN_UNTOUCHED:
        return Reference(common, threshold, medians_where(gradients, near, step)[0], None, ())
    size = np.linalg.norm(color_change, axis=-1)
    least = size <= np.quantile(size, MIN_UNTOUCHED)
    message = (
        f"Only {100 * fraction:.1f} % of the pixels are at rest. Depth is relative to the least changed ones."
    )
    finding = Finding("few_untouched", message, fraction)
    return Reference(common, threshold, medians_where(gradients, least)[0], least, (finding,))
