"""What a touch left alone, and what slope and depth are measured against there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gelform.background.check import Finding

MIN_UNTOUCHED = 0.02
SAMPLES = 5_000  # pixels on a lattice, fine enough for medians and shares
EXPOSURE_STEP_PX = 8


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

    Parameters
    ----------
    color_change : (H, W, 3)
    gradients : (H, W, 2), as the color model reads them
    threshold : color changes smaller than this mean: not touched
    hidden : (H, W), pixels that markers hide: never untouched
    """
    common = _common_change(color_change)
    step = max(1, round((gradients.shape[0] * gradients.shape[1] / SAMPLES) ** 0.5))
    lattice = np.s_[::step, ::step]
    untouched = _is_near(color_change[lattice], common, threshold)
    if hidden is not None:
        untouched &= ~hidden[lattice]
    share = np.count_nonzero(untouched) / untouched.size
    if share >= MIN_UNTOUCHED:
        return Reference(common, threshold, _medians(gradients[lattice][untouched]), None, ())
    size = np.linalg.norm(color_change, axis=-1)
    least = size <= np.quantile(size, MIN_UNTOUCHED)
    message = f"Only {100 * share:.1f} % of the pixels are untouched: depth is relative to the least changed."
    finding = Finding("few_untouched", message, share)
    return Reference(common, threshold, _medians(gradients[least]), least, (finding,))


def untouched_from_color_change(color_change: NDArray[np.float32], threshold: float) -> NDArray[np.bool_]:
    """Pixels (H, W) whose colour did not change: |change - what most pixels have in common| < threshold."""
    return _is_near(color_change, _common_change(color_change), threshold)


def _common_change(color_change: NDArray[np.float32]) -> NDArray[np.float32]:
    coarse = color_change[::EXPOSURE_STEP_PX, ::EXPOSURE_STEP_PX]
    return _medians(coarse.reshape(-1, 3))


def _is_near(
    color_change: NDArray[np.float32], common: NDArray[np.float32], threshold: float
) -> NDArray[np.bool_]:
    away = color_change - common
    near: NDArray[np.bool_] = np.einsum("...c,...c->...", away, away) < np.float32(threshold) ** 2
    return near


def _medians(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Median (C,) of each column of values (N, C), without sorting them."""
    columns = np.ascontiguousarray(values.T)
    middle = (len(values) - 1) // 2, len(values) // 2
    columns.partition(middle, axis=1)
    medians: NDArray[np.float32] = columns[:, list(middle)].mean(axis=1)
    return medians
