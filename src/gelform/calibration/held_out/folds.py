"""Folds of held-out presses.

The circles of the other presses are refined from scratch for each fold. So neither a pixel of a scored press nor a circle
that it helped to place is ever in the model that scores it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.locate import ROUNDS, Located, refine
from gelform.calibration.circles.refine import fit_model, recentered
from gelform.calibration.circles.samples import PreparedPress
from gelform.calibration.enough import FOLDS, NEEDED
from gelform.errors import CalibrationError
from gelform.foundations.progress import Progress, no_progress
from gelform.slopes.color_models import StartableModel


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

    Of under 12 presses each is a fold by itself, because a fold of two would leave too few to train. No two usable presses
    show the same contact (`circles.repeated`). `start` is another unit's model.
    """
    ordered = sorted(usable, key=lambda i: presses[i].ball_radius_px)
    count = FOLDS if NEEDED.edge.met(len(ordered)) else len(ordered)
    folds = []
    for f in range(count):
        held_out = tuple(ordered[f::count])
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


def check_folds(located: Located, folds: Sequence[Fold]) -> None:
    """Raise a CalibrationError if the presses agree with each other only because of a few of them."""
    for fold in folds:
        if not NEEDED.model.met(len(fold.training)):
            names = ", ".join(located.presses.presses[i].name for i in fold.held_out)
            raise CalibrationError(
                f"Expected presses of a ball that fit each other, but without {names} only {len(fold.training)} of the "
                f"other {len(located.refined.accepted) - len(fold.held_out)} do. {' '.join(located.notes)} Press a ball of "
                "known diameter firmly at more places."
            )


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
