"""The reasons for each pixel's confidence: the sigma that each cause adds, its part of the variance, and its name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.foundations.findings import Finding
from gelform.slopes.confidence.causes import CAUSES

LAW = "law"
LEAST_NAMED_PX = 12  # smallest number of connected pixels with a cause; noise makes smaller regions


@dataclass(frozen=True, eq=False)
class Explanation:
    """The reasons for each pixel's confidence.

    Attributes
    ----------
    maps : by cause, (H, W) float32, mm/mm: the standard deviation that it adds, in squares, to that of the slopes;
        0 where it has no part
    law : (H, W) float32, mm/mm: the rest, by size and place of the slope on held-out presses
    gradients_sigma : (H, W) float32, mm/mm, of the slopes as they were read; the larger of both components
    confidence : (H, W) float32, 0-1: min(1, (full_confidence_sigma / gradients_sigma)^2)
    full_confidence_sigma : sigma up to which confidence is 1, mm/mm
    """

    maps: Mapping[str, NDArray[np.float32]]
    law: NDArray[np.float32]
    gradients_sigma: NDArray[np.float32]
    confidence: NDArray[np.float32]
    full_confidence_sigma: float

    @cached_property
    def shares(self) -> dict[str, float]:
        """Share of the variance of each cause and of the law (`"law"`), averaged over the pixels; the shares add up to 1."""
        squares = {LAW: np.square(self.law), **{name: np.square(one) for name, one in self.maps.items()}}
        total = np.maximum(sum(squares.values()), np.float32(1e-12))
        found = {name: float(np.mean(square / total)) for name, square in squares.items()}
        return {name: fraction / sum(found.values()) for name, fraction in found.items()}

    @cached_property
    def findings(self) -> tuple[Finding, ...]:
        """The important faults, each with the fraction of the frame where it alone leaves no information on a slope."""
        return tuple(
            Finding(name, f"{100 * fraction:.1f} % of the frame is {CAUSES[name].sentence}", fraction)
            for name, one in self.maps.items()
            if CAUSES[name].sentence and (fraction := _named_fraction(one > CAUSES[name].named_from)) > 0
        )

    @cached_property
    def dominant(self) -> NDArray[np.uint8]:
        """The largest part of each pixel's variance (H, W): 0 for the law, k for the k-th of `maps`."""
        stack = np.stack([self.law, *self.maps.values()])
        return np.asarray(stack.argmax(axis=0), dtype=np.uint8)

    def to_dict(self) -> dict[str, Any]:
        """Its figures, as values that JSON can hold."""
        return {
            "full_confidence_sigma": self.full_confidence_sigma,
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
    full_confidence_sigma: float,
) -> Explanation:
    """The maps of all causes of a frame, with its sigma (H, W) and the confidence (H, W) that the solver used."""
    explained = sum(np.square(one) for one in maps.values())
    law = np.sqrt(np.maximum(np.square(gradients_sigma) - explained, 0))
    return Explanation(maps, np.asarray(law, np.float32), gradients_sigma, confidence, full_confidence_sigma)


def _named_fraction(mask: NDArray[np.bool_]) -> float:
    """Share of the pixels in regions of a mask (H, W) that are large enough to be named."""
    _, _, boxes, _ = cv2.connectedComponentsWithStats(mask.view(np.uint8), connectivity=8)
    areas = boxes[1:, cv2.CC_STAT_AREA]
    return float(areas[areas >= LEAST_NAMED_PX].sum()) / mask.size
