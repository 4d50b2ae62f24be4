"""Presses held out: dealt into folds, and whole ball sizes left out.

For each fold the circles of the other presses are refined from scratch: no pixel of a scored press, nor a circle
that it helped to place, is ever in the model that scores it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gelform.calibration.circles.alike import groups_alike
from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.refine import agreement, fit_model, misfit_reasons, recentered, refine
from gelform.calibration.circles.samples import PreparedPress
from gelform.color_models import HierarchicalModel
from gelform.progress import Progress, no_progress

FOLDS = 5
MIN_TO_JUDGE = 40
MIN_SHARE = 0.5
MIN_OF_OTHER_SIZES = 16


@dataclass(frozen=True)
class Fold:
    """Presses held out, and what trains without them.

    Attributes
    ----------
    held_out : indices of the presses that are scored
    training : indices of those that train
    contacts : refined circles of the training presses
    """

    held_out: tuple[int, ...]
    training: tuple[int, ...]
    contacts: tuple[ContactCircle, ...]

    def without(self, others: Sequence[int]) -> Fold:
        """The same training presses but for some, which are scored instead of those held out so far."""
        kept = [k for k, i in enumerate(self.training) if i not in set(others)]
        return Fold(
            held_out=tuple(i for i in others if i not in self.held_out),
            training=tuple(self.training[k] for k in kept),
            contacts=tuple(self.contacts[k] for k in kept),
        )


def make_folds(
    presses: Sequence[PreparedPress],
    found: Sequence[ContactCircle],
    usable: Sequence[int],
    *,
    start: HierarchicalModel | None = None,
    progress: Progress = no_progress,
) -> list[Fold]:
    """Deal the usable presses into folds, each size of ball evenly, and refine each fold's training circles.

    Presses that show the same (`groups_alike`) stay in one fold.

    Parameters
    ----------
    presses, found : prepared, and the circle found in each image
    usable : indices of the presses that fit
    start : another unit's model, where the refinement begins
    progress : called with (done, total, what)
    """
    groups = groups_alike(presses, found, sorted(usable, key=lambda i: presses[i].ball_radius_px))
    ordered = [i for group in groups for i in group]
    count = min(FOLDS, len(groups))
    folds = []
    for f in range(count):
        held_out = tuple(i for k, group in enumerate(groups) if k % count == f for i in group)
        folds.append(_fold(presses, found, held_out, [i for i in ordered if i not in held_out], start))
        progress(f + 1, count, "holding presses out")
    return folds


def size_folds(
    presses: Sequence[PreparedPress],
    found: Sequence[ContactCircle],
    usable: Sequence[int],
    *,
    start: HierarchicalModel | None = None,
    progress: Progress = no_progress,
) -> list[Fold]:
    """One fold for each size of ball that can be left out: the others must be half of the presses at least, and 16.

    A model that has learnt the ball instead of the light gives itself away on another size alone. Fewer presses
    would say what every model does with few presses. Parameters are those of `make_folds`.
    """
    sizes = sorted({presses[i].ball_radius_px for i in usable})
    folds = []
    for done, size in enumerate(sizes):
        held_out = tuple(i for i in usable if presses[i].ball_radius_px == size)
        training = [i for i in usable if i not in held_out]
        if len(training) >= max(MIN_SHARE * len(usable), MIN_OF_OTHER_SIZES):
            folds.append(_fold(presses, found, held_out, training, start))
        progress(done + 1, len(sizes), "holding a ball size out")
    return folds


def _fold(
    presses: Sequence[PreparedPress],
    found: Sequence[ContactCircle],
    held_out: tuple[int, ...],
    training: Sequence[int],
    start: HierarchicalModel | None,
) -> Fold:
    refined = refine([presses[i] for i in training], [found[i] for i in training], start=start)
    kept = refined.accepted
    return Fold(
        held_out=held_out,
        training=tuple(training[k] for k in kept),
        contacts=tuple(refined.contacts[k] for k in kept),
    )


def unlike_the_others(
    presses: Sequence[PreparedPress],
    found: Sequence[ContactCircle],
    folds: Sequence[Fold],
    *,
    start: HierarchicalModel | None = None,
) -> dict[int, str]:
    """Presses that a model of the others contradicts, with the reason: a wrong ball diameter, say.

    A press that helped to fit a model bends it towards itself, so each is judged by the fold that left it out.
    Under `MIN_TO_JUDGE` presses the others do not know enough of every place, and none is judged.
    """
    if sum(len(fold.held_out) for fold in folds) < MIN_TO_JUDGE:
        return {}
    indices, agreements = [], []
    for fold in folds:
        model = fit_model([presses[i] for i in fold.training], fold.contacts, start)
        for i in fold.held_out:
            indices.append(i)
            agreements.append(agreement(presses[i], recentered(presses[i], found[i], found[i], model), model))
    reasons = zip(indices, misfit_reasons(agreements))
    return {i: reason for i, reason in reasons if reason is not None}
