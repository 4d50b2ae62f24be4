"""The evidence for each region of an outline, and which of them are contacts."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import cv2
import numpy as np
import scipy  # its parts load at first use
from numpy.typing import NDArray

from gelform._native import Kernel

# Chosen on every second or third press of six real sensors and on three simulated ones, so that one ball is one contact and
# frames at rest have none; docs/contacts.md shows the other frames.
NOISE_FACTOR = 3.5  # standard deviations: pressures over the noise at rest, depths of regions over their own
# Noise factors: what the surer of depth and pressure exceeds, of a region that makes most of its depth itself; and what the
# pressure of any other exceeds.
SEED, ALONE = 2.0, 3.0
MOST = 0.5  # fraction of a region's depth that its own pressure makes; the rest is drawn down by what is beside it
TOPS = 3  # regions of a texture, the fewest, of which none makes most of its depth alone
INFLUENCE = 6.0  # relaxation lengths, reach of a pressure; beyond, its depth is a thousandth

_region_evidence = Kernel(
    "region_evidence",
    "u16[h,w] labels, f32[h,w] depth, f32[h,w] sigma, f32[h,w] variance, bool[h,w] at_rest, f32[h,w] coarse, f32[h,w] fine, "
    "f32[h,w] smooth, f32[h,w] bent, f32[t] influence, out f64[n,7] measures, f32 stiffness, f32 coarse_at_rest, "
    "f32 coarse_elsewhere, f32 fine_at_rest, f32 fine_elsewhere, f32 per_x, f32 per_y",
)


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
    deepest_yx: tuple[NDArray[np.int64], NDArray[np.int64]]
    depth_sigmas: NDArray[np.float64]  # the most standard deviations that a depth is above 0
    sigmas: NDArray[np.float64]  # the most that a pressure is
    own_mm: NDArray[np.float64]  # the depth that its own pressure makes at its deepest pixel


@dataclass(frozen=True)
class Evidence:
    """Which regions stand, by their own uncertainty.

    A region's deepest depth has to exceed `noise_factor` of its own standard deviations. Then either a pixel's pressure is
    overwhelming, or the region's own pressure makes most of its depth, and that part is sure: gel that another object draws
    down has depth without pressure of its own. The depth that a pressure makes at the distance r is `K0(r/L) / (2 pi)`.

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

    def __call__(self, regions: Regions) -> NDArray[np.bool_]:
        """Whether each label (labels + 1,) is a contact: sure at a pixel, or by its own depth, or with its neighbors."""
        stands = np.zeros(regions.number + 1, dtype=bool)
        if regions.number == 0:
            return stands
        found = self._measured(regions)
        least_px = self.min_area_mm2 / (self.pitch[0] * self.pitch[1])
        deep = (found.area_px >= least_px) & (found.depth_sigmas > self.noise_factor)
        stands[1:] = deep & ((found.sigmas > ALONE * self.noise_factor) | self._makes_its_depth(found))
        waits = np.append(False, deep & (found.sigmas > self.noise_factor)) & ~stands
        if np.count_nonzero(waits) >= TOPS:
            self._judge_together(regions, found, waits, stands)
        return stands

    def _makes_its_depth(self, found: _Measures) -> NDArray[np.bool_]:
        part = found.own_mm / np.maximum(found.depth_mm, 1e-9)
        sure = np.minimum(part, 1) * found.depth_sigmas
        weaker, stronger = np.minimum(sure, found.sigmas), np.maximum(sure, found.sigmas)
        evident = (weaker > self.noise_factor) & (stronger > SEED * self.noise_factor)
        return np.asarray((part > MOST) & evident)

    def _judge_together(
        self, regions: Regions, found: _Measures, waits: NDArray[np.bool_], stands: NDArray[np.bool_]
    ) -> None:
        """Let the tops of a texture stand: less than L apart, beside no contact, and together they make their depth."""
        wide = np.ones([2 * round(self.length_mm / step) + 1 for step in self.pitch[::-1]], np.uint8)
        reached, beside = (cv2.dilate(one[regions.labels].view(np.uint8), wide) for one in (waits, stands))
        count, groups = cv2.connectedComponents(reached)
        group_of = np.append(0, groups[found.deepest_yx])
        for group in range(1, count):
            members = waits & (group_of == group)
            if np.count_nonzero(members) < TOPS or beside[groups == group].any():
                continue
            joined = regions._replace(number=1, labels=members[regions.labels].astype(np.uint16))
            if self._makes_its_depth(self._measured(joined))[0]:
                stands |= members

    def _measured(self, regions: Regions) -> _Measures:
        measures, area = np.empty((regions.number, 7)), self.pitch[0] * self.pitch[1]
        per_x, per_y = (step**2 / area for step in self.pitch)
        _region_evidence(
            regions.labels, **regions.maps, influence=self._influence, measures=measures, stiffness=self.length_mm**-2,
            **regions.gains, per_x=per_x, per_y=per_y,
        )  # fmt: skip
        pixels, depth, x, y, sigmas_of_depth, square, own = measures.T
        deepest = y.astype(np.intp), x.astype(np.intp)
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
