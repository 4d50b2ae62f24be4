"""Dots that a contact stretches, sought with an affine map where a shift alone does not fit.

Beside a steep wall the gel is drawn out, and a dot with it, to nearly twice its width. Its patch is then fitted at
x = c + d + (1 + A) u instead of c + d + u (c its centre at rest, u the place in the patch), with light and strength as
before. Only the few dots that a shift does not explain are sought so: the fit has four more unknowns, and a dot that is
nearly round says little about its rotation.

Baker and Matthews, Lucas-Kanade 20 years on, IJCV 56, 2004 (inverse compositional, affine warp).
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.markers.patches import LAST_STEP_PX, STRENGTH, Followed, Patches

STEPS = 15
ENOUGH_PX = 0.02
MOST_BEND = 0.25  # change of A in one step: the fit is linear in it
DAMPING = 0.02  # of the patch's energy in each column of A: rotation of a round dot stays where it is
STRETCH = (0.35, 2.2)  # singular values of 1 + A that rubber reaches
MOST_LEFT = 0.35  # of the energy of dot and rest together may stay ununexplained: stricter than without A
LIGHT, SHIFT = 6, 7  # columns: quadratic light, the dot, its derivatives (2), their products with u (4)


class StretchedPatches:
    """Prepared for the dots of one gel.

    Parameters
    ----------
    logs : (H, W) float32, of the untouched image: `logs_from_image`
    patches : of its dots
    """

    def __init__(self, logs: NDArray[np.float32], patches: Patches) -> None:
        self._logs, self._patches = logs, patches
        self._down, self._across = np.asarray(np.gradient(logs.astype(np.float64)))

    def __call__(self, logs: NDArray[np.float32], start_px: NDArray[Any], of: NDArray[np.intp]) -> Followed:
        """Seek the dots numbered `of` in an image's logs from shifts (M, 2)."""
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
        inverse = np.linalg.inv(normal)
        shift, warp, radius = np.array(start, dtype=np.float64), np.eye(2), self._patches.radius_px
        for _ in range(STEPS):
            places = (self._patches.centers_px[i] + shift + u @ warp.T).astype(np.float32)
            seen = weight * _sampled(logs, places)
            fit = inverse @ (columns.T @ seen)
            step, bend = _limited(fit[SHIFT:] / max(fit[LIGHT], STRENGTH[0]), 0.6 * radius)
            warp = warp @ np.linalg.inv(np.eye(2) + bend)
            shift = shift - warp @ step
            last = float(np.linalg.norm(step) + radius * np.abs(bend).max())
            if last < ENOUGH_PX or not _is_of_rubber(warp):
                break
        left = float(np.sum((seen - columns @ fit) ** 2))
        unexplained = left / (left + fit[LIGHT] ** 2 * _beside(columns[:, :LIGHT], columns[:, LIGHT]))
        ok = STRENGTH[0] < fit[LIGHT] < STRENGTH[1] and last < LAST_STEP_PX and unexplained < MOST_LEFT
        variance = left / (len(u) - len(fit)) * np.trace(inverse[SHIFT : SHIFT + 2, SHIFT : SHIFT + 2]) / 2
        return shift, bool(ok and _is_of_rubber(warp)), float(np.sqrt(variance) / max(fit[LIGHT], 0.1))

    def _columns(self, i: int) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Places (P, 2) of a patch's pixels from its dot's centre, their weights, and weighted columns (P, 13)."""
        left, top = (int(place) for place in self._patches.corners_px[i])
        side = self._patches.side_px
        at = slice(top, top + side), slice(left, left + side)
        row, column = np.mgrid[at]
        u = np.stack([column.ravel(), row.ravel()], axis=-1) - self._patches.centers_px[i].astype(np.float64)
        weight = self._patches.weights[i].astype(np.float64)
        x, y = u.T / (side // 2)
        dot, across, down = (part[at].ravel() for part in (self._logs, self._across, self._down))
        light = [np.ones_like(x), x, y, x * x, x * y, y * y]
        bend = [across * u[:, 0], across * u[:, 1], down * u[:, 0], down * u[:, 1]]
        return u, weight, np.column_stack([*light, dot, across, down, *bend]) * weight[:, None]


def _sampled(logs: NDArray[np.float32], places: NDArray[np.float32]) -> NDArray[np.float64]:
    """Values (P,) at places (P, 2); beyond the border the nearest."""
    x, y = places.T[:, :, None]
    return np.asarray(cv2.remap(logs, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)).ravel() + 0.0


def _limited(step: NDArray[np.float64], longest: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A step's shift (2,), of a length at most, and change of A (2, 2): the fit is linear in both."""
    length = max(float(np.linalg.norm(step[:2])), 1e-9)
    return step[:2] * min(1.0, longest / length), np.clip(step[2:], -MOST_BEND, MOST_BEND).reshape(2, 2)


def _is_of_rubber(warp: NDArray[np.float64]) -> bool:
    """Whether a map (2, 2) stretches and squeezes no more than a gel can."""
    stretch = np.linalg.svd(warp, compute_uv=False)
    return bool(stretch[0] < STRETCH[1] and stretch[1] > STRETCH[0])


def _beside(columns: NDArray[np.float64], dot: NDArray[np.float64]) -> float:
    """Energy of what columns (P, C) do not explain of one more (P,)."""
    return float(np.sum((dot - columns @ np.linalg.lstsq(columns, dot, rcond=None)[0]) ** 2))
