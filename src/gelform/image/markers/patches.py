"""A dot's patch of the background image, searched for in another image to fractions of a pixel.

In the logarithm of the gray level a patch is the light, which is smooth, plus the dot's own darkness, which moves with
the gel. So the patch at a shift d is fitted with a quadratic (the light, whatever a contact makes of it), the rest
patch and its two derivatives. The derivatives give the error of d. A broken dot is as good a patch as a round one.

Next to a steep wall the gel is stretched, and a dot with it, to nearly twice its width. If a shift alone does not
explain a dot, its patch is fitted at x = c + d + (1 + A) u instead of c + d + u (c its center at rest, u the position in
the patch). That fit has four more unknowns, and a nearly round dot hardly determines its rotation.

Baker and Matthews, Lucas-Kanade 20 years on, IJCV 56, 2004 (inverse compositional, with linear appearance; affine warp).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.foundations.filters import CHANGE_OFFSET, log_levels
from gelform.image.frame import as_levels

STEPS, STRETCHED_STEPS = 8, 15  # largest number of steps of the fit, for a shift and for an affine map
SIDE_RADII = 1.35  # half a patch, in radii of a dot
MOST_SIDE, BASIS = 63, 9  # as in native/image/markers/follow.c
# Range of a present dot's strength over that at rest: turned away it is fainter, stretched it is stronger.
STRENGTH = (0.3, 2.2)
# Largest unexplained fraction of the energy of dot and rest together, because dots are stretched and turned. An affine map
# explains that, so its fraction is smaller.
MOST_LEFT, MOST_LEFT_STRETCHED = 0.8, 0.35
# px, largest last step of a valid fit, and the step that ends a fit.
LAST_STEP_PX, ENOUGH_PX = 0.1, 0.02
MOST_CHANGE = 0.25  # of A in one step; the fit is linear in it
DAMPING = 0.02  # of the patch's energy in each column of A; it keeps the rotation of a round dot
STRETCH = (0.35, 2.2)  # singular values of 1 + A within the reach of rubber
LIGHT, SHIFT = 6, 7  # columns: quadratic light, the dot, its derivatives (2), their products with u (4)

_MEAN = np.full((1, 3), 1 / 3, dtype=np.float32)  # mean of the channels
_LOGS = np.log(np.arange(256, dtype=np.float32) + np.float32(CHANGE_OFFSET))
_follow_patches = Kernel(
    "follow_patches",
    "f32[h,w] image, i32[n,2] corners, f32[n,pixels] weight, f32[n,9,pixels] basis, f32[n,3,3] triangle, "
    "out f32[n,2] shift, out f32[n,4] fit, i32 side, i32 steps, f32 longest",
)


class Followed(NamedTuple):
    """Patches found in an image.

    shift_px : (N, 2) float32, from rest; ok : (N,) bool, whether the dot is there; sigma_px : (N,) float32
    """

    shift_px: NDArray[np.float32]
    ok: NDArray[np.bool_]
    sigma_px: NDArray[np.float32]


class MarkerPatches:
    """The patches of a gel's dots, prepared once.

    Parameters
    ----------
    logs : (H, W) float32, of the background image: `logs_from_image`
    centers_px : (N, 2) x and y
    radius_px : of a dot
    """

    def __init__(self, logs: NDArray[np.float32], centers_px: NDArray[Any], radius_px: float) -> None:
        height, width = self._shape = logs.shape
        half = int(min(np.ceil(SIDE_RADII * radius_px + 1), (MOST_SIDE - 1) // 2, (min(logs.shape) - 1) // 2))
        self.side_px, self._longest = 2 * half + 1, 0.6 * radius_px
        self.radius_px = radius_px
        most = np.array([width, height]) - self.side_px
        self.corners_px = np.clip(np.rint(centers_px) - half, 0, most).astype(np.int32)
        self.centers_px = np.asarray(centers_px, dtype=np.float32)
        count = len(self.corners_px)
        self.weights = np.empty((count, self.side_px**2), dtype=np.float32)
        self._basis = np.empty((count, BASIS, self.side_px**2), dtype=np.float32)
        self._triangle = np.empty((count, 3, 3), dtype=np.float32)
        self._spread, self._freedom = np.empty(count), np.empty(count)
        self._prepare(logs.astype(np.float64))

    def __call__(
        self, logs: NDArray[np.float32], start_px: NDArray[Any], of: NDArray[np.intp] | None = None
    ) -> Followed:
        """Search for dots in an image's logs from shifts (N, 2); `of` selects dots by number, all by default."""
        chosen = np.arange(len(self.corners_px)) if of is None else of
        shift = np.array(start_px, dtype=np.float32, order="C")
        fit = np.zeros((len(chosen), 4), dtype=np.float32)
        parts = (self.corners_px, self.weights, self._basis, self._triangle)
        corners, weight, basis, triangle = parts if of is None else (part[chosen] for part in parts)
        _follow_patches(
            logs,
            corners,
            weight,
            basis,
            triangle,
            shift,
            fit,
            side=self.side_px,
            steps=STEPS,
            longest=self._longest,
        )
        strength, left, own, last = fit.T
        noise = np.sqrt(left / self._freedom[chosen])
        sigma = (noise / np.maximum(strength, 0.1) * self._spread[chosen]).astype(np.float32)
        ok = (strength > STRENGTH[0]) & (strength < STRENGTH[1]) & (last < LAST_STEP_PX)
        ok &= left < MOST_LEFT * (left + own)
        ok &= self.inside(self.centers_px[chosen] + shift)
        return Followed(shift, ok, sigma)

    def inside(self, places: NDArray[Any]) -> NDArray[np.bool_]:
        """Whether most of a dot at each position (N, 2) is in the image."""
        margin = 0.7 * self.radius_px
        far = np.array(self._shape[::-1]) - 1 - margin
        inside: NDArray[np.bool_] = np.all((places >= margin) & (places <= far), axis=1)
        return inside

    def _prepare(self, logs: NDArray[np.float64]) -> None:
        """Each dot's weights and orthonormal basis: quadratic light, then the patch and its derivatives."""
        half = self.side_px // 2
        down, across = np.asarray(np.gradient(logs))
        y, x = np.mgrid[-half : half + 1, -half : half + 1] / max(half, 1)
        away = half * np.hypot(x, y).ravel()
        taper = 1 / (
            1 + np.exp((away - 1.6 * self.radius_px) / (0.3 * self.radius_px))
        )  # of other dots that come near
        light = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1).reshape(-1, 6)
        for i, (left, top) in enumerate(self.corners_px):
            at = slice(top, top + self.side_px), slice(left, left + self.side_px)
            weight = taper * np.exp(logs[at]).ravel()  # the noise of a logarithm falls with the level
            weight /= weight.mean()
            columns = np.column_stack([light, *(part[at].ravel() for part in (logs, across, down))])
            basis, triangle = np.linalg.qr(columns * weight[:, None])
            sign = np.sign(np.diag(triangle))
            self.weights[i], self._basis[i] = weight, (basis * sign).T
            self._triangle[i] = (triangle * sign[:, None])[6:, 6:]
            noise = (
                basis * taper[:, None] ** 2
            ).T @ basis  # of the coordinates, where the noise is tapered too
            # A dot is round and dark, as the finder made sure: quadratic light gives neither it nor its derivatives.
            inverse = np.asarray(np.linalg.inv(triangle))[7:]
            self._spread[i] = np.sqrt(np.trace(inverse @ noise @ inverse.T) / 2)
            self._freedom[i] = max(float(np.sum(taper**2) - np.trace(noise)), 1.0)


def logs_from_image(image: NDArray[Any]) -> NDArray[np.float32]:
    """Logarithm (H, W) of the mean of an image's channels (H, W, 3)."""
    if image.dtype == np.uint8:
        return np.asarray(cv2.LUT(level_from_image(image), _LOGS))
    return log_levels(image)


def level_from_image(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Mean of the channels (H, W), in whole gray levels."""
    return np.asarray(cv2.transform(as_levels(image), _MEAN))


class StretchedPatches:
    """The dots of one gel, searched for with an affine map; `logs` (H, W) are those of the background image."""

    def __init__(self, logs: NDArray[np.float32], patches: MarkerPatches) -> None:
        self._logs, self._patches = logs, patches
        self._down, self._across = np.asarray(np.gradient(logs.astype(np.float64)))

    def __call__(self, logs: NDArray[np.float32], start_px: NDArray[Any], of: NDArray[np.intp]) -> Followed:
        """Search for the dots numbered `of` in an image's logs from shifts (M, 2)."""
        found = [self._one(logs, int(i), start) for i, start in zip(of, start_px)]
        shift = np.array([f[0] for f in found], dtype=np.float32).reshape(-1, 2)
        ok = np.array([f[1] for f in found], dtype=bool)
        sigma = np.array([f[2] for f in found], dtype=np.float32)
        return Followed(shift, ok & self._patches.inside(self._patches.centers_px[of] + shift), sigma)

    def _one(self, logs: NDArray[np.float32], i: int, start: NDArray[Any]) -> tuple[Any, bool, float]:
        """Shift, whether the dot is there, and sigma of one dot."""
        u, weight, columns = self._columns(i)
        normal = columns.T @ columns
        normal[np.diag_indices(len(normal))] += [1e-9] * (SHIFT + 2) + [DAMPING * np.sum(weight**2)] * 4
        inverse = np.linalg.inv(normal)  # definite by what the diagonal got
        shift, warp, radius = np.array(start, dtype=np.float64), np.eye(2), self._patches.radius_px
        for _ in range(STRETCHED_STEPS):
            places = (self._patches.centers_px[i] + shift + u @ warp.T).astype(np.float32)
            evidence = weight * _sampled(logs, places)
            fit = inverse @ (columns.T @ evidence)
            step, change = _limited(fit[SHIFT:] / max(fit[LIGHT], STRENGTH[0]), 0.6 * radius)
            warp = warp @ np.linalg.inv(np.eye(2) + change)  # changes are below MOST_CHANGE
            shift = shift - warp @ step
            last = float(np.linalg.norm(step) + radius * np.abs(change).max())
            if last < ENOUGH_PX or not _is_of_rubber(warp):
                break
        left = float(np.sum((evidence - columns @ fit) ** 2))
        unexplained = left / (
            left + fit[LIGHT] ** 2 * _unexplained_energy(columns[:, :LIGHT], columns[:, LIGHT])
        )
        ok = (
            STRENGTH[0] < fit[LIGHT] < STRENGTH[1]
            and last < LAST_STEP_PX
            and unexplained < MOST_LEFT_STRETCHED
        )
        variance = left / (len(u) - len(fit)) * np.trace(inverse[SHIFT : SHIFT + 2, SHIFT : SHIFT + 2]) / 2
        return shift, bool(ok and _is_of_rubber(warp)), float(np.sqrt(variance) / max(fit[LIGHT], 0.1))

    def _columns(self, i: int) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Positions (P, 2) of a patch's pixels from its dot's center, their weights, and weighted columns (P, 13)."""
        left, top = (int(place) for place in self._patches.corners_px[i])
        side = self._patches.side_px
        at = slice(top, top + side), slice(left, left + side)
        row, column = np.mgrid[at]
        u = np.stack([column.ravel(), row.ravel()], axis=-1) - self._patches.centers_px[i].astype(np.float64)
        weight = self._patches.weights[i].astype(np.float64)
        x, y = u.T / (side // 2)
        dot, across, down = (part[at].ravel() for part in (self._logs, self._across, self._down))
        light = [np.ones_like(x), x, y, x * x, x * y, y * y]
        change = [across * u[:, 0], across * u[:, 1], down * u[:, 0], down * u[:, 1]]
        return u, weight, np.column_stack([*light, dot, across, down, *change]) * weight[:, None]


def _sampled(logs: NDArray[np.float32], places: NDArray[np.float32]) -> NDArray[np.float64]:
    """Values (P,) at positions (P, 2); the nearest value beyond the border."""
    x, y = places.T[:, :, None]
    return np.asarray(cv2.remap(logs, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)).ravel() + 0.0


def _limited(step: NDArray[np.float64], longest: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A step's shift (2,), limited in length, and its limited change of A (2, 2), because the fit is linear in both."""
    length = max(float(np.linalg.norm(step[:2])), 1e-9)
    return step[:2] * min(1.0, longest / length), np.clip(step[2:], -MOST_CHANGE, MOST_CHANGE).reshape(2, 2)


def _is_of_rubber(warp: NDArray[np.float64]) -> bool:
    """Whether a map (2, 2) stretches and squeezes no more than a gel can."""
    stretch = np.linalg.svd(warp, compute_uv=False)
    return bool(stretch[0] < STRETCH[1] and stretch[1] > STRETCH[0])


def _unexplained_energy(columns: NDArray[np.float64], dot: NDArray[np.float64]) -> float:
    """Energy of the part of a column (P,) that columns (P, C) do not explain."""
    return float(np.sum((dot - columns @ np.linalg.lstsq(columns, dot, rcond=None)[0]) ** 2))
