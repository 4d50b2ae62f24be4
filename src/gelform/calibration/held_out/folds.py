"""Folds of held-out presses.

The circles of the other presses are refined from scratch for each fold. So neither a pixel of a scored press nor a circle
that it helped to place is ever in the model that scores it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from gelform.calibration.circles.find import ContactCircle, scale_of
from gelform.calibration.circles.locate import ROUNDS, refine
from gelform.calibration.circles.refine import fit_model, recentered
from gelform.calibration.circles.samples import PreparedPress
from gelform.calibration.enough import FOLDS
from gelform.color_models import StartableModel
from gelform.foundations.progress import Progress, no_progress

SHORTER_SIDE = 12  # px of the small copies that are compared; noise averages out in them
# Of the smaller change; frames of one press differ by up to 0.06, two presses of real sets by 0.081 or more.
MAX_DIFFERENCE = 0.08
# px at 240 rows, and fraction of the smaller radius: circles of one press saved in two ways
NEAR_PX, NEAR_RADIUS = 2.0, 0.04


@dataclass(frozen=True)
class Fold:
    """Indices of the held-out presses and of the training presses, with the refined circles of the latter."""

    held_out: tuple[int, ...]
    training: tuple[int, ...]
    contacts: tuple[ContactCircle, ...]


def make_folds(
    presses: Sequence[PreparedPress],
    found: Sequence[ContactCircle],
    usable: Sequence[int],
    *,
    start: StartableModel | None = None,
    progress: Progress = no_progress,
) -> list[Fold]:
    """Split the usable presses into folds, each size of ball evenly, and refine each fold's training circles.

    Presses of the same contact (`near_duplicates`) stay in one fold. `start` is another unit's model.
    """
    groups = near_duplicates(presses, found, sorted(usable, key=lambda i: presses[i].ball_radius_px))
    ordered = [i for group in groups for i in group]
    count = min(FOLDS, len(groups))
    folds = []
    for f in range(count):
        held_out = tuple(i for k, group in enumerate(groups) if k % count == f for i in group)
        folds.append(_fold(presses, found, held_out, [i for i in ordered if i not in held_out], start))
        progress(f + 1, count, "holding presses out")
    return folds


def _fold(
    presses: Sequence[PreparedPress],
    found: Sequence[ContactCircle],
    held_out: tuple[int, ...],
    training: Sequence[int],
    start: StartableModel | None,
) -> Fold:
    refined = refine([presses[i] for i in training], [found[i] for i in training], start=start)
    kept = refined.accepted
    return Fold(
        held_out=held_out,
        training=tuple(training[k] for k in kept),
        contacts=tuple(refined.contacts[k] for k in kept),
    )


def near_duplicates(
    presses: Sequence[PreparedPress], found: Sequence[ContactCircle], among: Sequence[int]
) -> list[list[int]]:
    """Group the presses that show the same ball at the same place, each of `among` in one group, in order.

    Two are near duplicates if the root mean square difference of their color changes is under 8 % of the smaller change, or
    if
    the same ball left the same circle. Another exposure, compression or moment changes the colors, but not the circle.
    """
    if not among:
        return []
    small = np.stack([_small(presses[i].color_change) for i in among])
    product = small @ small.T
    square = np.diag(product)
    difference = np.maximum(square[:, None] + square - 2 * product, 0)
    alike = difference < MAX_DIFFERENCE**2 * np.minimum(square[:, None], square)
    alike |= _same_circle([presses[i] for i in among], [found[i] for i in among])
    count, group = connected_components(alike, directed=False)
    return [[among[k] for k in np.flatnonzero(group == g).tolist()] for g in range(count)]


def _same_circle(presses: Sequence[PreparedPress], found: Sequence[ContactCircle]) -> NDArray[np.bool_]:
    """Whether (n, n) two presses show the same ball at the same place and depth."""
    x, y, radius = np.array([circle.circle_px for circle in found]).T
    ball = np.array([press.ball_radius_px for press in presses])
    near = NEAR_PX * scale_of(presses[0].size.shape)
    apart = np.hypot(x[:, None] - x, y[:, None] - y)
    unlike = np.abs(radius[:, None] - radius) / np.minimum(radius[:, None], radius)
    return np.asarray((apart < near) & (unlike < NEAR_RADIUS) & (ball[:, None] == ball))


def _small(change: NDArray[np.float32]) -> NDArray[np.float64]:
    """A color change without the part that all pixels share, averaged down; flat."""
    height, width = change.shape[:2]
    scale = min(1.0, SHORTER_SIDE / min(height, width))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    small = cv2.resize(change, size, interpolation=cv2.INTER_AREA)
    return (small - np.median(small, axis=(0, 1))).ravel().astype(np.float64)


def circle_sigmas(
    presses: Sequence[PreparedPress],
    found: Sequence[ContactCircle],
    folds: Sequence[Fold],
    start: StartableModel | None = None,
) -> dict[int, tuple[float, float]]:
    """Standard deviations, px, of each usable press's center (either axis) and of its visible radius.

    It is a delete-a-group jackknife (B. Efron, The Jackknife, SIAM 1982, eq. 3.6) of the joint refinement: each circle is
    refined without each fold; without its own fold, it is fitted to a model that has not seen it. An error common to all
    refinements is not in it; on simulated presses distances to the truth are about 1.5 times as large.
    """
    circles: dict[int, list[tuple[float, float, float]]] = {}
    for fold in folds:
        for i, contact in zip(fold.training, fold.contacts):
            circles.setdefault(i, []).append(contact.circle_px)
        if fold.training:
            model = fit_model([presses[i] for i in fold.training], fold.contacts, start)
            for i in fold.held_out:
                contact = found[i]
                for _ in range(ROUNDS):
                    contact = recentered(presses[i], contact, found[i], model)
                circles.setdefault(i, []).append(contact.circle_px)
    return {i: _jackknife(np.array(known)) for i, known in circles.items() if len(known) > 1}


def _jackknife(circles: np.ndarray) -> tuple[float, float]:
    count = len(circles)
    variance = (count - 1) / count * np.sum((circles - circles.mean(axis=0)) ** 2, axis=0)
    return float(np.sqrt(variance[:2].mean())), float(np.sqrt(variance[2]))
