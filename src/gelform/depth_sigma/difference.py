"""Standard deviation of differences of one frame's depth, worked out when they are asked for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.depth_sigma.sigma import DepthSigma


@dataclass(frozen=True, eq=False)
class DepthDifference:
    """How well the depth of a frame is known against its own mean over a region.

    Attributes
    ----------
    prepared : DepthSigma
    gradients_sigma : (H, W, 2), of the slopes as they were read
    how : weights and anchor, or zero, as the depth was solved with
    depth_mm : (H, W)
    gain_sigma : relative standard deviation of all slopes together, which moves differences of depth in proportion
    """

    prepared: DepthSigma
    gradients_sigma: NDArray[np.float32]
    how: dict[str, Any]
    depth_mm: NDArray[np.float32]
    gain_sigma: float

    def __call__(self, region: NDArray[np.bool_]) -> NDArray[np.float32]:
        """Standard deviation (H, W), mm, of the depth minus its mean over a region (H, W) of some pixels."""
        sigma = self.prepared(self.gradients_sigma, **self.how, against=region)
        apart = self.depth_mm - np.float32(self.depth_mm[region].mean(dtype=np.float64))
        in_proportion = np.float32(self.gain_sigma) * apart
        return np.asarray(np.sqrt(np.square(sigma) + np.square(in_proportion)))
