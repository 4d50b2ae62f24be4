"""Weighted least squares that finds outliers itself: pixels with a large curl of the slopes around them."""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.depth.solvers.multigrid import MultigridSolver
from gelform.depth.solvers.seam import Solution, Weights
from gelform.depth.solvers.system import EVERY_EDGE, FLOOR, edges_from_gradients
from gelform.foundations.filters import SIGMA_OF_MEDIAN

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
        self,
        gradients: NDArray[Any],
        weights: Weights = None,
        mask: NDArray[np.bool_] | None = None,
        anchor: NDArray[Any] | None = None,
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


def _trusted(weights: NDArray[Any], mask: NDArray[np.bool_] | None) -> NDArray[np.bool_]:
    """Pixels whose slopes count: those with weight."""
    inside = weights if mask is None else np.where(mask, weights, 0)
    return np.asarray(inside > FLOOR * inside.max())


def confidence_from_curl(
    gradients: NDArray[Any], mm_per_px: tuple[float, float], trusted: NDArray[np.bool_] | None = None
) -> NDArray[np.float32]:
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
    usual = _usual(circulation, trusted)
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


def _circulation(g: NDArray[np.float32], mm_per_px: tuple[float, float]) -> NDArray[np.float32]:
    """The sum of the edge slopes around each loop of four pixels: (H-1, W-1)."""
    ex, ey = edges_from_gradients(g)
    mean = np.sqrt(mm_per_px[0] * mm_per_px[1])
    loops = np.float32(mm_per_px[0] / mean) * (ex[:-1] - ex[1:])
    loops += np.float32(mm_per_px[1] / mean) * (ey[:, 1:] - ey[:, :-1])
    return np.asarray(loops)


def _squares(difference: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(difference[..., 0] ** 2 + difference[..., 1] ** 2)


def _usual(circulation: NDArray[np.float32], trusted: NDArray[np.bool_] | None) -> float:
    """Standard deviation of the circulation over loops of trusted pixels, from its median."""
    if trusted is None:
        sample = circulation.ravel()
    else:
        sample = circulation[trusted[1:, 1:] & trusted[1:, :-1] & trusted[:-1, 1:] & trusted[:-1, :-1]]
    sample = sample[:: EVERY_EDGE if sample.size > 10_000 else 1]
    return max(SIGMA_OF_MEDIAN * float(np.median(np.abs(sample))), LEAST_CURL) if sample.size else LEAST_CURL


def _around(loops: NDArray[np.float32]) -> NDArray[np.float32]:
    """Sum over the four loops that meet at each pixel, fewer on the border: (H, W)."""
    total = np.zeros((loops.shape[0] + 1, loops.shape[1] + 1), dtype=np.float32)
    total[:-1, :-1] = loops
    total[:-1, 1:] += loops
    total[1:, :-1] += loops
    total[1:, 1:] += loops
    return total


class Patches(NamedTuple):
    """The regions that their rims show to be outliers, and the rims of contacts.

    Attributes
    ----------
    outlier : (H, W) bool
        Pixels of outlier regions.
    explained : (H-1, W-1) float32
        Squares of circulation that the rims of contacts explain.
    """

    outlier: NDArray[np.bool_]
    explained: NDArray[np.float32]


def patches_from_jumps(
    circulation: NDArray[np.float32],
    jumps: tuple[NDArray[np.float32], NDArray[np.float32]],
    usual: float,
) -> Patches | None:
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


def _regions(
    jumps_across: NDArray[np.bool_], jumps_down: NDArray[np.bool_]
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
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


def _regions_around_loops(regions: NDArray[np.int32]) -> tuple[NDArray[Any], NDArray[Any]]:
    """The smallest and the largest region among the 4x4 pixels around each loop: (H-1, W-1) numbers."""
    window = np.ones((4, 4), dtype=np.uint8)
    numbers = regions.astype(np.float32)  # exact: fewer than 2^24
    near = cv2.dilate(numbers, window, anchor=(1, 1))[:-1, :-1]
    numbers[regions == 0] = regions.size
    return near.astype(np.int32), cv2.erode(numbers, window, anchor=(1, 1))[:-1, :-1]


def _sum_around(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Sum over 3x3 loops."""
    total = cv2.boxFilter(values, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(total, dtype=np.float32)
