"""Depth on a grid four times coarser than the frame, and how firmly it is held at 0 where it looks like gel at rest.

Color alone cannot show that nothing touches: the flat face of a punch or a coin has the color of gel at rest.
Therefore a coarse depth is solved first. A region that touched gel encloses, and that lies deeper or higher than rest, is
a flat face: its edge shows that, and it is not held. Gel next to touched gel is not held either, because it is drawn down
by less than its color can show.
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from gelform._native import Kernel
from gelform.arrays import Map, Mask, Slopes
from gelform.depth.solvers.dct import DctSolver
from gelform.foundations.filters import MIN_UNTOUCHED, fill_unknown, medians_where
from gelform.foundations.pool import Pool

COARSER = 4  # times fewer rows and columns

_cell_means = Kernel(
    "cell_means",
    "f32[h,w,c] values, bool[h,w]? seen, out f32[n] work, out f32[r,k,c] cells, out f32[r,k] shares",
)
_cells_over_rest = Kernel(
    "cells_over_rest",
    "f32[h,w,3] change, f32[h,w,2] slopes, bool[h,w]? seen, out f32[n] work, out f32[r,k,3] change_cells, "
    "out f32[r,k,2] slope_cells, out f32[r,k] shares, out bool[r,k] rest, f32 most, f64 share",
)
_slopes_over_rest = Kernel(
    "slopes_over_rest",
    "out f32[r,k,3] change, out f32[r,k,2] slopes, out bool[r,k] rest, out f32[n] work, f32 most, f64 share",
)
_root_at_pixels = Kernel(
    "root_at_pixels", "f32[r,c] variance, bool[h,w]? lost, out f32[n] work, out f32[h,w] sigma, f32 most"
)


class Coarse:
    """Means of frames (H, W), least-squares depth of them, and maps at pixels again; immutable, threads can share it."""

    def __init__(self, shape: tuple[int, int]) -> None:
        rows, columns = (max(2, size // COARSER) for size in shape)
        self.shape = rows, columns
        self.pitch_px = shape[1] / columns, shape[0] / rows  # (x, y), distance of its cells
        self._pixels = shape[1], shape[0]
        self._solver = DctSolver(self.shape, self.pitch_px)

    def means(self, values: Map, seen: Mask | None = None) -> tuple[Map, Map]:
        """Means (rows, columns, C) of a map (H, W, C) over the seen pixels (H, W) of the cells, 0 without any; their share.

        The map is float32 in C order; all its pixels are seen by default.
        """
        channels, width = values.shape[2], values.shape[1]
        cells, shares = np.empty((*self.shape, channels), np.float32), np.empty(self.shape, np.float32)
        work = np.empty((channels + 1) * width + 4 * self.shape[1], np.float32)
        _cell_means(values, seen, work, cells, shares)
        return cells, shares

    def depth_px(self, slopes: Slopes) -> Map:
        """Least-squares depth (rows, columns) of slopes there (rows, columns, 2), px; its mean is 0."""
        return self._solver(slopes).depth_mm

    def at_pixels(self, values: Map) -> Map:
        """A map (rows, columns) at every pixel (H, W), linear between the cells' centers."""
        return np.asarray(cv2.resize(values, self._pixels, interpolation=cv2.INTER_LINEAR))

    def root_at_pixels(self, variance: Map, most: float, lost: Mask | None = None) -> Map:
        """The root of a variance (rows, columns) at every pixel (H, W), `most` at most, and at `lost` pixels (H, W)."""
        width, height = self._pixels
        sigma, work = np.empty((height, width), np.float32), np.empty(4 * width, np.float32)
        _root_at_pixels(variance, lost, work, sigma, most)
        return sigma

    def at_pixel(self, values: Map, place: tuple[int, int]) -> float:
        """A map (rows, columns) at one pixel (y, x), as `at_pixels`."""
        for at, pixels in zip(place, self._pixels[::-1]):
            middle = (at + 0.5) * len(values) / pixels - 0.5
            first = min(max(int(middle), 0), len(values) - 2)
            share = min(max(middle - first, 0.0), 1.0)
            values = (1 - share) * values[first] + share * values[first + 1]
        return float(values)


@lru_cache(maxsize=16)
def coarse_of(shape: tuple[int, int]) -> Coarse:
    """The grid of frames of a shape, made once."""
    return Coarse(shape)


REST_SIGMA_MM = 0.057  # mm, sigma of depth at pixels with the color of rest, far from contacts
REACH_MM = 1.0  # mm; touched gel draws down the gel at this distance, by exp(-(distance/reach)^2)
UNTOUCHED_FRACTION = 0.5  # of a coarse pixel that has the color of rest: above it is at rest, below touched

_distance_from_touched = Kernel(
    "distance_from_touched",
    "bool[h,w] at_rest, out f32[n] work, out f32[r,k] share, out f32[r,k] distance, f32 least",
)
_rest_anchor = Kernel(
    "rest_anchor",
    "f32[r,k] depth, f32[r,k] share, f32[r,k] far, bool[h,w] at_rest, out f32[n] work, out f32[h,w] anchor, f32 hold, "
    "f32 least, f32 face",
)


class RestAnchor:
    """The anchor of frames (H, W). It is prepared once and immutable; threads can share it."""

    def __init__(self, shape: tuple[int, int], mm_per_px: float, full_confidence_sigma: float) -> None:
        self.shape = shape
        self.hold = (full_confidence_sigma * mm_per_px / REST_SIGMA_MM) ** 2
        self._coarse = coarse = coarse_of(shape)
        rows, columns = coarse.shape
        # An enclosed region farther than 0.02 mm off rest is a face; slope errors tilt a face of a few mm by less.
        self._face_px = 0.02 / mm_per_px
        self._per_reach = np.float32(mm_per_px * sum(coarse.pitch_px) / 2 / REACH_MM)
        # Five floats for a run of pixels and four for its region, as in native/depth/anchor/hold.c.
        of_hold = (5 + 4) * rows * ((columns + 1) // 2) + 5 * rows * columns
        most = max(5 * shape[1] + rows * columns, of_hold, (rows + 2) * (columns + 2) + rows * columns)
        self._pool = Pool(lambda: np.empty(most, dtype=np.float32))

    def __call__(self, gradients: Slopes, at_rest: Mask, depth_px: Map | None = None) -> Map | None:
        """Anchor (H, W) of slopes (H, W, 2) without bias; 0 where the gel was touched or pressed flat; None if it is 0.

        The depth on the coarser grid, px, is solved if it is not given.
        A pixel at rest gets `(full_confidence_sigma mm_per_px / REST_SIGMA_MM)^2`, times `1 - exp(-(d/REACH_MM)^2)` with its
        distance d from touched gel; in a face it gets 0. If no coarse pixel is at rest, the coarse pixels with the largest
        fraction at rest are taken instead.
        """
        coarse = self._coarse
        depth_px = coarse.depth_px(coarse.means(gradients)[0]) if depth_px is None else depth_px
        share, distance = np.empty((2, *coarse.shape), np.float32)
        anchor = np.empty(self.shape, np.float32)
        with self._pool.one() as work:
            _distance_from_touched(at_rest, work, share, distance, UNTOUCHED_FRACTION)
            far = 1 - np.exp(-np.square(distance * self._per_reach))
            holds = _rest_anchor(
                depth_px, share, far, at_rest, work, anchor, self.hold, UNTOUCHED_FRACTION, self._face_px
            )
        return anchor if holds else None


class CoarseDepth:
    """Least-squares depth of frames; immutable. A color change up to `untouched` means rest, where depth is 0."""

    def __init__(self, shape: tuple[int, int], untouched: float) -> None:
        self._square = float(np.float32(untouched**2))
        self._coarse = coarse_of(shape)

    def __call__(self, color_change: Map, gradients: Slopes, hidden: Mask | None = None) -> Map:
        """Depth (rows, columns) on the coarser grid, px; no depth is less than 0. Arguments as for `signed`."""
        return np.maximum(self.signed(color_change, gradients, hidden), 0)

    def signed(self, color_change: Map, gradients: Slopes, hidden: Mask | None = None) -> Map:
        """Depth (rows, columns) on the coarser grid, px; its median over the samples at rest is 0.

        It comes from a color change (H, W, 3) and the gradients (H, W, 2) of a color model. The slopes around hidden pixels
        (H, W) are continued across them.
        """
        shape, width = self._coarse.shape, color_change.shape[1]
        change, slopes = np.empty((*shape, 3), np.float32), np.empty((*shape, 2), np.float32)
        share, rest = np.empty(shape, np.float32), np.empty(shape, np.bool_)
        work = np.empty(max(4 * (width + shape[1]), 3 * rest.size), np.float32)
        seen = None if hidden is None else ~hidden
        if _cells_over_rest(
            color_change, gradients, seen, work, change, slopes, share, rest, self._square, MIN_UNTOUCHED
        ):
            if (known := share > 0).any():
                change, slopes = fill_unknown(change, known), fill_unknown(slopes, known)
            _slopes_over_rest(change, slopes, rest, work, self._square, MIN_UNTOUCHED)
        depth = self._coarse.depth_px(slopes)
        depth -= medians_where(depth[..., None], rest)[0]
        return depth

    def at_pixels(self, color_change: Map, gradients: Slopes, hidden: Mask | None = None) -> Map:
        """The depth at every pixel (H, W)."""
        return self._coarse.at_pixels(self(color_change, gradients, hidden))
