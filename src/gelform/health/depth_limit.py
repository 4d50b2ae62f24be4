"""How deep a gel can be pressed at all: what bounds a depth that the frame cannot justify."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from gelform.background.check import Finding
from gelform.checks import value_range


@dataclass(frozen=True)
class DepthLimit:
    """The largest depth that is possible, mm.

    Attributes
    ----------
    limit_mm : the gel's thickness where that is known, else the shorter side of the field of view
    is_thickness : which of the two it is
    """

    limit_mm: float
    is_thickness: bool

    @classmethod
    def of(cls, shape: tuple[int, int], mm_per_px: float, thickness_mm: float | None = None) -> DepthLimit:
        """The limit of images (H, W) of square pixels."""
        if thickness_mm is not None:
            return cls(float(thickness_mm), True)
        return cls(min(shape) * float(mm_per_px), False)

    @property
    def ignorance_mm(self) -> float:
        """Standard deviation of a depth of which nothing but the limit is known: that of a uniform distribution."""
        return self.limit_mm / sqrt(12)

    def bound(self, depth_mm: NDArray[np.float32]) -> tuple[NDArray[np.float32], tuple[Finding, ...]]:
        """The depth (H, W) within plus and minus the limit, and a finding where it was not."""
        low, high = value_range(depth_mm)
        largest = max(high, -low)
        if largest <= self.limit_mm:
            return depth_mm, ()
        what = "the gel is thick" if self.is_thickness else "the field of view is wide"
        message = (
            f"Depth up to {largest:.3g} mm was read, more than {what} ({self.limit_mm:.3g} mm): cut there. "
            "The image does not fit the calibration; do not trust this depth."
        )
        limit = np.float32(self.limit_mm)
        return np.clip(depth_mm, -limit, limit), (Finding("beyond_gel", message, largest),)
