"""Depth without known confidence: outliers are found by their residuals, or by the curl of the slopes.

Residuals are those of iteratively reweighted least squares around `multigrid`. Each round computes an edge's weight from
its residual by Cauchy's loss, relative to the usual residual of the frame (P. W. Holland and R. E. Welsch, Robust
regression using iteratively reweighted least-squares, Communications in Statistics A6, 1977).
"""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.arrays import Array, Map, Mask
from gelform.depth.solvers.dct import DctSolver
from gelform.depth.solvers.seam import (
    EVERY_EDGE,
    FLOOR,
    LinearSystem,
    Solution,
    Weights,
    differences,
    edge_system,
    edges_from_gradients,
    per_edge,
    problem_from_gradients,
)
from gelform.depth.solvers.weighted import Grid, MultigridSolver
from gelform.foundations.filters import SIGMA_OF_MEDIAN
from gelform.foundations.pool import Pool


class RobustSolver:
    """A solver for slopes with jumps, which repeats four steps: residuals, usual residual, weights, solve."""

    takes_weights: ClassVar[bool] = True

    def __init__(self, shape: tuple[int, int], mm_per_px: tuple[float, float], *, rounds: int = 3) -> None:
        self.shape, self.mm_per_px, self.rounds = shape, mm_per_px, rounds
        self._uniform = DctSolver(shape, mm_per_px)
        self._pool = Pool(lambda: Grid(shape))

    def __call__(
        self, gradients: Array, weights: Weights = None, mask: Mask | None = None, anchor: Array | None = None
    ) -> Solution:
        """Depth of one frame; given weights multiply those of the loss."""
        problem = problem_from_gradients(gradients, weights, mask, anchor)
        edges, edge_weights = per_edge(problem, np.float32)
        problem = problem._replace(edges=edges, edge_weights=edge_weights)
        usual = 3e-3  # tolerance, of the range of depth: the weights change more from round to round
        with self._pool.one() as grid:
            if weights is None and mask is None and anchor is None:
                depth, iterations, error = self._uniform(gradients).depth_mm, 0, 0.0
            else:
                grid.load(problem, self.mm_per_px)
                depth, iterations, error = grid.solve(usual, 1000)
            for turn in range(self.rounds):
                self._load_round(grid, problem, depth)
                tolerance = 1e-3 if turn == self.rounds - 1 else usual
                depth, more, error = grid.solve(tolerance, 1000, depth, float(np.ptp(depth)))
                iterations += more
        return Solution(depth, problem.known, iterations, error)

    def _load_round(self, grid: Grid, problem: LinearSystem, depth: Map) -> None:
        """Load new weights from the residuals of a depth, and the remaining right side."""
        pitch, (edges, given) = self.mm_per_px, per_edge(problem)
        residual = tuple(e - d for e, d in zip(edges, differences(depth, pitch)))
        # Usual: the median size of the residuals with weight, as a standard deviation; tiny if all are 0.
        sample = [(r.ravel()[::EVERY_EDGE], w.ravel()[::EVERY_EDGE]) for r, w in zip(residual, given)]
        sizes = np.concatenate([np.abs(r[w > 0]) for r, w in sample])
        usual = np.float32(max(SIGMA_OF_MEDIAN * float(np.median(sizes)) if sizes.size else 0.0, 1e-6))
        weights = tuple(w * np.maximum(cauchy_weight(r / usual), FLOOR) for w, r in zip(given, residual))
        remaining = problem._replace(edges=residual, edge_weights=weights)  # type: ignore[arg-type]
        east, south, right = edge_system(remaining, pitch)
        grid.load_edges(east, south, right - problem.anchor * depth, problem.anchor)


def cauchy_weight(residual: Array) -> Array:
    """Weight of a residual in units of the usual one; 2.385 gives 95 % efficiency under Gaussian noise."""
    return 1 / (1 + (residual / 2.385) ** 2)


# Slope per pixel, curl of slopes with errors of 0.01; a smaller curl never makes an outlier.
LEAST_CURL = 0.014


class CurlGatedSolver(MultigridSolver):
    """Finds outlier pixels and patches by the curl of the slopes, gives them no weight, and solves by `multigrid`.

    Not across jumps of the surface: `RobustSolver` is nearer there.
    """

    def __call__(
        self, gradients: Array, weights: Weights = None, mask: Mask | None = None, anchor: Array | None = None
    ) -> Solution:
        """Depth of one frame; given weights (per pixel) are multiplied by the confidence from the curl."""
        if isinstance(weights, tuple):
            raise ValueError("Expected weights per pixel (H, W) for solver 'curl_gated', got some per edge.")
        given, trusted = np.ones(self.shape, dtype=np.float32) if weights is None else weights, None
        if weights is not None or mask is not None:
            inside = given if mask is None else np.where(mask, given, 0)
            trusted = np.asarray(inside > FLOOR * inside.max())
        confidence = confidence_from_curl(gradients, self.mm_per_px, trusted) * given
        if not np.any(confidence if mask is None else confidence[mask]):
            confidence = given  # a few pixels, all of them outliers: the curl cannot separate them
        return super().__call__(gradients, confidence, mask, anchor)


def confidence_from_curl(
    gradients: Array, mm_per_px: tuple[float, float], trusted: Mask | None = None
) -> Map:
    """1 where slopes (H, W, 2) can belong to a surface, 0 where they cannot, (H, W) float32.

    A surface's slopes add up to 0 around the four loops of edges that meet at a pixel, except at a contact's rim, which the
    pixels sample too coarsely. The usual curl comes from the median over the frame, so up to half of the pixels may be
    outliers. Rims show patches of outliers that agree among themselves. Pixels that are not trusted (H, W) do not count
    for their neighbors.
    """
    g = np.ascontiguousarray(gradients, dtype=np.float32)
    height, width = g.shape[:2]
    if min(height, width) < 2:
        return np.ones((height, width), dtype=np.float32)
    # The sum of the edge slopes around each loop of four pixels: (H-1, W-1).
    (ex, ey), mean = edges_from_gradients(g), np.sqrt(mm_per_px[0] * mm_per_px[1])
    circulation = np.float32(mm_per_px[0] / mean) * (ex[:-1] - ex[1:])
    circulation += np.float32(mm_per_px[1] / mean) * (ey[:, 1:] - ey[:, :-1])
    # Not by a sum over the components, which takes five times as long for two.
    to_right, to_below = (d[..., 0] ** 2 + d[..., 1] ** 2 for d in (g[:, 1:] - g[:, :-1], g[1:] - g[:-1]))
    jumps = to_right, to_below
    usual = _usual_circulation(circulation, trusted)
    if trusted is not None:
        across, down = trusted[:, 1:] & trusted[:, :-1], trusted[1:] & trusted[:-1]
        circulation *= across[1:] & across[:-1]
        jumps = jumps[0] * across, jumps[1] * down
    patches = patches_from_jumps(circulation, jumps, usual)
    # An outlier has twice the usual curl: that keeps 99 % of pixels under Gaussian noise, which costs 2 % of accuracy.
    limit = np.full_like(circulation, (2 * usual) ** 2)
    if patches is not None:
        limit += patches.explained
    sound = _around(circulation**2) < _around(limit)
    if patches is not None:
        sound &= ~patches.outlier
    return sound.astype(np.float32)


def _usual_circulation(circulation: Map, trusted: Mask | None) -> float:
    """Standard deviation of the circulation over loops of trusted pixels, from its median."""
    if trusted is None:
        sample = circulation.ravel()
    else:
        sample = circulation[trusted[1:, 1:] & trusted[1:, :-1] & trusted[:-1, 1:] & trusted[:-1, :-1]]
    sample = sample[:: EVERY_EDGE if sample.size > 10_000 else 1]
    return max(SIGMA_OF_MEDIAN * float(np.median(np.abs(sample))), LEAST_CURL) if sample.size else LEAST_CURL


def _around(loops: Map) -> Map:
    """Sum over the four loops that meet at each pixel, fewer on the border: (H, W)."""
    total = np.zeros((loops.shape[0] + 1, loops.shape[1] + 1), dtype=np.float32)
    total[:-1, :-1] = loops
    total[:-1, 1:] += loops
    total[1:, :-1] += loops
    total[1:, 1:] += loops
    return total


class Patches(NamedTuple):
    """The regions that their rims show to be outliers, and the rims of contacts."""

    outlier: Mask  # (H, W) bool: pixels of outlier regions
    explained: Map  # (H-1, W-1) float32: squares of circulation that the rims of contacts explain


def patches_from_jumps(circulation: Map, jumps: tuple[Map, Map], usual: float) -> Patches | None:
    """Judge the regions of a frame; None if no slope jumps.

    Its arguments are the circulation (H-1, W-1) around each loop of four pixels, its usual standard deviation, and the
    squares of the differences of slope between neighbors, (H, W-1) and (H-1, W).
    """
    across, down = jumps
    # Noise alone makes neighbors differ by more than 3 times the usual circulation in 1 % of pairs; surfaces without noise
    # bend by less than 0.1 from pixel to pixel.
    limit = np.float32(max(3 * usual, 0.1) ** 2)
    jumps_across, jumps_down = across > limit, down > limit
    if not (jumps_across.any() or jumps_down.any()):
        return None
    regions, areas = _regions(jumps_across, jumps_down)
    # The largest and the smallest region among the 4x4 pixels around each loop.
    window, numbers = np.ones((4, 4), dtype=np.uint8), regions.astype(np.float32)  # exact: fewer than 2^24
    near = cv2.dilate(numbers, window, anchor=(1, 1))[:-1, :-1].astype(np.int32)
    numbers[regions == 0] = regions.size
    far = cv2.erode(numbers, window, anchor=(1, 1))[:-1, :-1]
    jumping = jumps_across[1:] | jumps_across[:-1] | jumps_down[:, 1:] | jumps_down[:, :-1]
    rim = np.flatnonzero(jumping & (far < near))
    square = 0.5 * (across[1:] + across[:-1] + down[:, 1:] + down[:, :-1])
    along, whole = _sum_around(circulation), _sum_around(np.sqrt(square) * jumping)
    along_rim = along.ravel()[rim] ** 2 > 0.1 * whole.ravel()[rim] ** 2  # no surface has more along its rim
    owner = near.ravel()[rim]
    count = np.bincount(owner, minlength=areas.size)
    # Share of a region's rim with such jumps: contacts have 0 to 0.3, more where patches touch their rim; outlier patches
    # have 0.3 to 0.7. A small region needs less, because little is lost if it was right.
    needed = np.where(areas < 0.005 * regions.size, 0.2, 0.36)
    outlier = np.bincount(owner, along_rim, minlength=areas.size) > needed * count
    contact = rim[count[owner] >= 12]
    explained = np.zeros(circulation.shape, dtype=np.float32)
    explained.ravel()[contact] = 0.2 * square.ravel()[contact]  # the most that single loops of its rim show
    grown = cv2.dilate(outlier[regions].astype(np.uint8), np.ones((3, 3), np.uint8))
    return Patches(grown.astype(bool), explained)


def _regions(jumps_across: Mask, jumps_down: Mask) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Numbers (H, W) of regions of connected pixels without jumps, from 1 for the largest down; areas by number.

    Both pixels of a jump have the number 0.
    """
    smooth = np.ones((jumps_across.shape[0], jumps_down.shape[1]), dtype=np.uint8)
    smooth[:, 1:] &= ~jumps_across
    smooth[:, :-1] &= ~jumps_across
    smooth[1:] &= ~jumps_down
    smooth[:-1] &= ~jumps_down
    count, labels = cv2.connectedComponents(smooth, connectivity=4)
    areas = np.bincount(labels.ravel(), minlength=count)
    order = np.concatenate([[0], 1 + np.argsort(-areas[1:], kind="stable")])
    number = np.empty(count, dtype=np.int32)
    number[order] = np.arange(count)
    return number[labels], areas[order]


def _sum_around(values: Map) -> Map:
    """Sum over 3x3 loops."""
    total = cv2.boxFilter(values, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(total, dtype=np.float32)
