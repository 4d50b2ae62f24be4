"""Markers on the gel, found by their darkness in the background image and in other images.

A marker is darker in all channels than the gel around it; a contact is bright on one side and dark on the other. So
the mean of the channels is compared with its closing (the largest value nearby, then the smallest of those), which
is the gel without anything small and dark on it. Dots are markers only if they form a grid or are spread evenly;
dust does not.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import scipy  # its parts load at first use
from numpy.typing import ArrayLike, NDArray

from gelform.foundations.checks import check_image
from gelform.image.markers.patches import level_from_image

CLOSING_FRACTION = 0.13  # of the shorter side; wider than any dot
LEVEL_OFFSET = 5.0  # gray levels; noise of dark pixels is no darkness
# Darkness, as a fraction: smallest of a pixel of a dot, and of a dot's darkest pixel.
FAINT, MIN_PEAK = 0.12, 0.2
MIN_DOTS, MIN_AREA_PX = 9, 5  # fewer dots form no grid, smaller ones are noise
SIZE_RANGE = (0.4, 2.5)  # of a dot's area over the typical one
MIN_ORDER = 0.5  # |mean of exp(i k angle)| over neighbors of a grid, k 4 or 6: 1 for an even grid, 0 for scattered points
# Dots without a grid: fraction of the image that they span, their number and their evenness; dust is less even.
SPAN, MIN_IRREGULAR, MIN_EVENNESS = 0.6, 25, 1.4
# Range of a neighbor's distance over the usual one; smallest fraction of a grid's dots with two such neighbors.
NEIGHBORS, MIN_WITH_NEIGHBORS = (0.7, 1.3), 0.7
# Of a dot's peak; the first is its edge, the others separate it from a shadow next to it.
LEVELS = (0.3, 0.5, 0.7)
# Widths of the two boxes whose means are compared at a candidate, in radii of a dot.
INNER, OUTER = 1.3, 3.6
LEAST_RESPONSE = 0.35  # of the typical dot's difference


@dataclass(frozen=True)
class Markers:
    """Markers of one image.

    Attributes
    ----------
    centers_px : (N, 2) float32, x and y; N is 0 if the gel has no markers
    radius_px : of a dot, from their median area; 0 if there are none
    mask : (H, W) bool, the pixels that they darken
    """

    centers_px: NDArray[np.float32]
    radius_px: float
    mask: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.centers_px)


class MarkerFinder:
    """Finds a gel's markers in its images, if its background has any. It is prepared once for all frames.

    Parameters
    ----------
    background : (H, W, 3), 0-255, background image

    Attributes
    ----------
    untouched : the markers at rest; none if they neither form a grid nor are evenly spread
    """

    def __init__(self, background: ArrayLike) -> None:
        image = check_image(background, name="background")
        size = max(3, int(CLOSING_FRACTION * min(image.shape[:2])) | 1)
        self._kernel = np.ones((size, size), dtype=np.uint8)
        darkness = self._darkness(image)
        self._peak, self._area = _dots_of_grid(darkness)
        self.untouched = self(image)

    def __call__(self, image: NDArray[Any]) -> Markers:
        """The markers of an image (H, W, 3) of this gel, 0-255; they move with its surface."""
        if not self._peak:
            return Markers(np.zeros((0, 2), np.float32), 0.0, np.zeros(image.shape[:2], dtype=bool))
        darkness = self._darkness(image)
        mask = np.zeros(darkness.shape, dtype=bool)
        centers, areas = [np.zeros((0, 2))], [np.zeros(0)]
        for level in LEVELS:
            dots, labels, whole = _dots(darkness, level * self._peak, self._area)
            new = _peaks(darkness, labels, len(dots)) > 0.5 * self._peak
            new &= np.bincount(labels[mask], minlength=len(dots) + 1)[1:] == 0
            found = np.concatenate([[False], new])[labels]
            mask |= found if level == LEVELS[0] else _grown(found)
            centers.append(_centers(darkness, labels, len(dots))[new])
            areas.append(dots[new & whole])
        sizes = areas[1] if len(areas[1]) else np.concatenate(areas)
        radius = float(np.sqrt(np.median(sizes) / np.pi)) if len(sizes) else 0.0
        return Markers(np.concatenate(centers).astype(np.float32), radius, mask)

    def mask(self, image: NDArray[Any]) -> NDArray[np.bool_]:
        """Pixels (H, W) that the markers darken in the image or in the background: for each frame.

        The color change is divided by the background, so a marker in either image makes wrong slopes. This is faster than
        calling the finder (half of a bare DCT pair at 240x320), because it checks no single dot: it also includes a narrow,
        deep
        shadow.
        """
        if not self._peak:
            return np.zeros(image.shape[:2], dtype=bool)
        level = level_from_image(image)
        closed = cv2.morphologyEx(level, cv2.MORPH_CLOSE, self._kernel)
        edge = LEVELS[0] * self._peak
        dark = cv2.compare(
            level, cv2.convertScaleAbs(closed, alpha=1 - edge, beta=-edge * LEVEL_OFFSET), cv2.CMP_LT
        )
        dark |= self.untouched.mask.view(np.uint8) * np.uint8(255)
        return dark > 0

    def _darkness(self, image: NDArray[Any]) -> NDArray[np.float32]:
        """Darkness (H, W) relative to the gel around, as a fraction; 0-1."""
        level = level_from_image(image)
        closed = cv2.morphologyEx(level, cv2.MORPH_CLOSE, self._kernel).astype(np.float32)
        darkness: NDArray[np.float32] = (closed - level) / (closed + np.float32(LEVEL_OFFSET))
        return darkness


def markers_from_image(image: ArrayLike, background: ArrayLike | None = None) -> Markers:
    """Find the markers on a gel.

    Parameters
    ----------
    image : (H, W, 3), RGB, 0-255
    background : (H, W, 3), background image, optional
        It shows whether this gel has markers, and their size. Without it the image itself is used, and dots that a
        contact moved out of their grid may be missed.

    Returns
    -------
    Markers
        Empty for a gel without markers. Dots that neither form a grid nor are spread evenly, such as dust, are no markers.

    Raises
    ------
    ValueError, TypeError
        The image or the background is no (H, W, 3) of numbers in 0-255, or they differ in size.
    """
    pixels = check_image(image)
    if background is None:
        return MarkerFinder(pixels).untouched
    untouched = check_image(background, shape=pixels.shape[:2], name="background")
    return MarkerFinder(untouched)(pixels)


def _dots_of_grid(darkness: NDArray[np.float32]) -> tuple[float, float]:
    """Typical peak and area of the dots of a regular grid; 0, 0 without one."""
    areas, labels, whole = _dots(darkness, FAINT, None)
    if np.count_nonzero(whole) < MIN_DOTS:
        return 0.0, 0.0
    peaks = _peaks(darkness, labels, len(areas))
    strong = whole & (peaks > max(MIN_PEAK, 0.5 * float(np.percentile(peaks[whole], 80))))
    if np.count_nonzero(strong) < MIN_DOTS:
        return 0.0, 0.0
    typical = float(np.median(areas[strong]))
    alike = strong & (areas > SIZE_RANGE[0] * typical) & (areas < SIZE_RANGE[1] * typical)
    if np.count_nonzero(alike) < MIN_DOTS or not _is_layout(
        _centers(darkness, labels, len(areas))[alike], darkness.shape
    ):
        return 0.0, 0.0
    peak = float(np.median(peaks[alike]))
    areas, _, whole = _dots(darkness, LEVELS[0] * peak, None)
    return peak, float(np.median(areas[whole & (areas > SIZE_RANGE[0] * typical)]))


def _is_layout(centers_px: NDArray[Any], shape: tuple[int, ...]) -> bool:
    """Whether points (N, 2) of an image of a shape are a gel's layout: a grid, or evenly spread all over it."""
    if is_grid(centers_px):
        return True
    all_over = bool(np.all(np.ptp(centers_px, axis=0) > SPAN * np.array(shape[::-1])))
    return all_over and len(centers_px) >= MIN_IRREGULAR and evenness(centers_px) > MIN_EVENNESS


def evenness(centers_px: NDArray[Any]) -> float:
    """Mean distance of points (N, 2) to the nearest, over that of random points: about 1 for dust, 2 for a square grid.

    Clark and Evans, Ecology 35, 1954. The area is the points' bounding box, half a distance wider.
    """
    nearest = np.asarray(scipy.spatial.cKDTree(centers_px).query(centers_px, k=2)[0])[:, 1]
    area = float(np.prod(np.ptp(centers_px, axis=0) + nearest.mean()))
    return float(nearest.mean() / (0.5 * np.sqrt(area / len(centers_px))))


def is_grid(centers_px: NDArray[Any]) -> bool:
    """Whether points (N, 2) form a regular grid, square or hexagonal, bent or with gaps.

    In a grid most points have at least two neighbors at about the usual distance of the nearest one, in
    directions that repeat every 90 or 60 degrees.
    """
    if len(centers_px) < MIN_DOTS:
        return False
    found = scipy.spatial.cKDTree(centers_px).query(centers_px, k=min(7, len(centers_px)))
    distance, neighbor = np.asarray(found[0]), np.asarray(found[1])
    pitch = float(np.median(distance[:, 1]))
    near = (distance[:, 1:] > NEIGHBORS[0] * pitch) & (distance[:, 1:] < NEIGHBORS[1] * pitch)
    if np.mean(near.sum(axis=1) >= 2) < MIN_WITH_NEIGHBORS:
        return False
    step = centers_px[neighbor[:, 1:]] - centers_px[:, None]
    angle = np.arctan2(step[..., 1], step[..., 0])[near]
    order = max(abs(np.mean(np.exp(1j * fold * angle))) for fold in (4, 6))
    return bool(order >= MIN_ORDER)


def _dots(
    darkness: NDArray[np.float32], threshold: float, area: float | None
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.bool_]]:
    """Areas of compact dark components, a map of their numbers from 1 (0: none), and whether each is whole."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats((darkness > threshold).astype(np.uint8))
    height, width = darkness.shape
    left, top, wide, high, areas = (stats[1:, k].astype(np.float64) for k in range(5))
    whole = (left > 0) & (top > 0) & (left + wide < width) & (top + high < height)
    longer, shorter = np.maximum(wide, high), np.minimum(wide, high)
    compact = (areas > 0.45 * wide * high) & (longer <= 2.5 * shorter) & (areas >= MIN_AREA_PX)
    compact |= ~whole & (areas >= MIN_AREA_PX)
    compact &= areas < (0.15 * min(height, width)) ** 2 if area is None else areas < SIZE_RANGE[1] * area
    if area is not None:
        compact &= ~whole | (areas > 0.2 * area)
    number = np.zeros(count, dtype=np.int32)
    number[1:][compact] = np.arange(1, np.count_nonzero(compact) + 1)
    return areas[compact], number[labels], whole[compact]


def _grown(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The mask with two more pixels on each side: about from a dot's core to its edge."""
    grown: NDArray[np.bool_] = cv2.dilate(mask.view(np.uint8), np.ones((5, 5), dtype=np.uint8)).view(np.bool_)
    return grown


def _peaks(darkness: NDArray[np.float32], labels: NDArray[np.int32], count: int) -> NDArray[np.float64]:
    """Largest darkness of each numbered component (1 to count; each has pixels)."""
    inside = labels > 0
    number = labels[inside]
    order = np.argsort(number, kind="stable")
    starts = np.searchsorted(number[order], np.arange(1, count + 1))
    peaks = np.maximum.reduceat(darkness[inside][order], starts) if count else np.zeros(0)
    return np.asarray(peaks, dtype=np.float64)


def _centers(darkness: NDArray[np.float32], labels: NDArray[np.int32], count: int) -> NDArray[np.float64]:
    """Centers (N, 2), x and y, weighted by the darkness."""
    rows, cols = np.nonzero(labels)
    number, weight = labels[rows, cols], darkness[rows, cols].astype(np.float64)
    total, x, y = (
        np.bincount(number, w, minlength=count + 1)[1:] for w in (weight, weight * cols, weight * rows)
    )
    return np.stack([x, y], axis=-1) / np.maximum(total, 1e-9)[:, None]


class CandidateFinder:
    """Finds possible dots: places that are darker than their surroundings, at a dot's size. Prepared for one gel."""

    def __init__(self, logs: NDArray[np.float32], centers_px: NDArray[Any], radius_px: float) -> None:
        self._inner, self._outer = (max(1, round(width * radius_px)) | 1 for width in (INNER, OUTER))
        self._near = np.ones((max(3, round(radius_px) | 1),) * 2, dtype=np.uint8)
        column, row = np.rint(centers_px).astype(np.intp).T
        self._threshold = LEAST_RESPONSE * float(np.median(self._response(logs)[row, column]))

    def __call__(self, logs: NDArray[np.float32]) -> NDArray[np.float32]:
        """Candidates (M, 2), x and y, to about a pixel."""
        response = self._response(logs)
        peaks = (response >= cv2.dilate(response, self._near)) & (response > self._threshold)
        row, column = np.nonzero(peaks)
        return np.stack([column, row], axis=-1).astype(np.float32)

    def _response(self, logs: NDArray[np.float32]) -> NDArray[np.float32]:
        inner, outer = (cv2.blur(logs, (size, size)) for size in (self._inner, self._outer))
        return np.asarray(outer - inner)
