"""The evidence for each region of an outline, and which of them are contacts."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.foundations.bessel import bessel_k
from gelform.foundations.filters import MEDIAN_SAMPLES

# Chosen on every second or third press of six real sensors and on three simulated ones, so that one ball is one contact and
# frames at rest have none; docs/contacts.md shows the other frames.
NOISE_FACTOR = 3.5  # standard deviations: pressures over the noise at rest, depths of regions over their own
# Noise factors that a region's own depth and its pressure exceed together, as the root of the sum of their squares.
TOGETHER = 2.0
INFLUENCE = 6.0  # relaxation lengths, reach of a pressure; beyond, its depth is a thousandth

_region_evidence = Kernel(
    "region_evidence",
    "u16[h,w] labels, f32[h,w] depth, f32[h,w] sigma, f32[h,w] evidence, f32[h,w] smooth, f32[h,w] bent, f32[t] influence, "
    "out f64[n,7] measures, f32 stiffness, f32 per_x, f32 per_y",
)
_variance_below = Kernel("variance_below", "f32[...] depth, f32[...] sigma, out f64[1] excess, i64 step")


class Regions(NamedTuple):
    """The regions of an outline, and the maps (H, W) that speak for them.

    Attributes
    ----------
    number, labels : of the regions, from 1
    depth, sigma : mm, and its standard deviation
    evidence : square of the mean pressure around over its variance
    smooth, bent : the depth smoothed, and minus its Laplacian
    """

    number: int
    labels: NDArray[np.uint16]
    depth: NDArray[np.float32]
    sigma: NDArray[np.float32]
    evidence: NDArray[np.float32]
    smooth: NDArray[np.float32]
    bent: NDArray[np.float32]


class _Measures(NamedTuple):
    """What speaks for each region, (n,)."""

    area_px: NDArray[np.float64]
    depth_mm: NDArray[np.float64]
    deepest_yx: NDArray[np.int32]  # (n, 2)
    deviation_mm: NDArray[np.float64]  # standard deviation of that depth
    sigmas: NDArray[np.float64]  # the most standard deviations that a pressure is above 0
    own_mm: NDArray[np.float64]  # the depth that its own pressure makes at its deepest pixel


@dataclass(frozen=True)
class Evidence:
    """Which regions stand, by their own uncertainty.

    A region's deepest depth has to exceed `noise_factor` of its own standard deviations. So do the pressure of a pixel and
    the depth of the region's own pressure: gel that another object draws down has depth without pressure of its own.
    The depth that a pressure makes at the distance r is `K0(r/L) / (2 pi)`.

    No contact makes a negative depth. What negative depths have more than their standard deviations say, as of dust or of
    another light, is the frame's own noise, and counts as one more error of the depth that a region makes.

    Attributes
    ----------
    pitch : (x, y), mm
    length_mm : L, the gel's relaxation length
    noise_factor, min_area_mm2 : as in `contact_from_depth`
    """

    pitch: tuple[float, float]
    length_mm: float
    noise_factor: float
    min_area_mm2: float

    def __call__(self, regions: Regions) -> tuple[NDArray[np.bool_], NDArray[np.int32]]:
        """Whether each label (labels + 1,) is a contact, and the (y, x) of its deepest pixel (labels + 1, 2)."""
        found = self._measured(regions)
        least_px = self.min_area_mm2 / (self.pitch[0] * self.pitch[1])
        deep = (found.area_px >= least_px) & (found.depth_mm > self.noise_factor * found.deviation_mm)
        noise = np.sqrt(found.deviation_mm**2 + self._variance_of_frame(regions))
        own = np.minimum(found.own_mm, found.depth_mm) / np.maximum(noise, 1e-9)
        both = np.minimum(own, found.sigmas) > self.noise_factor
        stands = deep & both & (np.hypot(own, found.sigmas) > TOGETHER * self.noise_factor)
        return np.append(False, stands), np.vstack([np.zeros((1, 2), np.int32), found.deepest_yx])

    def _variance_of_frame(self, regions: Regions) -> float:
        """What the negative depths have more than their own variance, mm^2."""
        depth, excess = regions.depth, np.empty(1)
        _variance_below(depth, regions.sigma, excess, step=max(1, depth.size // MEDIAN_SAMPLES))
        return float(excess[0])

    def _measured(self, regions: Regions) -> _Measures:
        measures, area = np.empty((regions.number, 7)), self.pitch[0] * self.pitch[1]
        per_x, per_y = (step**2 / area for step in self.pitch)
        _region_evidence(
            *regions[1:], influence=self._influence, measures=measures, stiffness=self.length_mm**-2, per_x=per_x,
            per_y=per_y,
        )  # fmt: skip
        pixels, depth, x, y, deviation, square, own = measures.T
        deepest = np.column_stack([y, x]).astype(np.int32)
        return _Measures(pixels, depth, deepest, deviation, np.sqrt(square), own)

    @cached_property
    def _influence(self) -> NDArray[np.float32]:
        """Depth, mm, that a pressure of 1/mm on a pixel makes, by squared distance in pixels of mean size."""
        area = self.pitch[0] * self.pitch[1]
        reach = min(
            (INFLUENCE * self.length_mm) ** 2 / area, 1e6
        )  # px^2; no contact is a thousand pixels wide
        squares = np.arange(int(reach) + 2, dtype=np.float64)
        squares[0] = 1 / (
            np.pi * np.e
        )  # where the logarithm is that of the mean over a disc of a pixel's area
        depth = bessel_k(0, np.sqrt(squares * area) / self.length_mm) * area / (2 * np.pi)
        return np.asarray(depth, dtype=np.float32)
