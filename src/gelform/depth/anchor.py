"""The anchor: how firmly depth is held at 0 where color and coarse depth look like gel at rest.

Color alone cannot show that nothing touches: the flat face of a punch or a coin has the color of gel at rest.
Therefore a coarse depth is solved first. A region that touched gel encloses, and that lies deeper or higher than rest, is
a flat face: its edge shows that, and it is not held. Gel next to touched gel is not held either, because it is drawn down
by less than its color can show.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.depth.coarse import coarse_of
from gelform.foundations.pool import Pool

REST_SIGMA_MM = 0.057  # mm, sigma of depth at pixels with the color of rest, far from contacts
FACE_MM = (
    0.02  # mm; an enclosed region farther off rest is a face; slope errors tilt a face of a few mm by less
)
REACH_MM = 1.0  # mm; touched gel draws down the gel at this distance, by exp(-(distance/reach)^2)
UNTOUCHED_FRACTION = 0.5  # of a coarse pixel that has the color of rest: above it is at rest, below touched

_rest_hold = Kernel(
    "rest_hold",
    "f32[h,w] depth, f32[h,w] share, f32[h,w]? far, out f32[n] work, out f32[h,w] weight, f32 hold, f32 least, "
    "f32 face",
)
_spread_over_chosen = Kernel(
    "spread_over_chosen", "f32[rows,columns] coarse, bool[h,w] chosen, out f32[n] work, out f32[h,w] map"
)
_distance_to_chosen = Kernel("distance_to_chosen", "bool[h,w] chosen, out f32[n] work, out f32[h,w] distance")
# Floats of work memory; the same as in native/depth/anchor.
WORDS_OF_RUN, WORDS_OF_REGION = 6, 4


class RestAnchor:
    """The anchor of a frame. It is prepared once and immutable; threads can share it.

    Parameters
    ----------
    shape : (H, W)
    mm_per_px : float, mm
    full_confidence_sigma : float, mm/mm; standard deviation of a slope of weight 1
    """

    def __init__(self, shape: tuple[int, int], mm_per_px: float, full_confidence_sigma: float) -> None:
        self.shape, self._mm_per_px = shape, np.float32(mm_per_px)
        self.hold = (full_confidence_sigma * mm_per_px / REST_SIGMA_MM) ** 2
        self._coarse = coarse_of(shape)
        rows, columns = self._coarse.shape
        self._coarse_mm = mm_per_px * sum(self._coarse.pitch_px) / 2
        runs = rows * ((columns + 1) // 2)
        of_coarse = runs * (WORDS_OF_RUN + WORDS_OF_REGION) + 4 * rows * columns
        size = max(4 * shape[1], of_coarse, (rows + 2) * (columns + 2))
        self._pool = Pool(lambda: np.empty(size, dtype=np.float32))

    def __call__(
        self,
        gradients: NDArray[np.float32],
        at_rest: NDArray[np.bool_],
    ) -> NDArray[np.float32]:
        """Anchor (H, W) of slopes (H, W, 2) without bias; 0 where the gel was touched or pressed flat.

        A pixel at rest gets `(full_confidence_sigma mm_per_px / REST_SIGMA_MM)^2`, times `1 - exp(-(d/REACH_MM)^2)` with its
        distance d from touched gel; in a face it gets 0. If no coarse pixel is at rest, the coarse pixels with the largest
        fraction at rest are taken instead.
        """
        coarse = self._coarse
        slopes, fraction = coarse.means(gradients), coarse.means(at_rest)
        depth = coarse.depth_px(slopes) * self._mm_per_px
        weight, anchor = np.empty(coarse.shape, np.float32), np.empty(self.shape, np.float32)
        with self._pool.one() as work:
            far = self._far_from(fraction < min(UNTOUCHED_FRACTION, float(fraction.max())), work)
            _rest_hold(depth, fraction, far, work, weight, self.hold, UNTOUCHED_FRACTION, FACE_MM)
            _spread_over_chosen(weight, at_rest, work, anchor)
        return anchor

    def _far_from(self, touched: NDArray[np.bool_], work: NDArray[np.float32]) -> NDArray[np.float32] | None:
        """Distance factor (h, w) on the coarse grid: 0 at touched gel, 1 far from it; None if nothing is touched."""
        if not touched.any():
            return None
        distance = np.empty(self._coarse.shape, np.float32)
        _distance_to_chosen(touched, work, distance)
        far: NDArray[np.float32] = 1 - np.exp(-np.square(distance * np.float32(self._coarse_mm / REACH_MM)))
        return far
