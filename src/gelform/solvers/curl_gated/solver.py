"""Weighted least squares that finds outliers by itself: pixels around which the curl of the slopes is large."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from gelform.solvers.curl_gated.patches import patches_from_jumps
from gelform.solvers.edges import edges_from_gradients
from gelform.solvers.multigrid.solver import MultigridSolver
from gelform.solvers.seam import Solution, Weights
from gelform.solvers.system import FLOOR

# A pixel is an outlier where the curl around it is more than so many times what is usual in the frame. 2 keeps
# 99 % of pixels under Gaussian noise alone, which costs 2 % of accuracy.
TIMES_USUAL = 2.0
# Curl that slopes good to 0.01 have: less is never held against a pixel.
LEAST_CURL = 0.014
# The usual curl is the median over every seventh loop of a large frame: all of them would say the same, slower.
EVERY = 7


class CurlGatedSolver:
    """Finds outlier pixels and patches by the curl of the slopes, gives them no weight, solves by `multigrid`."""

    takes_weights: ClassVar[bool] = True

    def __init__(self, shape: tuple[int, int], mm_per_px: tuple[float, float]) -> None:
        self.shape = shape
        self.mm_per_px = mm_per_px
        self._multigrid = MultigridSolver(shape, mm_per_px)

    def __call__(
        self,
        gradients: NDArray[Any],
        weights: Weights = None,
        mask: NDArray[np.bool_] | None = None,
        anchor: NDArray[Any] | None = None,
    ) -> Solution:
        """Depth of one frame; given weights (per pixel) are multiplied by what the curl says."""
        if isinstance(weights, tuple):
            raise ValueError(
                "Expected weights per pixel (H, W) for solver 'curl_gated', got weights per edge."
            )
        given = np.ones(self.shape, dtype=np.float32) if weights is None else weights
        trusted = None if weights is None and mask is None else _trusted(given, mask)
        confidence = confidence_from_curl(gradients, self.mm_per_px, trusted) * given
        if not np.any(confidence if mask is None else confidence[mask]):
            confidence = given  # a few pixels, all of them outliers: the curl cannot tell them apart
        return self._multigrid(gradients, confidence, mask, anchor)


def _trusted(weights: NDArray[Any], mask: NDArray[np.bool_] | None) -> NDArray[np.bool_]:
    """Pixels whose slopes count."""
    inside = weights if mask is None else np.where(mask, weights, 0)
    return np.asarray(inside > FLOOR * inside.max())


def confidence_from_curl(
    gradients: NDArray[Any], mm_per_px: tuple[float, float], trusted: NDArray[np.bool_] | None = None
) -> NDArray[np.float32]:
    """1 where slopes can be those of a surface, 0 where they cannot.

    Around the four loops of edges that meet at a pixel, a surface's slopes add up to 0, but for what the
    pixels make of a contact's rim. What is usual comes from the median over the frame, so up to half of it
    may be outliers. Patches of outliers that agree among themselves are found by their rims.

    Parameters
    ----------
    gradients : (H, W, 2), mm/mm
    mm_per_px : (x, y), mm
    trusted : (H, W) bool, optional
        Pixels whose slopes are trusted: the others say nothing about their neighbours.

    Returns
    -------
    confidence : (H, W) float32, 0 or 1
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
    """Sum of the edge slopes around each loop of four pixels: (H-1, W-1)."""
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
    sample = sample[:: EVERY if sample.size > 10_000 else 1]
    return max(1.4826 * float(np.median(np.abs(sample))), LEAST_CURL) if sample.size else LEAST_CURL


def _around(loops: NDArray[np.float32]) -> NDArray[np.float32]:
    """Sum over the four loops that meet at each pixel, fewer on the border: (H, W)."""
    total = np.zeros((loops.shape[0] + 1, loops.shape[1] + 1), dtype=np.float32)
    total[:-1, :-1] = loops
    total[:-1, 1:] += loops
    total[1:, :-1] += loops
    total[1:, 1:] += loops
    return total
