"""A dot's patch of the untouched image, sought in another image to parts of a pixel.

In the logarithm of the grey level a patch is the light, which is smooth, plus the dot's own darkness, which moves with
the gel. So the patch at a shift d is fitted with a quadratic (the light, whatever a contact makes of it), the rest
patch and its two derivatives; the latter say how far d is wrong. A broken dot is as good a patch as a round one.

Baker and Matthews, Lucas-Kanade 20 years on, IJCV 56, 2004 (inverse compositional, with linear appearance).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel

OFFSET = 10.0  # grey levels added before the logarithm: noise of dark pixels is no darkness
STEPS = 8
SIDE_RADII = 1.35  # half a patch, of a dot's radius
MOST_SIDE = 63  # of native/markers/follow.c
BASIS = 9
STRENGTH = (
    0.3,
    2.2,
)  # of a dot that is seen, against rest: turned away it is fainter, stretched it is stronger
MOST_LEFT = 0.8  # of the energy of dot and rest together may stay unexplained: dots are stretched and turned
LAST_STEP_PX = 0.1

_LOGS = np.log(np.arange(256, dtype=np.float32) + np.float32(OFFSET))
_follow_patches = Kernel(
    "follow_patches",
    "f32[h,w] image, i32[n,2] corners, f32[n,pixels] weight, f32[n,9,pixels] basis, f32[n,3,3] triangle, "
    "out f32[n,2] shift, out f32[n,4] fit, i32 side, i32 steps, f32 longest",
)


class Followed(NamedTuple):
    """Patches sought in an image.

    shift_px : (N, 2) float32, from rest; ok : (N,) bool, whether the dot is there; sigma_px : (N,) float32
    """

    shift_px: NDArray[np.float32]
    ok: NDArray[np.bool_]
    sigma_px: NDArray[np.float32]


class Patches:
    """The patches of a gel's dots, prepared once.

    Parameters
    ----------
    logs : (H, W) float32, of the untouched image: `logs_from_image`
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
        """Seek dots in an image's logs from shifts (N, 2); `of` picks dots by number, all by default."""
        chosen = np.arange(len(self.corners_px)) if of is None else of
        shift = np.array(start_px, dtype=np.float32, order="C")
        fit = np.zeros((len(chosen), 4), dtype=np.float32)
        parts = (self.corners_px, self.weights, self._basis, self._triangle)
        picked = parts if of is None else tuple(part[chosen] for part in parts)
        _follow_patches(logs, *picked, shift, fit, self.side_px, STEPS, self._longest)
        strength, left, own, last = fit.T
        noise = np.sqrt(left / self._freedom[chosen])
        sigma = (noise / np.maximum(strength, 0.1) * self._spread[chosen]).astype(np.float32)
        ok = (strength > STRENGTH[0]) & (strength < STRENGTH[1]) & (last < LAST_STEP_PX)
        ok &= left < MOST_LEFT * (left + own)
        ok &= self.inside(self.centers_px[chosen] + shift)
        return Followed(shift, ok, sigma)

    def inside(self, places: NDArray[Any]) -> NDArray[np.bool_]:
        """Whether most of a dot at each place (N, 2) is in the image."""
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
            inverse = np.asarray(np.linalg.inv(triangle))[7:]
            self._spread[i] = np.sqrt(np.trace(inverse @ noise @ inverse.T) / 2)
            self._freedom[i] = max(float(np.sum(taper**2) - np.trace(noise)), 1.0)


def logs_from_image(image: NDArray[Any]) -> NDArray[np.float32]:
    """Logarithm (H, W) of the mean of an image's channels (H, W, 3)."""
    if image.dtype == np.uint8:
        return np.asarray(cv2.LUT(level_from_image(image), _LOGS))
    mean = cv2.transform(np.asarray(image, dtype=np.float32), np.full((1, 3), 1 / 3, dtype=np.float32))
    return np.asarray(cv2.log(np.maximum(mean, 0) + np.float32(OFFSET)))


def level_from_image(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Mean of the channels (H, W), in whole grey levels."""
    pixels = image if image.dtype == np.uint8 else np.clip(np.rint(image), 0, 255).astype(np.uint8)
    return np.asarray(cv2.transform(pixels, np.full((1, 3), 1 / 3, dtype=np.float32)))
