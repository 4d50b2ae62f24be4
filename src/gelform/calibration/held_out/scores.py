"""Folds of held-out presses, and the selection of stiffness and forward response by their slopes on them.

Folds of held-out presses.

The circles of the other presses are refined from scratch for each fold. So neither a pixel of a scored press nor a circle
that it helped to place is ever in the model that scores it.

Selection of the stiffness of the color model and the forward response by their slopes on held-out presses.

The score is the mean logarithm of each press's slope error inside the contact edge. One press with a wrong circle can
dominate a mean of errors, but moves a mean of logarithms only by a few per cent.

Reporting the scores of the selection would flatter them. So each fold's presses are reported with the candidate that the
other folds' presses select.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from gelform.calibration.candidates import (
    Candidate,
    FittedSlopes,
    SlopeReader,
    fitted_responses,
    training_samples,
)
from gelform.calibration.circles.find import PRESS_PIXELS, TRIAL_SAMPLES, ContactCircle, PreparedPress
from gelform.calibration.circles.locate import ROUNDS, Located, refine
from gelform.calibration.circles.prepare import prepared_with, untouched_change
from gelform.calibration.circles.refine import fit_model, recentered
from gelform.calibration.coverage import FOLDS, NEEDED
from gelform.errors import CalibrationError
from gelform.foundations.findings import Progress, no_progress
from gelform.result.metrics import score_slopes
from gelform.slopes.color_models import StartableModel
from gelform.slopes.color_models.forward_response import Step


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
    show the same contact (`circles.locate`). `start` is another unit's model.
    """
    ordered = sorted(usable, key=lambda i: presses[i].ball_radius_px)
    count = FOLDS if NEEDED.edge.met(len(ordered)) else len(ordered)
    folds = []
    for f in range(count):
        held_out = ordered[f::count]
        folds.append(fold_of(presses, found, held_out, [i for i in ordered if i not in held_out], start))
        progress(f + 1, count, "holding presses out")
    return folds


def fold_of(
    presses: Sequence[PreparedPress],
    found: Sequence[ContactCircle],
    held_out: Sequence[int],
    training: Sequence[int],
    start: StartableModel | None,
) -> Fold:
    """The fold of some held-out presses, with those of the training presses that fit each other."""
    refined = refine([presses[i] for i in training], [found[i] for i in training], start=start)
    kept = refined.accepted
    return Fold(tuple(held_out), tuple(training[k] for k in kept), tuple(refined.contacts[k] for k in kept))


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


@dataclass(frozen=True)
class HeldOutSlopeScore:
    """RMS error, mm/mm, and mean angle of the slopes of one press; its center is free, since labels are off by a pixel."""

    slope_error: float
    normal_deg: float


@dataclass(frozen=True)
class Trial:
    """A candidate's scores on held-out presses, each with the press's fold left out."""

    candidate: Candidate
    scores: Mapping[int, HeldOutSlopeScore]

    @property
    def normal_deg(self) -> float:
        """Mean angle error over the presses."""
        return float(np.mean([score.normal_deg for score in self.scores.values()]))

    def mean_log(self, without: Sequence[int] = ()) -> float:
        """Mean logarithm of the slope error, without some presses."""
        errors = [score.slope_error for i, score in self.scores.items() if i not in without]
        return float(np.mean(np.log(errors))) if errors else float("inf")


@dataclass(frozen=True)
class Selection:
    """The selected candidate, the selection of each fold without its own presses, and all trials."""

    chosen: Candidate
    by_fold: tuple[Candidate, ...]
    trials: tuple[Trial, ...]


@dataclass(frozen=True, eq=False)
class HeldOutPresses:
    """The presses and their folds, from `make_folds`, with all that is fitted without a fold."""

    located: Located
    folds: Sequence[Fold]
    _prepared: dict[float, tuple[list[PreparedPress], float]] = field(
        default_factory=dict, init=False, repr=False
    )
    _fits: dict[tuple[Fold, Candidate], FittedSlopes] = field(default_factory=dict, init=False, repr=False)

    def prepared_for(self, candidate: Candidate) -> tuple[list[PreparedPress], float]:
        """The presses with the color changes that a candidate reads, and the largest change of gel at rest; kept."""
        offset = candidate.change_offset
        if offset not in self._prepared:
            own = prepared_with(self.located.presses, self.located.prepared, offset)
            self._prepared[offset] = own, untouched_change(*self.located.refined.of_accepted(own))
        return self._prepared[offset]

    def fit(self, fold: Fold, candidates: Sequence[Candidate]) -> list[FittedSlopes]:
        """Fit candidates that differ only in their settings on a fold's training presses; the fits are kept."""
        new = [one for one in dict.fromkeys(candidates) if (fold, one) not in self._fits]
        if new:
            presses, untouched = self.prepared_for(new[0])
            training = [presses[i] for i in fold.training]
            samples = training_samples(training, fold.contacts, total=TRIAL_SAMPLES)
            for plain in dict.fromkeys(one.plain for one in new):
                if (fold, plain) not in self._fits:
                    reader = SlopeReader(plain.fit(samples), presses[0], untouched)
                    self._fits[fold, plain] = FittedSlopes(reader, None)
            for plain in dict.fromkeys(one.plain for one in new):
                reader = self._fits[fold, plain].reader
                ridges = {
                    one.step_ridge: one for one in new if one.plain == plain and one.step_ridge is not None
                }
                if ridges:
                    responses = fitted_responses(
                        reader,
                        training,
                        fold.contacts,
                        list(ridges),
                        start=plain.start,
                        total=TRIAL_SAMPLES,
                    )
                    for one, forward in zip(ridges.values(), responses):
                        self._fits[fold, one] = FittedSlopes(reader, forward)
        return [self._fits[fold, one] for one in candidates]

    def try_candidates(
        self, candidates: Sequence[Candidate], folds: Sequence[Fold] | None = None
    ) -> list[Trial]:
        """Fit candidates that differ only in their settings without each fold, its own or others, and score them on it."""
        scores: list[dict[int, HeldOutSlopeScore]] = [{} for _ in candidates]
        prepared, found = self.prepared_for(candidates[0])[0], self.located.found
        for fold in self.folds if folds is None else folds:
            readers: dict[SlopeReader, list[int]] = {}
            fits = self.fit(fold, candidates)
            for k, fit in enumerate(fits):
                readers.setdefault(fit.reader, []).append(k)
            for reader, members in readers.items():  # candidates that differ only by steps are read once
                for i in fold.held_out:
                    frames = reader.frames(prepared[i], [fits[k].forward for k in members])
                    for k, frame in zip(members, frames):
                        scores[k][i] = score_of(prepared[i], found[i], frame)
        return [Trial(candidate, of) for candidate, of in zip(candidates, scores)]


def score_of(press: PreparedPress, found: ContactCircle, frame: Step) -> HeldOutSlopeScore:
    """Errors of the slopes that were read on a press, inside the contact edge."""
    rows, cols = press.pixels(found, 1.0, PRESS_PIXELS)
    score = score_slopes(
        frame.gradients[rows, cols], cols, rows, (found.x_px, found.y_px), press.ball_radius_px
    )
    error = float(np.sqrt(np.mean(np.sum(score.errors**2, axis=1))))
    return HeldOutSlopeScore(max(error, 1e-9), score.normal_deg)


def select(
    groups: Sequence[Sequence[Candidate]], held_out: HeldOutPresses, *, progress: Progress = no_progress
) -> Selection:
    """Select among candidates, in groups of one color model, then the step: by all presses, and without each fold's.

    If groups read held-out presses equally well, the first one is selected.
    """
    presses = sum(len(fold.held_out) for fold in held_out.folds)
    plain = [held_out.try_candidates(group) for group in groups]
    progress(1, 2, f"tried {groups[0][0].model}")
    stepped: dict[Candidate, list[Trial]] = {}
    for trials in plain:
        for leader in dict.fromkeys(_best(trials, without) for without in _left_out(held_out)):
            stepped[leader] = held_out.try_candidates(leader.with_steps(presses))
    progress(2, 2, "tried the forward response")

    def chosen(without: Sequence[int] = ()) -> Candidate:
        finalists = []
        for trials in plain:
            leader = _best(trials, without)
            without_step = [t for t in trials if t.candidate == leader and leader.may_not_step(presses)]
            finalists += [*without_step, *stepped[leader]]
        return _best(finalists, without)

    by_fold = tuple(chosen(fold.held_out) for fold in held_out.folds)
    everything = (*plain, *stepped.values())
    return Selection(chosen(), by_fold, tuple(trial for trials in everything for trial in trials))


def _left_out(held_out: HeldOutPresses) -> list[Sequence[int]]:
    """Each fold's presses in turn, then none."""
    return [*(fold.held_out for fold in held_out.folds), ()]


def _best(trials: Sequence[Trial], without: Sequence[int] = ()) -> Candidate:
    """The candidate with the smallest mean logarithm; the first one if there are too few presses."""
    return min(trials, key=lambda trial: trial.mean_log(without)).candidate
