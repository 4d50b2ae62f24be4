"""Weighted least squares with confidence found blindly: where the slopes' curl is large, they lie."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.solvers.edges import edges_from_gradients
from gelform.solvers.multigrid import MultigridSolver
from gelform.solvers.system import Solution, Weights

# A pixel lies where the curl around it is more than so many times what is usual in the frame. 2 keeps 99 % of
# pixels under Gaussian noise alone, which costs 2 % of accuracy.
TIMES_USUAL = 2.0
# Curl that slopes good to 0.01 have: less is never held against a pixel.
LEAST_CURL = 0.014
# The usual curl is the median over every seventh loop of a large frame: enough of them, and a median is slow.
EVERY = 7


class GatedSolver:
    """Finds lying pixels by the curl of the slopes, gives them no weight, and solves by `multigrid`.

    Finds specks and noise well; of a patch that lies coherently, only the rim.
    """

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
            raise ValueError("Expected weights per pixel (H, W) for solver 'gated', got weights per edge.")
        given = np.ones(self.shape, dtype=np.float32) if weights is None else weights
        confidence = confidence_from_curl(gradients, self.mm_per_px) * given
        if not np.any(confidence if mask is None else confidence[mask]):
            confidence = given  # a few pixels, and the curl distrusts them all: it cannot tell them apart
        return self._multigrid(gradients, confidence, mask, anchor)


def confidence_from_curl(gradients: NDArray[Any], mm_per_px: tuple[float, float]) -> NDArray[np.float32]:
    """1 where slopes can be those of a surface, 0 where they cannot.

    Around the four loops of edges that meet at a pixel, a surface's slopes add up to 0. What is usual comes
    from the median over the frame, so up to half of it may lie.

    Parameters
    ----------
    gradients : (H, W, 2), mm/mm

    Returns
    -------
    confidence : (H, W) float32, 0 or 1
    """
    ex, ey = edges_from_gradients(np.asarray(gradients, dtype=np.float32))
    mean = np.sqrt(mm_per_px[0] * mm_per_px[1])
    loops = np.float32(mm_per_px[0] / mean) * (ex[:-1] - ex[1:])
    loops += np.float32(mm_per_px[1] / mean) * np.diff(ey)
    height, width = gradients.shape[:2]
    if loops.size == 0:
        return np.ones((height, width), dtype=np.float32)
    squares = np.zeros((height + 1, width + 1), dtype=np.float32)
    squares[1:-1, 1:-1] = loops**2
    count = np.zeros((height + 1, width + 1), dtype=np.float32)
    count[1:-1, 1:-1] = 1
    sample = loops.ravel()[:: EVERY if loops.size > 10_000 else 1]
    usual = max(1.4826 * float(np.median(np.abs(sample))), LEAST_CURL)
    return (_around(squares) < (TIMES_USUAL * usual) ** 2 * _around(count)).astype(np.float32)


def _around(loops: NDArray[np.float32]) -> NDArray[np.float32]:
    """Sum over the four loops that meet at each pixel."""
    return loops[:-1, :-1] + loops[:-1, 1:] + loops[1:, :-1] + loops[1:, 1:]
