"""Markers on the gel, found by their darkness; and a dot's patch, searched for in another image to fractions of a pixel.

A marker is darker in all channels than the gel around it; a contact is bright on one side and dark on the other. So
the mean of the channels is compared with its closing (the largest value nearby, then the smallest of those), which
is the gel without anything small and dark on it. Dots are markers only if they form a grid or are spread evenly;
dust does not.

In the logarithm of the gray level a patch is the light, which is smooth, plus the dot's own darkness, which moves with
the gel. So the patch at a shift d is fitted with a quadratic (the light, whatever a contact makes of it), the rest
patch and its two derivatives. The derivatives give the error of d. A broken dot is as good a patch as a round one.

Next to a steep wall the gel is stretched, and a dot with it, to nearly twice its width. If a shift alone does not
explain a dot, its patch is fitted at x = c + d + (1 + A) u instead of c + d + u (c its center at rest, u the position in
the patch). That fit has four more unknowns, and a nearly round dot hardly determines its rotation.

Baker and Matthews, Lucas-Kanade 20 years on, IJCV 56, 2004 (inverse compositional, with linear appearance; affine warp).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import scipy  # its parts load at first use
from numpy.typing import ArrayLike, NDArray

from gelform._native import Kernel
from gelform.arrays import Array, Floats, Image, Map, Mask, Numbers
from gelform.foundations.checks import check_image
from gelform.foundations.filters import CHANGE_OFFSET, log_levels
from gelform.image.view import as_levels

# Range of a present dot's strength, and of its width, over those at rest: turned away it is fainter, stretched stronger.
STRENGTH = (0.3, 2.2)
LAST_STEP_PX = 0.1  # the largest last step of a valid fit
STEPS, END_PX = 8, 0.01  # at most; px, no place is known better: so small a step ends a search
LIGHT = 6  # columns of quadratic light; then the dot, and from SHIFT on its derivatives (2), their products with u (4)
SHIFT = LIGHT + 1

_MEAN = np.full((1, 3), 1 / 3, dtype=np.float32)  # mean of the channels
_LOGS = np.log(np.arange(256, dtype=np.float32) + np.float32(CHANGE_OFFSET))
_follow_patches = Kernel(
    "follow_patches",
    "f32[h,w] image, i32[n,2] corners, f32[n,pixels] weight, f32[n,9,pixels] basis, f32[n,3,3] triangle, "
    "out f32[n,2] shift, out f32[n,4] fit, i32 side, i32 steps, f32 longest",
)


class Followed(NamedTuple):
    """Patches found in an image."""

    shift_px: Floats  # (N, 2) float32, from rest
    ok: Mask  # (N,), whether the dot is there
    sigma_px: Floats  # (N,) float32


class MarkerPatches:
    """The patches of a gel's dots, prepared once from `logs_from_image` of its background image.

    `centers_px` (N, 2) are x and y, `radius_px` is that of a dot.
    """

    def __init__(self, logs: Map, centers_px: Array, radius_px: float) -> None:
        height, width = self._shape = logs.shape
        # Half a patch is 1.35 radii and a pixel; 63 pixels a side are the most of native/image/markers/follow.c.
        half = int(min(np.ceil(1.35 * radius_px + 1), 31, (min(logs.shape) - 1) // 2))
        self.side_px, self._longest = 2 * half + 1, 0.6 * radius_px
        self.radius_px = radius_px
        most = np.array([width, height]) - self.side_px
        self.corners_px = np.clip(np.rint(centers_px) - half, 0, most).astype(np.int32)
        self.centers_px = np.asarray(centers_px, dtype=np.float32)
        count = len(self.corners_px)
        self.weights = np.empty((count, self.side_px**2), dtype=np.float32)
        self._basis = np.empty((count, SHIFT + 2, self.side_px**2), dtype=np.float32)
        self._triangle = np.empty((count, 3, 3), dtype=np.float32)
        self._spread, self._freedom = np.empty(count), np.empty(count)
        down, across = np.asarray(np.gradient(logs.astype(np.float64)))
        self._parts = logs.astype(np.float64), across, down
        self._prepare()

    def __call__(self, logs: Map, start_px: Array, of: NDArray[np.intp] | None = None) -> Followed:
        """Search for dots in an image's logs from shifts (N, 2); `of` selects dots by number, all by default."""
        chosen = slice(None) if of is None else of
        shift = np.array(start_px, dtype=np.float32, order="C")
        fit = np.zeros((len(shift), 4), dtype=np.float32)
        parts = (self.corners_px, self.weights, self._basis, self._triangle)
        of_chosen = [part[chosen] for part in parts]
        _follow_patches(logs, *of_chosen, shift, fit, side=self.side_px, steps=STEPS, longest=self._longest)
        strength, left, own, last = fit.T
        noise = np.sqrt(left / self._freedom[chosen])
        sigma = (noise / np.maximum(strength, 0.1) * self._spread[chosen]).astype(np.float32)
        ok = (strength > STRENGTH[0]) & (strength < STRENGTH[1]) & (last < LAST_STEP_PX)
        # Of the energy of dot and rest together; dots are stretched and turned.
        ok &= left < 0.8 * (left + own)
        ok &= self.inside(self.centers_px[chosen] + shift)
        return Followed(shift, ok, sigma)

    def stretched(self, logs: Map, start_px: Array, of: NDArray[np.intp]) -> Followed:
        """Search for the dots numbered `of` in an image's logs from shifts (M, 2), with an affine map."""
        found = [self._stretched(logs, int(i), start) for i, start in zip(of, start_px)]
        shift = np.array([f[0] for f in found], dtype=np.float32).reshape(-1, 2)
        ok = np.array([f[1] for f in found], dtype=bool)
        sigma = np.array([f[2] for f in found], dtype=np.float32)
        return Followed(shift, ok & self.inside(self.centers_px[of] + shift), sigma)

    def _stretched(self, logs: Map, i: int, start: Array) -> tuple[Numbers, bool, float]:
        """Shift, whether the dot is there, and sigma of one dot."""
        u, weight, columns = self._columns(i)
        normal = columns.T @ columns
        # The damping keeps the rotation of a round dot.
        normal[np.diag_indices(len(normal))] += [1e-9] * (SHIFT + 2) + [0.02 * np.sum(weight**2)] * 4
        inverse = np.linalg.inv(normal)  # definite by what the diagonal got
        shift, warp = np.array(start, dtype=np.float64), np.eye(2)
        for _ in range(STEPS):
            x, y = (self.centers_px[i] + shift + u @ warp.T).astype(np.float32).T[:, :, None]
            seen = cv2.remap(logs, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
            evidence = weight * (np.asarray(seen).ravel() + 0.0)
            fit = inverse @ (columns.T @ evidence)
            # The fit is linear in the step and in A, so both are limited.
            step = fit[SHIFT:] / max(fit[LIGHT], STRENGTH[0])
            change = np.clip(step[2:], -0.25, 0.25).reshape(2, 2)
            step = step[:2] * min(1.0, self._longest / max(float(np.linalg.norm(step[:2])), 1e-9))
            warp = warp @ np.linalg.inv(np.eye(2) + change)  # never singular, as changes are small
            shift = shift - warp @ step
            last = float(np.linalg.norm(step) + self.radius_px * np.abs(change).max())
            if last < END_PX or not _is_of_rubber(warp):
                break
        left = float(np.sum((evidence - columns @ fit) ** 2))
        light, dot = columns[:, :LIGHT], columns[:, LIGHT]
        own = float(np.sum((dot - light @ np.linalg.lstsq(light, dot, rcond=None)[0]) ** 2))
        unexplained = left / (left + fit[LIGHT] ** 2 * own)
        ok = STRENGTH[0] < fit[LIGHT] < STRENGTH[1] and last < LAST_STEP_PX and unexplained < 0.35
        variance = left / (len(u) - len(fit)) * np.trace(inverse[SHIFT : SHIFT + 2, SHIFT : SHIFT + 2]) / 2
        return shift, bool(ok and _is_of_rubber(warp)), float(np.sqrt(variance) / max(fit[LIGHT], 0.1))

    def _columns(self, i: int) -> tuple[Numbers, Numbers, Numbers]:
        """Positions (P, 2) of a patch's pixels from its dot's center, their weights, and weighted columns (P, 13)."""
        at = self._at(i)
        row, column = np.mgrid[at]
        u = np.stack([column.ravel(), row.ravel()], axis=-1) - self.centers_px[i].astype(np.float64)
        weight = self.weights[i].astype(np.float64)
        x, y = u.T / (self.side_px // 2)
        dot, across, down = (part[at].ravel() for part in self._parts)
        light = [np.ones_like(x), x, y, x * x, x * y, y * y]
        change = [across * u[:, 0], across * u[:, 1], down * u[:, 0], down * u[:, 1]]
        return u, weight, np.column_stack([*light, dot, across, down, *change]) * weight[:, None]

    def _at(self, i: int) -> tuple[slice, slice]:
        """Rows and columns of a patch."""
        left, top = self.corners_px[i].tolist()
        return slice(top, top + self.side_px), slice(left, left + self.side_px)

    def inside(self, places: Array) -> Mask:
        """Whether most of a dot at each position (N, 2) is in the image."""
        margin = 0.7 * self.radius_px
        far = np.array(self._shape[::-1]) - 1 - margin
        inside: Mask = np.all((places >= margin) & (places <= far), axis=1)
        return inside

    def _prepare(self) -> None:
        """Each dot's weights and orthonormal basis: quadratic light, then the patch and its derivatives."""
        half = self.side_px // 2
        y, x = np.mgrid[-half : half + 1, -half : half + 1] / max(half, 1)
        away = half * np.hypot(x, y).ravel()
        # Of other dots that come near.
        taper = 1 / (1 + np.exp((away - 1.6 * self.radius_px) / (0.3 * self.radius_px)))
        light = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1).reshape(-1, LIGHT)
        for i in range(len(self.corners_px)):
            parts = [part[self._at(i)].ravel() for part in self._parts]
            weight = taper * np.exp(parts[0])  # the noise of a logarithm falls with the level
            weight /= weight.mean()
            basis, triangle = np.linalg.qr(np.column_stack([light, *parts]) * weight[:, None])
            sign = np.sign(np.diag(triangle))
            self.weights[i], self._basis[i] = weight, (basis * sign).T
            self._triangle[i] = (triangle * sign[:, None])[6:, 6:]
            # Of the coordinates, where the noise is tapered too.
            noise = (basis * taper[:, None] ** 2).T @ basis
            # A dot is round and dark, as the finder made sure: quadratic light gives neither it nor its derivatives.
            inverse = np.asarray(np.linalg.inv(triangle))[7:]
            self._spread[i] = np.sqrt(np.trace(inverse @ noise @ inverse.T) / 2)
            self._freedom[i] = max(float(np.sum(taper**2) - np.trace(noise)), 1.0)


def logs_from_image(image: Array) -> Map:
    """Logarithm (H, W) of the mean of an image's channels (H, W, 3)."""
    if image.dtype == np.uint8:
        return np.asarray(cv2.LUT(level_from_image(image), _LOGS))
    return log_levels(image)


def level_from_image(image: Array) -> Image:
    """Mean of the channels (H, W), in whole gray levels."""
    return np.asarray(cv2.transform(as_levels(image), _MEAN))


def _is_of_rubber(warp: Numbers) -> bool:
    """Whether the singular values of a map (2, 2) are within the reach of rubber."""
    stretch = np.linalg.svd(warp, compute_uv=False)
    return bool(stretch[0] < STRENGTH[1] and stretch[1] > STRENGTH[0])


LEVEL_OFFSET = 5.0  # gray levels; noise of dark pixels is no darkness
MIN_DOTS, MIN_AREA_PX = 9, 5  # fewer dots form no grid, smaller ones are noise
FOLDS = 4, 6  # neighbors of a dot in a square grid, and in a hexagonal one
SIZE_RANGE = (0.4, 2.5)  # of a dot's area over the typical one
# Of a dot's peak; the first is its edge, the others separate it from a shadow next to it.
LEVELS = (0.3, 0.5, 0.7)


@dataclass(frozen=True)
class Markers:
    """Markers of one image."""

    centers_px: Floats  # (N, 2) float32, x and y; N is 0 if the gel has no markers
    radius_px: float  # of a dot, from their median area; 0 if there are none
    mask: Mask  # (H, W), the pixels that they darken

    def __len__(self) -> int:
        return len(self.centers_px)


class MarkerFinder:
    """Finds a gel's markers in its images, if its background image (H, W, 3), 0-255, has any; prepared once for all frames.

    `untouched` are the markers at rest; none if they neither form a grid nor are evenly spread.
    """

    def __init__(self, background: ArrayLike) -> None:
        image = check_image(background, name="background")
        size = max(3, int(0.13 * min(image.shape[:2])) | 1)  # px, wider than any dot
        self._kernel = np.ones((size, size), dtype=np.uint8)
        darkness = self._darkness(image)
        self._peak, self._area = _dots_of_grid(darkness, size**2)
        self.untouched = self(image)

    def __call__(self, image: Array) -> Markers:
        """The markers of an image (H, W, 3) of this gel, 0-255; they move with its surface."""
        if not self._peak:
            return Markers(np.zeros((0, 2), np.float32), 0.0, np.zeros(image.shape[:2], dtype=bool))
        darkness = self._darkness(image)
        mask = np.zeros(darkness.shape, dtype=bool)
        centers, areas = [np.zeros((0, 2))], [np.zeros(0)]
        least, most = SIZE_RANGE[0] / 2 * self._area, SIZE_RANGE[1] * self._area  # a core is half of its dot
        for level in LEVELS:
            dots, labels, whole = _dots(darkness, level * self._peak, most, least)
            new = _peaks(darkness, labels, len(dots)) > 0.5 * self._peak
            new &= np.bincount(labels[mask], minlength=len(dots) + 1)[1:] == 0
            found = np.concatenate([[False], new])[labels]
            if level != LEVELS[0]:  # from a dot's core to about its edge
                found = cv2.dilate(found.view(np.uint8), np.ones((5, 5), dtype=np.uint8)) > 0
            mask |= found
            centers.append(_centers(darkness, labels, len(dots))[new])
            areas.append(dots[new & whole])
        sizes = areas[1] if len(areas[1]) else np.concatenate(areas)
        radius = float(np.sqrt(np.median(sizes) / np.pi)) if len(sizes) else 0.0
        return Markers(np.concatenate(centers).astype(np.float32), radius, mask)

    def mask(self, image: Array) -> Mask:
        """Pixels (H, W) that the markers darken in the image or in the background: for each frame.

        The color change is divided by the background, so a marker in either image makes wrong slopes. This is faster than
        calling the finder (half of a bare DCT pair at 240x320), because it checks no single dot: it also includes a narrow,
        deep shadow.
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

    def _darkness(self, image: Array) -> Map:
        """Darkness (H, W) relative to the gel around, as a fraction; 0-1."""
        level = level_from_image(image)
        closed = cv2.morphologyEx(level, cv2.MORPH_CLOSE, self._kernel).astype(np.float32)
        darkness: Map = (closed - level) / (closed + np.float32(LEVEL_OFFSET))
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


def _dots_of_grid(darkness: Map, most: float) -> tuple[float, float]:
    """Typical peak and area of the dots of a gel's layout: a grid, or evenly spread all over it; 0, 0 without one."""
    areas, labels, whole = _dots(darkness, 0.12, most)
    if np.count_nonzero(whole) < MIN_DOTS:
        return 0.0, 0.0
    peaks = _peaks(darkness, labels, len(areas))
    strong = whole & (peaks > max(0.2, 0.5 * float(np.percentile(peaks[whole], 80))))
    if np.count_nonzero(strong) < MIN_DOTS:
        return 0.0, 0.0
    typical = float(np.median(areas[strong]))
    alike = strong & (areas > SIZE_RANGE[0] * typical) & (areas < SIZE_RANGE[1] * typical)
    if np.count_nonzero(alike) < MIN_DOTS:
        return 0.0, 0.0
    centers = _centers(darkness, labels, len(areas))[alike]
    if not is_grid(centers):
        # Dots without a grid span 0.6 of the image, and dust is less even.
        all_over = np.all(np.ptp(centers, axis=0) > 0.6 * np.array(darkness.shape[::-1]))
        if not (all_over and len(centers) >= 25 and evenness(centers) > 1.4):
            return 0.0, 0.0
    peak = float(np.median(peaks[alike]))
    areas, _, whole = _dots(darkness, LEVELS[0] * peak, most)
    return peak, float(np.median(areas[whole & (areas > SIZE_RANGE[0] * typical)]))


def evenness(centers_px: Array) -> float:
    """Mean distance of points (N, 2) to the nearest, over that of random points: about 1 for dust, 2 for a square grid.

    Clark and Evans, Ecology 35, 1954. The area is the points' bounding box, half a distance wider.
    """
    nearest = np.asarray(scipy.spatial.cKDTree(centers_px).query(centers_px, k=2)[0])[:, 1]
    area = float(np.prod(np.ptp(centers_px, axis=0) + nearest.mean()))
    return float(nearest.mean() / (0.5 * np.sqrt(area / len(centers_px))))


def is_grid(centers_px: Array) -> bool:
    """Whether points (N, 2) form a regular grid, square or hexagonal, bent or with gaps.

    In a grid 70 % of the points or more have at least two neighbors at about the usual distance of the nearest one, in
    directions that repeat every 90 or 60 degrees.
    """
    if len(centers_px) < MIN_DOTS:
        return False
    found = scipy.spatial.cKDTree(centers_px).query(centers_px, k=1 + max(FOLDS))
    distance, neighbor = np.asarray(found[0]), np.asarray(found[1])
    pitch = float(np.median(distance[:, 1]))
    near = np.abs(distance[:, 1:] - pitch) < 0.3 * pitch
    if np.mean(near.sum(axis=1) >= 2) < 0.7:
        return False
    step = centers_px[neighbor[:, 1:]] - centers_px[:, None]
    angle = np.arctan2(step[..., 1], step[..., 0])[near]
    # 1 for an even grid, 0 for scattered points
    return bool(max(abs(np.mean(np.exp(1j * fold * angle))) for fold in FOLDS) >= 0.5)


def _dots(
    darkness: Map, level: float, most: float, least: float = 0
) -> tuple[Numbers, NDArray[np.int32], Mask]:
    """Areas of compact dark components (`least` px if whole, to `most`), a map of their numbers from 1, and who is whole."""
    count, labels, stats, _ = cv2.connectedComponentsWithStats((darkness > level).astype(np.uint8))
    height, width = darkness.shape
    left, top, wide, high, areas = (stats[1:, k].astype(np.float64) for k in range(5))
    whole = (left > 0) & (top > 0) & (left + wide < width) & (top + high < height)
    longer, shorter = np.maximum(wide, high), np.minimum(wide, high)
    compact = (areas > 0.45 * wide * high) & (longer <= 2.5 * shorter) & (areas >= MIN_AREA_PX)
    compact |= ~whole & (areas >= MIN_AREA_PX)
    compact &= (areas < most) & (~whole | (areas > least))
    number = np.zeros(count, dtype=np.int32)
    number[1:][compact] = np.arange(1, np.count_nonzero(compact) + 1)
    return areas[compact], number[labels], whole[compact]


def _peaks(darkness: Map, labels: NDArray[np.int32], count: int) -> Numbers:
    """Largest darkness of each numbered component (1 to count)."""
    peaks, inside = np.zeros(count + 1, dtype=darkness.dtype), labels > 0
    np.maximum.at(peaks, labels[inside], darkness[inside])  # scipy.ndimage sorts the whole image
    return peaks[1:].astype(np.float64)


def _centers(darkness: Map, labels: NDArray[np.int32], count: int) -> Numbers:
    """Centers (N, 2), x and y, weighted by the darkness, which is above 0 there."""
    rows, columns = np.nonzero(labels)
    number, weight = labels[rows, columns], darkness[rows, columns].astype(np.float64)
    total, x, y = (np.bincount(number, weight * at, minlength=count + 1)[1:] for at in (1, columns, rows))
    return np.stack([x, y], axis=-1) / total[:, None]


class CandidateFinder:
    """Finds possible dots: places that are darker than their surroundings, at a dot's size. Prepared for one gel."""

    def __init__(self, logs: Map, patches: MarkerPatches) -> None:
        # Widths of the two boxes whose means are compared at a candidate: of the largest square in a dot, and of its patch.
        self._inner, self._outer = max(1, round(2**0.5 * patches.radius_px)) | 1, patches.side_px
        self._near = np.ones((max(3, round(patches.radius_px) | 1),) * 2, dtype=np.uint8)
        column, row = np.rint(patches.centers_px).astype(np.intp).T
        self._threshold = STRENGTH[0] * float(np.median(self._response(logs)[row, column]))

    def __call__(self, logs: Map) -> Map:
        """Candidates (M, 2), x and y, to about a pixel."""
        response = self._response(logs)
        peaks = (response >= cv2.dilate(response, self._near)) & (response > self._threshold)
        row, column = np.nonzero(peaks)
        return np.stack([column, row], axis=-1).astype(np.float32)

    def _response(self, logs: Map) -> Map:
        inner, outer = (cv2.blur(logs, (size, size)) for size in (self._inner, self._outer))
        return np.asarray(outer - inner)
