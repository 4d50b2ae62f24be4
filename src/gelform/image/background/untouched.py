"""The pixels at rest of a frame, and their common color change and slope, which are subtracted from all pixels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.foundations.filters import MIN_UNTOUCHED, lattice_step, medians_where
from gelform.foundations.findings import Finding

EXPOSURE_STEP_PX = 8  # px, lattice step for the common change

_near_common = Kernel(
    "near_common",
    "f32[h,w,3] change, bool[h,w]? hidden, f32[3] common, out bool[h,w] near, f32 square, i64 step",
)


class Reference(NamedTuple):
    """The common properties of the pixels at rest.

    Attributes
    ----------
    common_change : (3,) float32, the color change of most pixels; an exposure step changes all pixels alike
    threshold : a pixel whose color change differs from it by less is at rest
    bias : (2,) float32, median slope of the pixels at rest; colors that drifted everywhere are no slope
    given : (H, W) bool, the pixels that changed least, if the threshold leaves too few pixels at rest; else None
    findings : one, if the threshold leaves too few
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
    """The common properties of the pixels at rest of a frame, from a lattice of some 5000 pixels.

    A pixel of the color change (H, W, 3) is at rest if it changed by less than the threshold, unless a marker hides it
    (H, W). The gradients (H, W, 2) are from the color model.
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
