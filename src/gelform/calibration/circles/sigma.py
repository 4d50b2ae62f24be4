"""How well the contact circles are known: how far they move when a fold of presses is left out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.refine import fit_model, recentered
from gelform.calibration.circles.samples import PreparedPress
from gelform.calibration.selection.folds import Fold
from gelform.color_models import HierarchicalModel

MOVES = 4


def circle_sigmas(
    presses: Sequence[PreparedPress],
    found: Sequence[ContactCircle],
    folds: Sequence[Fold],
    start: HierarchicalModel | None = None,
) -> dict[int, tuple[float, float]]:
    """Standard deviations, px, of each usable press's centre (either axis) and of its visible radius.

    A delete-a-group jackknife (B. Efron, The Jackknife, SIAM 1982, eq. 3.6) of the joint refinement: each circle as
    it comes out without each fold; without its own, it is fitted to a model that has not seen it. What all
    refinements have in common is not in it: on simulated presses distances to the truth are about 1.5 times as
    large.
    """
    circles: dict[int, list[tuple[float, float, float]]] = {}
    for fold in folds:
        for i, contact in zip(fold.training, fold.contacts):
            circles.setdefault(i, []).append(contact.circle_px)
        if fold.training:
            model = fit_model([presses[i] for i in fold.training], fold.contacts, start)
            for i in fold.held_out:
                contact = found[i]
                for _ in range(MOVES):
                    contact = recentered(presses[i], contact, found[i], model)
                circles.setdefault(i, []).append(contact.circle_px)
    return {i: _jackknife(np.array(known)) for i, known in circles.items() if len(known) > 1}


def _jackknife(circles: np.ndarray) -> tuple[float, float]:
    count = len(circles)
    variance = (count - 1) / count * np.sum((circles - circles.mean(axis=0)) ** 2, axis=0)
    return float(np.sqrt(variance[:2].mean())), float(np.sqrt(variance[2]))
