"""Depth without known confidence: outliers are found by their residuals, or by the curl of the slopes.

Robust depth without known confidence: iteratively reweighted least squares around `multigrid`.

Each round computes an edge's weight from its residual by the loss, relative to the usual residual of the frame
(P. W. Holland and R. E. Welsch, Robust regression using iteratively reweighted least-squares, Communications in
Statistics A6, 1977).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.arrays import Array, Floats, Map, Mask
from gelform.depth.solvers.dct import DctSolver
from gelform.depth.solvers.seam import (
    EVERY_EDGE,
    FLOOR,
    LinearSystem,
    Pair,
    Solution,
    Weights,
    differences,
    divergence,
    edges_from_gradients,
    problem_from_gradients,
)
from gelform.depth.solvers.weighted import Grid, MultigridSolver
from gelform.foundations.filters import SIGMA_OF_MEDIAN
from gelform.foundations.pool import Pool

Loss = Callable[[Array], Array]

# Weight of a residual in units of the usual residual; the constants give 95 % efficiency under Gaussian noise.
LOSSES: dict[str, Loss] = {
    "huber": lambda r: 1.345 / np.maximum(np.abs(r), 1.345),
    "cauchy": lambda r: 1 / (1 + (r / 2.385) ** 2),
    "l1": lambda r: 0.1 / np.maximum(np.abs(r), 0.1),
}
# Fraction of the range of depth, in each round and in the last; the weights change more from round to round.
TOLERANCE, LAST_TOLERANCE = 3e-3, 1e-3


class RobustSolver:
    """A solver that repeats four steps with Cauchy's loss: residuals, usual residual, weights, solve.

    Parameters
    ----------
    shape : (H, W)
    mm_per_px : (x, y), mm
    rounds : int
    """

    takes_weights: ClassVar[bool] = True
    loss: ClassVar[str] = "cauchy"

    def __init__(
        self,
        shape: tuple[int, int],
        mm_per_px: tuple[float, float],
        *,
        rounds: int = 3,
    ) -> None:
        self.shape = shape
        self.mm_per_px = mm_per_px
        self.rounds = rounds
        self._weight = LOSSES[self.loss]
        self._uniform = DctSolver(shape, mm_per_px)
        self._pool = Pool(lambda: Grid(shape))

    def __call__(
        self, gradients: Array, weights: Weights = None, mask: Mask | None = None, anchor: Array | None = None
    ) -> Solution:
        """Depth of one frame; given weights multiply those of the loss."""
        problem = _per_edge(problem_from_gradients(gradients, weights, mask, anchor))
        with self._pool.one() as grid:
            if weights is None and mask is None and anchor is None:
                depth, iterations, error = self._uniform(gradients).depth_mm, 0, 0.0
            else:
                grid.load(problem, self.mm_per_px)
                depth, iterations, error = grid.solve(TOLERANCE, 1000)
            for turn in range(self.rounds):
                self._load_round(grid, problem, depth)
                tolerance = LAST_TOLERANCE if turn == self.rounds - 1 else TOLERANCE
                depth, more, error = grid.solve(tolerance, 1000, depth, float(np.ptp(depth)))
                iterations += more
        return Solution(depth, problem.known, iterations, error)

    def _load_round(self, grid: Grid, problem: LinearSystem, depth: Map) -> None:
        """Load new weights from the residuals of a depth, and the remaining right side."""
        assert problem.edges is not None
        assert problem.edge_weights is not None
        pitch = self.mm_per_px
        residual = tuple(e - d for e, d in zip(problem.edges, differences(depth, pitch)))
        usual = _usual(residual, problem.edge_weights)  # type: ignore[arg-type]
        weights = tuple(
            w * np.maximum(self._weight(r / usual), FLOOR) for w, r in zip(problem.edge_weights, residual)
        )
        flux = tuple(w * r for w, r in zip(weights, residual))
        right = divergence(flux, pitch) * np.float32(pitch[0] * pitch[1])  # type: ignore[arg-type]
        stretched = weights[0] * (pitch[1] / pitch[0]), weights[1] * (pitch[0] / pitch[1])
        system = *stretched, right - problem.anchor * depth, problem.anchor
        grid.load_edges(*(np.ascontiguousarray(array, dtype=np.float32) for array in system))


class HuberSolver(RobustSolver):
    """As `RobustSolver`, with Huber's loss: quadratic for small residuals, absolute for large ones."""

    loss: ClassVar[str] = "huber"


class L1Solver(RobustSolver):
    """As `RobustSolver`, with absolute residuals."""

    loss: ClassVar[str] = "l1"


def _per_edge(problem: LinearSystem) -> LinearSystem:
    """The same problem, with edge slopes and weights."""
    if problem.edges is not None:
        return problem
    assert problem.gradients is not None
    c = problem.confidence
    assert c is not None
    weights = tuple(
        2 * a * b / np.maximum(a + b, np.float32(1e-30)) for a, b in ((c[:, 1:], c[:, :-1]), (c[1:], c[:-1]))
    )
    return problem._replace(edges=edges_from_gradients(problem.gradients), edge_weights=weights)


def _usual(residual: Pair, weights: Pair) -> np.float32:
    """Usual residual: the median size of the residuals with weight, as a standard deviation; tiny if all are 0."""
    sample = [(r.ravel()[::EVERY_EDGE], w.ravel()[::EVERY_EDGE]) for r, w in zip(residual, weights)]
    sizes = np.concatenate([np.abs(r[w > 0]) for r, w in sample])
    return np.float32(max(SIGMA_OF_MEDIAN * float(np.median(sizes)) if sizes.size else 0.0, 1e-6))


# Multiple of the frame's usual curl above which a pixel is an outlier: 2 keeps 99 % of pixels under Gaussian noise, which
# costs 2 % of accuracy.
TIMES_USUAL = 2.0
LEAST_CURL = (
    0.014  # slope per pixel, curl of slopes with errors of 0.01; a smaller curl never makes an outlier
)
# A slope jumps if two neighbors differ by more than JUMP times the usual circulation (noise alone does that to 1 % of
# pairs), and by more than LEAST_JUMP, mm/mm, which is more than surfaces without noise bend from pixel to pixel.
JUMP, LEAST_JUMP = 3.0, 0.1
ALONG_RIM = 0.1  # fraction of the square of the jump that lies along the rim; no surface has more
# Fraction of a region's rim with such jumps that makes the region an outlier. Contacts have 0 to 0.3, more where patches
# touch their rim; outlier patches have 0.3 to 0.7. A region below SMALL of the frame needs only SMALL_RIM, because little is
# lost if it was right.
RIM, SMALL_RIM, SMALL = 0.36, 0.2, 0.005
# Fewest loops of a contact's rim, and the fraction of the square of the jump that single loops of it show.
CONTACT_LOOPS, KINK = 12, 0.2


class CurlGatedSolver(MultigridSolver):
    """Finds outlier pixels and patches by the curl of the slopes, gives them no weight, and solves by `multigrid`."""

    def __call__(
        self, gradients: Array, weights: Weights = None, mask: Mask | None = None, anchor: Array | None = None
    ) -> Solution:
        """Depth of one frame; given weights (per pixel) are multiplied by the confidence from the curl."""
        if isinstance(weights, tuple):
            raise ValueError(
                "Expected weights per pixel (H, W) for solver 'curl_gated', got weights per edge."
            )
        given = np.ones(self.shape, dtype=np.float32) if weights is None else weights
        trusted = None if weights is None and mask is None else _trusted(given, mask)
        confidence = confidence_from_curl(gradients, self.mm_per_px, trusted) * given
        if not np.any(confidence if mask is None else confidence[mask]):
            confidence = given  # a few pixels, all of them outliers: the curl cannot separate them
        return super().__call__(gradients, confidence, mask, anchor)


def _trusted(weights: Array, mask: Mask | None) -> Mask:
    """Pixels whose slopes count: those with weight."""
    inside = weights if mask is None else np.where(mask, weights, 0)
    return np.asarray(inside > FLOOR * inside.max())


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
    circulation = _circulation(g, mm_per_px)
    jumps = _squares(g[:, 1:] - g[:, :-1]), _squares(g[1:] - g[:-1])
    usual = _usual_circulation(circulation, trusted)
    if trusted is not None:
        across, down = trusted[:, 1:] & trusted[:, :-1], trusted[1:] & trusted[:-1]
        circulation *= across[1:] & across[:-1]
        jumps = jumps[0] * across, jumps[1] * down
    patches = patches_from_jumps(circulation, jumps, usual)
    limit = np.full_like(circulation, (TIMES_USUAL * usual) ** 2)
    if patches is not None:
        limit += patches.explained
    sound = _around(circulation**2) < _around(limit)
    if patches is not None:
        sound &= ~patches.outlier
    return sound.astype(np.float32)


def _circulation(g: Floats, mm_per_px: tuple[float, float]) -> Map:
    """The sum of the edge slopes around each loop of four pixels: (H-1, W-1)."""
    ex, ey = edges_from_gradients(g)
    mean = np.sqrt(mm_per_px[0] * mm_per_px[1])
    loops = np.float32(mm_per_px[0] / mean) * (ex[:-1] - ex[1:])
    loops += np.float32(mm_per_px[1] / mean) * (ey[:, 1:] - ey[:, :-1])
    return np.asarray(loops)


def _squares(difference: Map) -> Map:
    return np.asarray(difference[..., 0] ** 2 + difference[..., 1] ** 2)


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
    limit = np.float32(max(JUMP * usual, LEAST_JUMP) ** 2)
    jumps_across, jumps_down = across > limit, down > limit
    if not (jumps_across.any() or jumps_down.any()):
        return None
    regions, areas = _regions(jumps_across, jumps_down)
    near, far = _regions_around_loops(regions)
    jumping = jumps_across[1:] | jumps_across[:-1] | jumps_down[:, 1:] | jumps_down[:, :-1]
    rim = np.flatnonzero(jumping & (far < near))
    square = 0.5 * (across[1:] + across[:-1] + down[:, 1:] + down[:, :-1])
    along, whole = _sum_around(circulation), _sum_around(np.sqrt(square) * jumping)
    along_rim = along.ravel()[rim] ** 2 > ALONG_RIM * whole.ravel()[rim] ** 2
    owner = near.ravel()[rim]
    count = np.bincount(owner, minlength=areas.size)
    needed = np.where(areas < SMALL * regions.size, SMALL_RIM, RIM)
    outlier = np.bincount(owner, along_rim, minlength=areas.size) > needed * count
    contact = rim[count[owner] >= CONTACT_LOOPS]
    explained = np.zeros(circulation.shape, dtype=np.float32)
    explained.ravel()[contact] = KINK * square.ravel()[contact]
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


def _regions_around_loops(regions: NDArray[np.int32]) -> tuple[Array, Array]:
    """The smallest and the largest region among the 4x4 pixels around each loop: (H-1, W-1) numbers."""
    window = np.ones((4, 4), dtype=np.uint8)
    numbers = regions.astype(np.float32)  # exact: fewer than 2^24
    near = cv2.dilate(numbers, window, anchor=(1, 1))[:-1, :-1]
    numbers[regions == 0] = regions.size
    return near.astype(np.int32), cv2.erode(numbers, window, anchor=(1, 1))[:-1, :-1]


def _sum_around(values: Map) -> Map:
    """Sum over 3x3 loops."""
    total = cv2.boxFilter(values, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(total, dtype=np.float32)
