"""What is not known of steep slopes, and no residual shows: slopes beyond those of presses, and models of other units.

The color of a slope saturates, so a model reads slopes beyond those that it was trained on as about the steepest of those.
The model of another unit reads a steep face as a usual slope if this unit's colors change less. Neither leaves a residual.
So both are stated: in the standard deviations of slopes and depth, and in the confidence of results. They are not in the
solver's weights: there, steep slopes would be filled from gentle ones, and be read as gentler still.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.slopes.confidence.slope_sigma import SlopeSigma
from gelform.slopes.confidence.solved import for_both
from gelform.slopes.gradients import STEEPEST_GEL

# Quantiles of the slopes that presses have shown. From the first on, a model of other units is doubted, beginning one clean
# sigma below it, because slopes are read with an error; from the second on, every model. With 0.5 the faces of a cube's edge
# escape the doubt of a model whose own presses are deep, with 0.3 balls are doubted too.
SHOWN = 0.4, 0.75
# Deviation of a slope over its excess over the upper quartile. Measured on three sensors: calibrations trained below slopes
# of 0.4 and 0.5 have 92 % of the steeper pixels within two sigma, and call 12 % sure.
PER_EXCESS = 1.25
# mm/mm, slope of a face of 54 degrees; two sigma of a slope that another unit's model read reach it. The faces of a cube's
# edge, which stand at some 45 degrees, are read at 0.2-0.7.
STEEPEST_FACE = 1.4

_steep_sigma = Kernel(
    "steep_sigma",
    "f32[h,w,2] gradients, f32[h,w] sigma, f32[h,w] confidence, out f32[h,w] steep, out f32[h,w] stated, f32 upper, "
    "f32 per_excess, f32 doubted, f32 steepest, f32 carried, f32 most, f32 full_confidence_sigma",
)


class SteepSlopes:
    """The deviation of steep slopes for whole frames of one calibration. It is immutable; threads can share it.

    Parameters
    ----------
    sigma : of the calibration; its law's slopes are those that presses have shown
    carried : share of the model that comes from other units, 0-1
    """

    def __init__(self, sigma: SlopeSigma, carried: float = 0.0) -> None:
        doubted, upper = np.quantile(sigma.slopes, SHOWN)
        self._numbers = {
            "upper": upper, "per_excess": PER_EXCESS, "doubted": doubted, "steepest": STEEPEST_FACE, "carried": carried / 2,
            "most": STEEPEST_GEL, "full_confidence_sigma": sigma.full_confidence_sigma,
        }  # fmt: skip

    def __call__(
        self, gradients: NDArray[np.float32], sigma: NDArray[np.float32], confidence: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """The deviation (H, W) of slopes (H, W, 2) as they were read, mm/mm, and the confidence (H, W) that results state.

        `sigma` and `confidence` (H, W) are those that the solver uses; confidence becomes
        `min(confidence, full_confidence_sigma^2 / (sigma^2 + steep^2))`.
        """
        steep, stated = np.empty_like(sigma), np.empty_like(confidence)
        _steep_sigma(gradients, sigma, confidence, steep, stated, **self._numbers)
        return steep, stated


def all_shown(
    gradients: NDArray[np.float32], sigma: NDArray[np.float32], confidence: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """As `SteepSlopes`, for calibrations whose presses are unknown: nothing is added."""
    return np.zeros_like(sigma), confidence


def with_steep(sigma: NDArray[np.float32] | None, steep: NDArray[np.float32]) -> NDArray[np.float32] | None:
    """A standard deviation (H, W) or (H, W, 2), with that of steep slopes (H, W) added in squares; None stays None."""
    if sigma is None:
        return None
    alike = sigma.strides[-1] == 0  # one map for both components, broadcast
    own = sigma[..., 0] if alike else sigma
    added = np.sqrt(np.square(own) + np.square(steep if own.ndim == 2 else steep[..., None]))
    return for_both(added) if alike else np.asarray(added)
