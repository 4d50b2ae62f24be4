"""The reasons for each pixel's confidence: the sigma that each cause adds, its part of the variance, and its name."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.foundations.findings import Finding
from gelform.image.health import BELOW, BLOCK_PX, LIT
from gelform.slopes.confidence.budget import Budget, unseen_sigma
from gelform.slopes.confidence.causes import CAUSES, SATURATED_FROM, bloom_disc

LAW = "law"
# Smallest |mean| of a color change's channels over their RMS for which all are darker (a shadow) or all brighter (a mirror).
ALIKE = 0.5
LEAST_NAMED_PX = 12  # smallest number of connected pixels with a cause; noise makes smaller regions


@dataclass(frozen=True, eq=False)
class Explanation:
    """The reasons for each pixel's confidence.

    Attributes
    ----------
    maps : by cause, (H, W) float32, mm/mm: the standard deviation that it adds, in squares, to that of the slopes;
        0 where it has no part
    law : (H, W) float32, mm/mm: the rest, by the step and the size of the slope on held-out presses
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


class Shown(NamedTuple):
    """What an image showed where slopes are uncertain, in maps (H, W); None: nowhere.

    Attributes
    ----------
    pixels : (H, W, 3) uint8, the raw image
    color_change : (H, W, 3)
    clipped : (H, W, 3) uint8, the unusable channels
    markers, lost, outside : bool, hidden by markers, lost by the camera, and without light at rest
    blur_px : of the color change
    """

    pixels: NDArray[np.uint8]
    color_change: NDArray[np.float32]
    clipped: NDArray[np.uint8] | None
    markers: NDArray[np.bool_] | None
    lost: NDArray[np.bool_] | None
    outside: NDArray[np.bool_] | None
    blur_px: float


def explanation_of(
    budget: Budget,
    rows: Mapping[str, NDArray[np.float32]],
    shown: Shown,
    full_confidence_sigma: float,
) -> Explanation:
    """The rows of a frame's budget under the names of `CAUSES`; `rows` are those of `PreparedBudget.frame_rows`.

    Pixels that show nothing are named for what hides them, and outliers for what their color looks like.
    """
    assert budget.walls is not None
    assert budget.outliers is not None
    nothing, unseen = np.zeros_like(budget.read), np.float32(unseen_sigma(full_confidence_sigma))
    found = dict.fromkeys(CAUSES, nothing) | dict(rows) | {"wall": budget.walls, "steep": budget.steep}
    size = np.sqrt(np.mean(np.square(shown.color_change), axis=-1))
    common = shown.color_change.mean(axis=-1) / np.maximum(size, 1e-12)
    darker, brighter = common < -ALIKE, common > ALIKE
    for name, where in (("shadow", darker), ("specular", brighter), ("off_gamut", ~darker & ~brighter)):
        found[name] = np.where(where, budget.outliers, nothing)
    total = np.square(budget.read) + np.square(budget.steep) + np.square(found["unit"])
    law = np.sqrt(np.maximum(total - sum(np.square(one) for one in found.values()), 0))
    for name, where in _unseen(shown):
        found[name] = np.where(where, unseen, found[name])
    if shown.clipped is not None:
        cost = np.where(shown.clipped.sum(axis=-1) > 1, unseen, law) * shown.clipped.any(axis=-1)
        ends = (shown.pixels >= SATURATED_FROM).any(axis=-1).view(np.uint8)
        bright = cv2.dilate(ends, bloom_disc(shown.blur_px)) > 0
        for name, where in (("saturated", bright), ("dark", ~bright)):
            found[name] = np.where(where & (cost > 0), cost, found[name])
    law = np.sqrt(np.maximum(total - sum(np.square(one) for one in found.values()), 0))
    return Explanation(found, law, np.sqrt(total), budget.confidence, full_confidence_sigma)


def _unseen(shown: Shown) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """What hides pixels, by the name of its cause, and where (H, W)."""
    for name, where in (("marker", shown.markers), ("outside", shown.outside)):
        if where is not None:
            yield name, where
    if shown.lost is not None:
        level = cv2.blur(shown.pixels, (BLOCK_PX, BLOCK_PX))
        bright = shown.lost & (level.max(axis=-1) >= BELOW)
        dark = shown.lost & ~bright & (level.min(axis=-1) <= LIT)
        yield "saturated", bright
        yield "dark", dark
        yield "inconsistent", shown.lost & ~bright & ~dark


def _named_fraction(mask: NDArray[np.bool_]) -> float:
    """Share of the pixels in regions of a mask (H, W) that are large enough to be named."""
    _, _, boxes, _ = cv2.connectedComponentsWithStats(mask.view(np.uint8), connectivity=8)
    areas = boxes[1:, cv2.CC_STAT_AREA]
    return float(areas[areas >= LEAST_NAMED_PX].sum()) / mask.size
