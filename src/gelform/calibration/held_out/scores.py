"""Choose how stiff the color model and the forward response are, by their slopes on presses that they have not seen.

What counts is the mean logarithm of each press's slope error inside the contact's edge: one press with a wrong circle moves
a mean of errors as it likes, and a mean of logarithms by a few per cent.

Choosing on the scores that are then reported flatters them. So each fold's presses are reported by what the scores of the
other folds' presses choose.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from gelform.calibration.candidates import (
    Candidate,
    FittedSlopes,
    SlopeReader,
    fitted_responses,
    training_samples,
)
from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.samples import PreparedPress
from gelform.calibration.held_out.folds import Fold
from gelform.color_models.forward_response import RIDGES, Step
from gelform.foundations.progress import Progress, no_progress
from gelform.metrics import score_slopes

SAMPLES_OF_FOLD = 12_000  # pixels of all presses that train
SCORED_PIXELS = 1_500  # of a press


@dataclass(frozen=True)
class SlopeScore:
    """RMS error of the slopes read on one press, mm/mm, and mean angle; its centre is free, labels are off by a pixel."""

    slope_error: float
    normal_deg: float


@dataclass(frozen=True)
class Trial:
    """A candidate's scores on presses that it had not seen, each with the press's fold left out."""

    candidate: Candidate
    scores: Mapping[int, SlopeScore]

    def mean_log(self, without: Sequence[int] = ()) -> float:
        """Mean logarithm of the slope error, without some presses."""
        errors = [score.slope_error for i, score in self.scores.items() if i not in without]
        return float(np.mean(np.log(errors))) if errors else float("inf")


@dataclass(frozen=True)
class Selection:
    """What was chosen, what each fold would have chosen without its own presses, and what was tried."""

    chosen: Candidate
    by_fold: tuple[Candidate, ...]
    trials: tuple[Trial, ...]


@dataclass(frozen=True, eq=False)
class HeldOutPresses:
    """The presses, and the ways to leave some of them out.

    Attributes
    ----------
    presses : prepared, by the `change_offset` that candidates want
    found : the circles found in single images, one per press
    folds : from `make_folds`
    untouched : color changes up to it are those of untouched gel, by the offset too
    """

    presses: Mapping[float, Sequence[PreparedPress]]
    found: Sequence[ContactCircle]
    folds: Sequence[Fold]
    untouched: Mapping[float, float]
    _fits: dict[tuple[Fold, Candidate], FittedSlopes] = field(default_factory=dict, init=False, repr=False)

    def fit(self, fold: Fold, candidates: Sequence[Candidate]) -> list[FittedSlopes]:
        """Candidates that differ in their settings alone, fitted on a fold's training presses; remembered."""
        new = [one for one in dict.fromkeys(candidates) if (fold, one) not in self._fits]
        if new:
            offset = new[0].change_offset
            training = [self.presses[offset][i] for i in fold.training]
            samples = training_samples(training, fold.contacts, total=SAMPLES_OF_FOLD)
            for plain in dict.fromkeys(one.plain for one in new):
                if (fold, plain) not in self._fits:
                    reader = SlopeReader(plain.fit(samples), self.presses[offset][0], self.untouched[offset])
                    self._fits[fold, plain] = FittedSlopes(reader, None)
            for plain in dict.fromkeys(one.plain for one in new):
                reader = self._fits[fold, plain].reader
                ridges = {
                    one.step_ridge: one for one in new if one.plain == plain and one.step_ridge is not None
                }
                if ridges:
                    responses = fitted_responses(
                        reader, training, fold.contacts, list(ridges), total=SAMPLES_OF_FOLD
                    )
                    for one, forward in zip(ridges.values(), responses):
                        self._fits[fold, one] = FittedSlopes(reader, forward)
        return [self._fits[fold, one] for one in candidates]

    def fitted(self, candidate: Candidate) -> list[FittedSlopes]:
        """A candidate fitted without each fold."""
        return [self.fit(fold, [candidate])[0] for fold in self.folds]

    def try_candidates(self, candidates: Sequence[Candidate]) -> list[Trial]:
        """Fit candidates that differ in their settings alone without each fold; score what was left out."""
        scores: list[dict[int, SlopeScore]] = [{} for _ in candidates]
        prepared = self.presses[candidates[0].change_offset]
        for fold in self.folds:
            readers: dict[SlopeReader, list[int]] = {}
            fits = self.fit(fold, candidates)
            for k, fit in enumerate(fits):
                readers.setdefault(fit.reader, []).append(k)
            for reader, members in readers.items():  # one that differs by its steps alone is read once
                for i in fold.held_out:
                    frames = reader.frames(prepared[i], [fits[k].forward for k in members])
                    for k, frame in zip(members, frames):
                        scores[k][i] = score_of(prepared[i], self.found[i], frame)
        return [Trial(candidate, of) for candidate, of in zip(candidates, scores)]


def score_of(press: PreparedPress, found: ContactCircle, frame: Step) -> SlopeScore:
    """Errors of the slopes that were read on a press, inside the contact's edge."""
    rows, cols = press.pixels(found, 1.0, SCORED_PIXELS)
    score = score_slopes(
        frame.gradients[rows, cols], cols, rows, (found.x_px, found.y_px), press.ball_radius_px
    )
    error = float(np.sqrt(np.mean(np.sum(score.errors**2, axis=1))))
    return SlopeScore(max(error, 1e-9), score.normal_deg)


def select(
    groups: Sequence[Sequence[Candidate]], held_out: HeldOutPresses, *, progress: Progress = no_progress
) -> Selection:
    """Choose among candidates, in groups of one color model, and then the step: by all presses, and without each fold's.

    Of groups that read held-out presses alike the first one's is chosen.
    """
    plain = [held_out.try_candidates(group) for group in groups]
    progress(1, 2, f"tried {groups[0][0].model}")
    stepped: dict[Candidate, list[Trial]] = {}
    for trials in plain:
        for leader in dict.fromkeys(_best(trials, without) for without in _left_out(held_out)):
            steps = [replace(leader, step_ridge=ridge) for ridge in RIDGES]
            stepped[leader] = held_out.try_candidates(steps)
    progress(2, 2, "tried the forward response")

    def chosen(without: Sequence[int] = ()) -> Candidate:
        finalists = []
        for trials in plain:
            leader = _best(trials, without)
            finalists += [next(t for t in trials if t.candidate == leader), *stepped[leader]]
        return _best(finalists, without)

    by_fold = tuple(chosen(fold.held_out) for fold in held_out.folds)
    everything = (*plain, *stepped.values())
    return Selection(chosen(), by_fold, tuple(trial for trials in everything for trial in trials))


def _left_out(held_out: HeldOutPresses) -> list[Sequence[int]]:
    """Each fold's presses in turn, then none."""
    return [*(fold.held_out for fold in held_out.folds), ()]


def _best(trials: Sequence[Trial], without: Sequence[int] = ()) -> Candidate:
    """The candidate of the least mean logarithm; the first one where too few presses say."""
    return min(trials, key=lambda trial: trial.mean_log(without)).candidate
