"""Depth that may be missing: what the slopes add up to if all doubted ones were read too small by their deviation.

A face is read too small everywhere or nowhere. So the errors of its slopes add up over the whole face, unlike those that
random draws stand for. Doubted are steep slopes, and walls, which blur mixes with the gel beside them.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.depth.sigma.sigma import DepthDifference
from gelform.depth.solvers.dct import DctSolver
from gelform.depth.stepped import coarse_grid
from gelform.foundations.filters import medians_where
from gelform.foundations.findings import Finding

# mm/mm, deviation of a steep slope from which on depth may be missing: nearly none on balls of the own unit, whose depth is
# right, but on walls and on faces that another unit's model reads.
DOUBTED = 0.2


class MissingDepth:
    """The missing depth of whole frames (H, W), on a grid that is four times coarser; immutable, threads can share it."""

    def __init__(self, shape: tuple[int, int], mm_per_px: float) -> None:
        self._coarse, pitch_px = coarse_grid(shape)
        self._solver = DctSolver(self._coarse, (mm_per_px * pitch_px[0], mm_per_px * pitch_px[1]))

    def __call__(
        self,
        gradients: NDArray[np.float32],
        steep: NDArray[np.float32],
        wall: NDArray[np.float32] | None,
        at_rest: NDArray[np.bool_],
        depth_mm: NDArray[np.float32],
        sigma_mm: NDArray[np.float32] | None,
        difference: DepthDifference | None,
    ) -> tuple[NDArray[np.float32] | None, DepthDifference | None, tuple[Finding, ...]]:
        """The standard deviations (H, W) of a depth (H, W) and of its differences with what is missing, and a finding.

        The slopes (H, W, 2) are those that were read, `steep` (H, W) is the deviation of steep ones, `wall` (H, W) that from
        the blur at walls.
        """
        steep = steep * (steep > DOUBTED)
        doubt = steep if wall is None else np.sqrt(np.square(steep) + np.square(wall))
        if sigma_mm is None or difference is None or not doubt.any():
            return sigma_mm, difference, ()
        missing = self.of_slopes(gradients, doubt, at_rest)
        deepest = np.unravel_index(np.argmax(depth_mm), depth_mm.shape)
        findings = at_least(*(float(one[deepest]) for one in (depth_mm, sigma_mm, missing)))
        if findings and wall is not None:  # of steep slopes alone; with walls it is more
            by_steep = self.of_slopes(gradients, steep, at_rest)
            findings = at_least(*(float(one[deepest]) for one in (depth_mm, sigma_mm, by_steep)))
        stated = np.asarray(np.sqrt(np.square(sigma_mm) + np.square(missing)))
        return stated, replace(difference, missing_mm=missing), findings

    def of_slopes(
        self, gradients: NDArray[np.float32], doubt: NDArray[np.float32], at_rest: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        """The missing depth (H, W), mm, one standard deviation; its median over pixels at rest (H, W) is 0."""
        slopes, sizes, fraction = (
            cv2.resize(values, self._coarse[::-1], interpolation=cv2.INTER_AREA)
            for values in (gradients, doubt, at_rest.astype(np.float32))
        )
        length = np.maximum(np.sqrt(np.square(slopes).sum(axis=-1)), np.float32(1e-6))
        depth = self._solver(slopes * (sizes / length)[..., None]).depth_mm
        depth -= medians_where(depth[..., None], fraction > 0.5)[0]
        return np.asarray(cv2.resize(depth, doubt.shape[::-1], interpolation=cv2.INTER_LINEAR))


def at_least(height_mm: float, sigma_mm: float, missing_mm: float) -> tuple[Finding, ...]:
    """A finding if an object's missing depth exceeds three standard deviations of the rest of its error."""
    if missing_mm <= 3 * sigma_mm:
        return ()
    message = (
        f"The object stands on faces steeper than the presses have shown. Its height is at least {height_mm:.2f} mm; "
        f"{missing_mm:.2f} mm (one standard deviation) may be missing. Press balls deeper on this unit to calibrate it."
    )
    return (Finding("steep", message, missing_mm),)
