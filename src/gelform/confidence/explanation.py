"""Why each pixel of a frame was trusted or not: the sigma that each cause adds, its part of the variance, what is named."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.confidence.causes import CAUSES
from gelform.foundations.findings import Finding

LAW = "law"
LEAST_NAMED_PX = 12  # connected pixels where a cause adds enough: fewer are not named, as noise makes a few


@dataclass(frozen=True, eq=False)
class Explanation:
    """Why each pixel was trusted or not.

    Attributes
    ----------
    maps : by cause, (H, W) float32: the standard deviation that it adds, in squares, to that of the slopes, mm/mm;
        0 where it plays no part
    law : (H, W) float32, mm/mm: what is left, by size and place of the slope on held-out presses
    gradients_sigma : (H, W) float32, mm/mm, of the slopes as they were read; the larger of both components
    confidence : (H, W) float32, 0-1: min(1, (clean / gradients_sigma)^2)
    clean : sigma up to which confidence is 1, mm/mm
    """

    maps: Mapping[str, NDArray[np.float32]]
    law: NDArray[np.float32]
    gradients_sigma: NDArray[np.float32]
    confidence: NDArray[np.float32]
    clean: float

    @cached_property
    def shares(self) -> dict[str, float]:
        """Share of the variance that each cause and the law (`"law"`) have, averaged over the pixels; they add up to 1."""
        squares = {LAW: np.square(self.law), **{name: np.square(one) for name, one in self.maps.items()}}
        total = np.maximum(sum(squares.values()), np.float32(1e-12))
        found = {name: float(np.mean(square / total)) for name, square in squares.items()}
        return {name: fraction / sum(found.values()) for name, fraction in found.items()}

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """The faults that matter: each with the fraction of the frame where it alone leaves nothing of a slope."""
        return tuple(
            Finding(name, f"{100 * fraction:.1f} % of the frame is {CAUSES[name].sentence}", fraction)
            for name, one in self.maps.items()
            if CAUSES[name].sentence and (fraction := _named_fraction(one > CAUSES[name].named_from)) > 0
        )

    @cached_property
    def dominant(self) -> NDArray[np.uint8]:
        """What most of each pixel's variance is due to (H, W): 0 the law, k the k-th of `maps`."""
        stack = np.stack([self.law, *self.maps.values()])
        return np.asarray(stack.argmax(axis=0), dtype=np.uint8)

    def to_dict(self) -> dict[str, Any]:
        """Its figures, as JSON can hold them."""
        return {
            "clean_sigma": self.clean,
            "median_sigma": float(np.median(self.gradients_sigma)),
            "mean_confidence": float(self.confidence.mean()),
            "trusted_share": float((self.confidence >= 0.5).mean()),
            "variance_shares": self.shares,
            "findings": [asdict(finding) for finding in self.findings],
        }


def explanation_of(
    maps: Mapping[str, NDArray[np.float32]],
    gradients_sigma: NDArray[np.float32],
    confidence: NDArray[np.float32],
    clean: float,
) -> Explanation:
    """The maps of all causes of a frame, beside the sigma (H, W) and the confidence (H, W) that it was solved with."""
    explained = sum(np.square(one) for one in maps.values())
    law = np.sqrt(np.maximum(np.square(gradients_sigma) - explained, 0))
    return Explanation(maps, np.asarray(law, np.float32), gradients_sigma, confidence, clean)


def _named_fraction(mask: NDArray[np.bool_]) -> float:
    """Share of the pixels in regions of a mask (H, W) that are large enough to be named."""
    _, _, boxes, _ = cv2.connectedComponentsWithStats(mask.view(np.uint8), connectivity=8)
    areas = boxes[1:, cv2.CC_STAT_AREA]
    return float(areas[areas >= LEAST_NAMED_PX].sum()) / mask.size
