"""The evidence for each region of an outline, and which of them are contacts."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy  # its parts load at first use
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.foundations.filters import MEDIAN_SAMPLES

# Chosen on every second or third press of six real sensors and on three simulated ones, so that one ball is one contact and
# frames at rest have none; docs/contacts.md shows the other frames.
NOISE_FACTOR = 3.5  # standard deviations: pressures over the noise at rest, depths of regions over their own
# Noise factors: what a region's own depth and its pressure exceed together, as the root of the sum of their squares; and
# what its pressure exceeds where its own depth is not sure.
TOGETHER, ALONE = 2.0, 4.0
INFLUENCE = 6.0  # relaxation lengths, reach of a pressure; beyond, its depth is a thousandth

_region_evidence = Kernel(
    "region_evidence",
    "u16[h,w] labels, f32[h,w] depth, f32[h,w] sigma, f32[h,w] variance, bool[h,w] at_rest, f32[h,w] coarse, f32[h,w] fine, "
    "f32[h,w] smooth, f32[h,w] bent, f32[t] influence, out f64[n,7] measures, f32 stiffness, f32 coarse_at_rest, "
    "f32 coarse_elsewhere, f32 fine_at_rest, f32 fine_elsewhere, f32 per_x, f32 per_y",
)
_excess_below = Kernel("excess_below", "f32[...] depth, f32[...] sigma, out f32[1] excess, i64 step")


class Regions(NamedTuple):
    """The regions of an outline, the maps (H, W) that speak for them, and the numbers of the pressure's variance.

    Attributes
    ----------
    number, labels : of the regions, from 1
    maps : depth and its deviation, mm, variance of the slopes, pixels at rest, the coarse and the fine pressure, and the
        depth and minus its Laplacian by the fine smoothing; by the kernel's names
    gains : the variance of the coarse and the fine pressure at rest and elsewhere, for a variance of slopes of 1
    """

    number: int
    labels: NDArray[np.uint16]
    maps: dict[str, NDArray[Any]]
    gains: dict[str, float]


class _Measures(NamedTuple):
    """What speaks for each region, (n,)."""

    area_px: NDArray[np.float64]
    depth_mm: NDArray[np.float64]
    deepest_yx: NDArray[np.int32]  # (n, 2)
    depth_sigmas: NDArray[np.float64]  # the most standard deviations that a depth is above 0
    sigmas: NDArray[np.float64]  # the most that a pressure is
    own_mm: NDArray[np.float64]  # the depth that its own pressure makes at its deepest pixel


@dataclass(frozen=True)
class Evidence:
    """Which regions stand, by their own uncertainty.

    A region's deepest depth has to exceed `noise_factor` of its own standard deviations. Then either a pixel's pressure is
    overwhelming, or the depth that the region's own pressure makes is sure: gel that another object draws down has depth
    without pressure of its own. The depth that a pressure makes at the distance r is `K0(r/L) / (2 pi)`.

    What no contact makes is the frame's own noise: a frame whose negative depths are larger than their standard deviations
    say, as of dust or of another light, has to show own depths that are larger in proportion.

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
        deep = (found.area_px >= least_px) & (found.depth_sigmas > self.noise_factor)
        part = np.minimum(found.own_mm / np.maximum(found.depth_mm, 1e-9), 1)
        own = part * found.depth_sigmas / self._excess(regions)
        both = np.hypot(own, found.sigmas) > TOGETHER * self.noise_factor
        sure = both & (np.minimum(own, found.sigmas) > self.noise_factor)
        stands = deep & (sure | (found.sigmas > ALONE * self.noise_factor))
        return np.append(False, stands), np.vstack([np.zeros((1, 2), np.int32), found.deepest_yx])

    def _excess(self, regions: Regions) -> float:
        """Root mean square of the negative depths over their standard deviations; at least 1."""
        depth, excess = regions.maps["depth"], np.empty(1, dtype=np.float32)
        _excess_below(depth, regions.maps["sigma"], excess, step=max(1, depth.size // MEDIAN_SAMPLES))
        return max(1.0, float(excess[0]))

    def _measured(self, regions: Regions) -> _Measures:
        measures, area = np.empty((regions.number, 7)), self.pitch[0] * self.pitch[1]
        per_x, per_y = (step**2 / area for step in self.pitch)
        _region_evidence(
            regions.labels, **regions.maps, influence=self._influence, measures=measures, stiffness=self.length_mm**-2,
            **regions.gains, per_x=per_x, per_y=per_y,
        )  # fmt: skip
        pixels, depth, x, y, sigmas_of_depth, square, own = measures.T
        deepest = np.column_stack([y, x]).astype(np.int32)
        return _Measures(pixels, depth, deepest, sigmas_of_depth, np.sqrt(square), own)

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
        depth = scipy.special.k0(np.sqrt(squares * area) / self.length_mm) * area / (2 * np.pi)
        return np.asarray(depth, dtype=np.float32)
