"""Which pixels a touch left alone: what slope and depth are measured against."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gelform.background.check import Finding

MIN_UNTOUCHED = 0.02
BIAS_SAMPLES = 5_000


def untouched_pixels(
    color_change: NDArray[np.float32], threshold: float, hidden: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], tuple[Finding, ...]]:
    """Pixels whose colour did not change; the least changed ones, with a finding, where there are too few.

    Parameters
    ----------
    color_change : (H, W, 3)
    threshold : color changes smaller than this mean: not touched
    hidden : (H, W), pixels that markers hide: never untouched

    Returns
    -------
    untouched : (H, W) bool, at least 2 % of the pixels
    findings : one, where fewer than 2 % of the pixels are under the threshold
    """
    untouched = untouched_from_color_change(color_change, threshold) & ~hidden
    share = np.count_nonzero(untouched) / untouched.size
    if share >= MIN_UNTOUCHED:
        return untouched, ()
    size = np.linalg.norm(color_change, axis=-1)
    message = f"Only {100 * share:.1f} % of the pixels are untouched: depth is relative to the least changed."
    return size <= np.quantile(size, MIN_UNTOUCHED), (Finding("few_untouched", message, share),)


def remove_bias(gradients: NDArray[np.float32], untouched: NDArray[np.bool_]) -> None:
    """Subtract, in place, the untouched pixels' median slope, found on a lattice that is fine enough for it."""
    step = max(1, round((untouched.size / BIAS_SAMPLES) ** 0.5))
    slopes = gradients[::step, ::step][untouched[::step, ::step]]
    if not len(slopes):
        slopes = gradients[untouched]
    for component, bias in enumerate(np.median(slopes, axis=0)):
        gradients[..., component] -= bias


def untouched_from_color_change(color_change: NDArray[np.float32], threshold: float) -> NDArray[np.bool_]:
    """Pixels (H, W) whose colour did not change: |change - its median over the frame| < threshold.

    The median is taken on a coarse grid: an exposure step moves all pixels alike and touches none.
    """
    common = np.median(color_change[::8, ::8].reshape(-1, 3), axis=0).astype(np.float32)
    inside: NDArray[np.bool_] = _within(color_change, common, float(threshold) ** 2)
    return inside


@njit(cache=True, fastmath=True, nogil=True)
def _within(change, center, square):  # type: ignore[no-untyped-def]
    """Where the distance of a pixel's change to a center is less than the root of `square`."""
    height, width, _ = change.shape
    inside = np.empty((height, width), dtype=np.bool_)
    limit = np.float32(square)
    for y in range(height):
        for x in range(width):
            red = change[y, x, 0] - center[0]
            green = change[y, x, 1] - center[1]
            blue = change[y, x, 2] - center[2]
            inside[y, x] = red * red + green * green + blue * blue < limit
    return inside
