"""Where depth is held at 0, and how firmly: gel whose colour and coarse depth are those of untouched gel.

Colour alone cannot show that nothing touches: the flat face of a punch or a coin has the colour of untouched gel.
So a coarse depth is found first, and the deeper it is at a pixel, the less firmly that pixel is held.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.medians import medians_where
from gelform.solvers.dct import DctSolver

# How close to 0 gel of untouched colour is: beside a press it is drawn down a little.
REST_SIGMA_MM = 0.1
# Gel of untouched colour that is deeper than this was more likely pressed flat than has drifted.
PRESSED_MM = 0.05
COARSER = 4
UNTOUCHED_SHARE = 0.9


class RestAnchor:
    """The anchor of a frame; prepared once, immutable, shared by threads.

    Parameters
    ----------
    shape : (H, W)
    mm_per_px : float, mm
    clean : standard deviation of a slope of weight 1, mm/mm
    """

    def __init__(self, shape: tuple[int, int], mm_per_px: float, clean: float) -> None:
        self.shape = shape
        self.hold = (clean * mm_per_px / REST_SIGMA_MM) ** 2
        self._coarse = max(1, shape[0] // COARSER), max(1, shape[1] // COARSER)
        rows, columns = self._coarse
        self._solver = DctSolver(self._coarse, (mm_per_px * shape[1] / columns, mm_per_px * shape[0] / rows))

    def __call__(self, gradients: NDArray[np.float32], untouched: NDArray[np.bool_]) -> NDArray[np.float32]:
        """Anchor (H, W) of slopes (H, W, 2) without bias, 0 where the gel was touched or pressed flat.

        Untouched pixels hold with `(clean mm_per_px / REST_SIGMA_MM)^2`, times the weight of a robust loss,
        `(1 + (z/PRESSED_MM)^2)^-2`, of their coarse depth z (S. Geman and D. McClure, Bull. Int. Statist.
        Inst. 52, 1987).
        """
        rows, columns = self._coarse
        slopes = cv2.resize(gradients, (columns, rows), interpolation=cv2.INTER_AREA)
        share = cv2.resize(untouched.astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA)
        depth = self._solver(slopes.reshape(rows, columns, 2)).depth_mm
        rest = share >= min(UNTOUCHED_SHARE, float(share.max()))
        depth -= medians_where(depth[..., None], rest)[0]
        weight = np.float32(self.hold) / (1 + (depth / np.float32(PRESSED_MM)) ** 2) ** 2
        anchor: NDArray[np.float32] = cv2.resize(weight, self.shape[::-1], interpolation=cv2.INTER_LINEAR)
        anchor *= untouched
        return anchor
