"""Presses that show the same: frames of one press, or one picture saved twice. They stay together when some are held out."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.calibration.circles.find import ContactCircle, scale_of
from gelform.calibration.circles.samples import PreparedPress

SHORTER_SIDE = 12  # px of the small copies that are compared: noise averages out in them
MAX_DIFFERENCE = (
    0.08  # of the smaller change; frames of one press: up to 0.06, two presses of real sets: 0.081 or more
)
NEAR_PX, NEAR_RADIUS = 2.0, 0.04  # at 240 rows; of the smaller radius: circles of one press saved in two ways


def groups_alike(
    presses: Sequence[PreparedPress], found: Sequence[ContactCircle], among: Sequence[int]
) -> list[list[int]]:
    """The presses in groups that show the same ball at the same place, each press in one; order is kept.

    Two are alike where the root mean square difference of their color changes is under 8 % of the smaller change, or
    where the same ball left the same circle: another exposure, another compression or another moment changes the
    colours, not the circle.

    Parameters
    ----------
    presses, found : prepared, and the circle found in each image
    among : indices of the presses to group
    """
    if not among:
        return []
    small = np.stack([_small(presses[i].color_change) for i in among])
    product = small @ small.T
    square = np.diag(product)
    difference = np.maximum(square[:, None] + square - 2 * product, 0)
    alike = difference < MAX_DIFFERENCE**2 * np.minimum(square[:, None], square)
    alike |= _same_circle([presses[i] for i in among], [found[i] for i in among])
    groups: list[list[int]] = []
    unassigned = dict.fromkeys(range(len(among)))
    while unassigned:
        group, to_visit = set(), [next(iter(unassigned))]
        while to_visit:
            k = to_visit.pop()
            if k in unassigned:
                del unassigned[k]
                group.add(k)
                to_visit += [int(other) for other in np.flatnonzero(alike[k])]
        groups.append([among[k] for k in sorted(group)])
    return groups


def _same_circle(presses: Sequence[PreparedPress], found: Sequence[ContactCircle]) -> NDArray[np.bool_]:
    """(n, n): the same ball at the same place, as deep."""
    x, y, radius = np.array([circle.circle_px for circle in found]).T
    ball = np.array([press.ball_radius_px for press in presses])
    near = NEAR_PX * scale_of(presses[0].size.shape)
    apart = np.hypot(x[:, None] - x, y[:, None] - y)
    unlike = np.abs(radius[:, None] - radius) / np.minimum(radius[:, None], radius)
    return np.asarray((apart < near) & (unlike < NEAR_RADIUS) & (ball[:, None] == ball))


def _small(change: NDArray[np.float32]) -> NDArray[np.float64]:
    """A color change without what all pixels share, averaged down; flat."""
    height, width = change.shape[:2]
    scale = min(1.0, SHORTER_SIDE / min(height, width))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    small = cv2.resize(change, size, interpolation=cv2.INTER_AREA)
    return (small - np.median(small, axis=(0, 1))).ravel().astype(np.float64)
