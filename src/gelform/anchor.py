"""Where depth is held at 0, and how firmly: gel whose colour and coarse depth are those of untouched gel.

Colour alone cannot show that nothing touches: the flat face of a punch or a coin has the colour of untouched gel.
So a coarse depth is found first, and the deeper it is at a pixel, the less firmly that pixel is held. A region that
is enclosed by touched gel and lies deeper or higher than rest is a face, and not held at all: its rim says so. Nor is
the gel beside touched gel, which is drawn down with it by less than a colour tells.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.gradients import fill_unknown
from gelform.medians import medians_where
from gelform.solvers.dct import DctSolver

# How close to 0 gel of untouched colour is, far from what is pressed.
REST_SIGMA_MM = 0.08
# Gel of untouched colour that is deeper than this was more likely pressed flat than has drifted.
PRESSED_MM = 0.05
# An enclosed region off rest by more is a face. Errors of slopes tilt one of a few mm by less.
FACE_MM = 0.02
# How far beside touched gel it is drawn down, by exp(-(distance/reach)^2).
REACH_MM = 1.0
COARSER = 4
UNTOUCHED_SHARE, TOUCHED_SHARE = 0.9, 0.5
# Mean confidence of coarse pixels: from which on all slopes count alike, and up to which they count for nothing.
TRUSTED, LEAST_TRUST = 0.5, 0.05


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
        self._coarse_mm = mm_per_px * (shape[0] / rows + shape[1] / columns) / 2
        self._solver = DctSolver(self._coarse, (mm_per_px * shape[1] / columns, mm_per_px * shape[0] / rows))

    def __call__(
        self,
        gradients: NDArray[np.float32],
        untouched: NDArray[np.bool_],
        confidence: NDArray[np.float32] | None = None,
    ) -> NDArray[np.float32]:
        """Anchor (H, W) of slopes (H, W, 2) without bias, 0 where the gel was touched or pressed flat.

        The coarse depth takes slopes by their confidence (H, W): a spot of light or dirt would otherwise tilt it over
        the whole frame, and untouched gel would count as pressed.

        Untouched pixels hold with `(clean mm_per_px / REST_SIGMA_MM)^2`, times the weight of a robust loss,
        `(1 + (z/PRESSED_MM)^2)^-2`, of their coarse depth z (S. Geman and D. McClure, Bull. Int. Statist.
        Inst. 52, 1987), and times `1 - exp(-(d/REACH_MM)^2)`, d their distance from touched gel.
        """
        rows, columns = self._coarse
        slopes = self._coarse_slopes(gradients, confidence)
        share = cv2.resize(untouched.astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA)
        depth = self._solver(slopes.reshape(rows, columns, 2)).depth_mm
        share = share.reshape(rows, columns)
        rest = share >= min(UNTOUCHED_SHARE, float(share.max()))
        depth -= medians_where(depth[..., None], rest)[0]
        weight = np.float32(self.hold) / (1 + (depth / np.float32(PRESSED_MM)) ** 2) ** 2
        weight *= self._far_from(share < min(TOUCHED_SHARE, float(share.max())))
        weight[_faces(rest, depth)] = 0
        anchor: NDArray[np.float32] = cv2.resize(weight, self.shape[::-1], interpolation=cv2.INTER_LINEAR)
        anchor *= untouched
        return anchor

    def _far_from(self, touched: NDArray[np.bool_]) -> NDArray[np.float32]:
        """0-1 on the coarse grid: 0 at touched gel, 1 far from it."""
        if not touched.any():
            return np.ones(self._coarse, dtype=np.float32)
        distance = cv2.distanceTransform((~touched).view(np.uint8), cv2.DIST_L2, 3).reshape(self._coarse)
        far: NDArray[np.float32] = -np.expm1(-np.square(distance * np.float32(self._coarse_mm / REACH_MM)))
        return far

    def _coarse_slopes(
        self, gradients: NDArray[np.float32], confidence: NDArray[np.float32] | None
    ) -> NDArray[np.float32]:
        """Means of the slopes, by confidence where some are not trusted; the rest filled from their neighbours."""
        size = self._coarse[::-1]
        trust = None if confidence is None else cv2.resize(confidence, size, interpolation=cv2.INTER_AREA)
        if confidence is None or trust is None or trust.min() >= TRUSTED:
            return np.asarray(cv2.resize(gradients, size, interpolation=cv2.INTER_AREA))
        slopes = cv2.resize(gradients * confidence[..., None], size, interpolation=cv2.INTER_AREA)
        slopes = slopes.reshape(*self._coarse, 2) / np.maximum(trust, np.float32(1e-12)).reshape(
            *self._coarse, 1
        )
        known = (trust >= LEAST_TRUST).reshape(self._coarse)
        return fill_unknown(slopes, known) if known.any() else slopes


def _faces(rest: NDArray[np.bool_], depth: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Regions of untouched colour that touched gel encloses, off rest by more than `FACE_MM` in the mean."""
    count, labels = cv2.connectedComponents(np.ascontiguousarray(rest).view(np.uint8), connectivity=4)
    labels = labels.reshape(rest.shape)
    sums = np.bincount(labels.ravel(), depth.ravel(), count)
    face = np.abs(sums) > FACE_MM * np.bincount(labels.ravel(), minlength=count)
    for edge in (labels[0], labels[-1], labels[:, 0], labels[:, -1]):
        face[edge] = False
    face[0] = False
    faces: NDArray[np.bool_] = face[labels]
    return faces
