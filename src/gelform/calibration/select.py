"""Choose the color model and the zone that trains, on presses that the model has not seen.

The presses are dealt into folds. For each fold the circles of the other presses are refined from scratch, the
candidates are fitted on them, and the fold's own presses are scored: no pixel of a scored press, nor a circle
that it helped to place, is ever in the model that scores it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.presses import Contact
from gelform.calibration.refine import agreement, fit_model, misfit_reasons, recentered, refine
from gelform.calibration.samples import PreparedPress, contact_samples, with_rest_samples
from gelform.color_models import COLOR_MODELS, ColorModel, Samples
from gelform.metrics import angle_deg, ball_center, ball_gradients
from gelform.progress import Progress, no_progress

FOLDS = 5
ZONES = (0.7, 0.75, 0.8, 0.85, 0.9)
SCORED_ZONE = 0.8
MIN_TO_JUDGE = 40
DEFAULT_ZONE = 0.8
DEGREES = (((1,), 3), ((2, 1), 6), ((3, 2, 0), 9), ((4, 3, 1), 18))


@dataclass(frozen=True)
class Candidate:
    """A color model with its settings and the zone of the contact radius that it trains on."""

    model: str
    zone: float
    settings: tuple[tuple[str, Any], ...] = ()

    def fit(self, presses: Sequence[PreparedPress], contacts: Sequence[Contact]) -> ColorModel:
        """The model, fitted on presses with known circles."""
        samples = self.samples(presses, contacts)
        return COLOR_MODELS[self.model].fit(samples, **dict(self.settings))

    def samples(self, presses: Sequence[PreparedPress], contacts: Sequence[Contact]) -> Samples:
        """What it is fitted on: the contacts' zones and gel at rest."""
        return with_rest_samples(contact_samples(presses, contacts, self.zone), presses, contacts)

    def describe(self) -> str:
        """Name, settings and zone, short."""
        degrees = dict(self.settings).get("position_degrees")
        return f"{self.model}{' ' + '-'.join(map(str, degrees)) if degrees else ''}, zone {self.zone:g}"


@dataclass(frozen=True)
class Fold:
    """The presses that are scored, those that train, and the refined circles of the latter."""

    held_out: tuple[int, ...]
    training: tuple[int, ...]
    contacts: tuple[Contact, ...]


@dataclass(frozen=True)
class Score:
    """A candidate's held-out normal error per press, degrees."""

    candidate: Candidate
    errors_deg: NDArray[np.float64]

    @property
    def mean_deg(self) -> float:
        """Mean over the presses."""
        return float(self.errors_deg.mean())

    @property
    def standard_error_deg(self) -> float:
        """Standard error of that mean."""
        return (
            float(self.errors_deg.std(ddof=1) / np.sqrt(len(self.errors_deg)))
            if len(self.errors_deg) > 1
            else 0.0
        )


def make_folds(
    presses: Sequence[PreparedPress],
    found: Sequence[Contact],
    usable: Sequence[int],
    *,
    progress: Progress = no_progress,
) -> list[Fold]:
    """Deal the usable presses into folds, each size of ball evenly, and refine each fold's training circles."""
    ordered = sorted(usable, key=lambda i: presses[i].ball_radius_px)
    count = min(FOLDS, len(ordered))
    folds = []
    for f in range(count):
        training = [i for k, i in enumerate(ordered) if k % count != f]
        refined = refine([presses[i] for i in training], [found[i] for i in training])
        kept = refined.accepted
        folds.append(
            Fold(
                held_out=tuple(i for k, i in enumerate(ordered) if k % count == f),
                training=tuple(training[k] for k in kept),
                contacts=tuple(refined.contacts[k] for k in kept),
            )
        )
        progress(f + 1, count, "holding presses out")
    return folds


def unlike_the_others(
    presses: Sequence[PreparedPress], found: Sequence[Contact], folds: Sequence[Fold]
) -> dict[int, str]:
    """Presses that a model of the others contradicts, with the reason: a wrong ball diameter, say.

    A press that helped to fit a model bends it towards itself, so each is judged by the fold that left it out.
    Under `MIN_TO_JUDGE` presses the others do not know enough of every place, and none is judged.
    """
    if sum(len(fold.held_out) for fold in folds) < MIN_TO_JUDGE:
        return {}
    indices, agreements = [], []
    for fold in folds:
        model = fit_model([presses[i] for i in fold.training], fold.contacts)
        for i in fold.held_out:
            indices.append(i)
            agreements.append(agreement(presses[i], recentered(presses[i], found[i], found[i], model), model))
    reasons = zip(indices, misfit_reasons(agreements))
    return {i: reason for i, reason in reasons if reason is not None}


def candidates_for(color_model: str, presses: int) -> list[Candidate]:
    """What is tried, simplest first, at the default zone."""
    polynomials = [
        Candidate("polynomial", DEFAULT_ZONE, (("position_degrees", degrees),))
        for degrees, needed in DEGREES
        if presses >= needed
    ]
    known: dict[str, list[Candidate]] = {
        "lambertian": [Candidate("lambertian", DEFAULT_ZONE)],
        "polynomial": polynomials,
    }
    if color_model == "auto":
        return known["lambertian"] + polynomials
    if color_model not in known:
        raise ValueError(f"Expected color_model among auto, {', '.join(known)}, got {color_model!r}.")
    return known[color_model]


def score(
    candidate: Candidate, folds: Sequence[Fold], presses: Sequence[PreparedPress], found: Sequence[Contact]
) -> Score:
    """Held-out normal error of a candidate; `presses` are prepared as its model wants them."""
    errors = []
    for fold in folds:
        model = candidate.fit([presses[i] for i in fold.training], fold.contacts)
        errors += [normal_error_deg(presses[i], found[i], model) for i in fold.held_out]
    return Score(candidate, np.array(errors))


def normal_error_deg(press: PreparedPress, found: Contact, model: ColorModel) -> float:
    """Mean angle to the ball's normals in the scored zone, with a free centre: labels are off by a pixel."""
    rows, cols = press.pixels(found, SCORED_ZONE, 1500)
    gradients = press.gradients(model, rows, cols)
    center = ball_center(gradients, cols, rows, (found.x_px, found.y_px), press.ball_radius_px)
    truth = ball_gradients(cols, rows, center, press.ball_radius_px)
    return float(angle_deg(gradients, truth).mean())
