"""Presses held out: dealt into folds.

For each fold the circles of the other presses are refined from scratch: no pixel of a scored press, nor a circle
that it helped to place, is ever in the model that scores it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gelform.calibration.circles.alike import groups_alike
from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.refine import refine
from gelform.calibration.circles.samples import PreparedPress
from gelform.color_models import HierarchicalModel
from gelform.progress import Progress, no_progress

FOLDS = 5


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
