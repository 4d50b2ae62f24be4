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

from gelform.calibration.candidates import Candidate, SlopeReader, fitted_responses, training_samples
from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.samples import PreparedPress
from gelform.calibration.held_out.folds import Fold
from gelform.color_models import ColorModel, ForwardResponse
from gelform.color_models.forward_response import RIDGES
from gelform.metrics import score_slopes
from gelform.progress import Progress, no_progress

SAMPLES_OF_FOLD = 12_000
SCORED_PIXELS = 1_500  # of a press


@dataclass(frozen=True)
class SlopeScore:
    """Errors of the slopes that are read on one press, its centre free: labels are off by a pixel.

    Attributes
    ----------
    slope_error : root mean square of |slope error|, mm/mm
    normal_deg : mean angle to the ball's normals, degrees
    """

    slope_error: float
    normal_deg: float


@dataclass(frozen=True)
class Trial:
    """A candidate's scores on presses that it had not seen.

    Attributes
    ----------
    candidate : Candidate
    scores : press -> score, the press's fold left out
    """

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
    untouched : color changes up to it say untouched gel, by the offset too
    """

    presses: Mapping[float, Sequence[PreparedPress]]
    found: Sequence[ContactCircle]
    folds: Sequence[Fold]
    untouched: Mapping[float, float]
    _fits: dict[tuple[Fold, Candidate], tuple[ColorModel, ForwardResponse | None]] = field(
        default_factory=dict, init=False, repr=False
    )

    def fit(
        self, fold: Fold, candidates: Sequence[Candidate]
    ) -> list[tuple[ColorModel, ForwardResponse | None]]:
        """Candidates that differ in their settings alone, fitted on a fold's training presses; remembered."""
        new = [one for one in dict.fromkeys(candidates) if (fold, one) not in self._fits]
        if new:
            training = [self.presses[new[0].change_offset][i] for i in fold.training]
            untouched = self.untouched[new[0].change_offset]
            samples = training_samples(training, fold.contacts, total=SAMPLES_OF_FOLD)
            models: dict[Candidate, ColorModel] = {}
            for one in new:
                plain = replace(one, step_ridge=None)
                if plain not in models:
                    models[plain] = (
                        self._fits[fold, plain][0] if (fold, plain) in self._fits else one.fit(samples)
                    )
            for plain, model in models.items():
                stepped = [
                    one
                    for one in new
                    if one.step_ridge is not None and replace(one, step_ridge=None) == plain
                ]
                ridges = [one.step_ridge for one in stepped if one.step_ridge is not None]
                made = (
                    fitted_responses(model, training, fold.contacts, ridges, untouched, total=SAMPLES_OF_FOLD)
                    if ridges
                    else []
                )
                self._fits[fold, plain] = model, None
                for one, forward in zip(stepped, made):
                    self._fits[fold, one] = model, forward
        return [self._fits[fold, one] for one in candidates]

    def reader(self, fold: Fold, candidate: Candidate) -> SlopeReader:
        """What reads presses by a candidate that was fitted without the fold."""
        (fit,) = self.fit(fold, [candidate])
        offset = candidate.change_offset
        return SlopeReader(*fit, self.presses[offset][0], self.untouched[offset])

    def try_candidates(self, candidates: Sequence[Candidate]) -> list[Trial]:
        """Fit candidates without each fold; score what was left out."""
        scores: list[dict[int, SlopeScore]] = [{} for _ in candidates]
        for fold in self.folds:
            self.fit(fold, candidates)
            for candidate, of_presses in zip(candidates, scores):
                reader, prepared = self.reader(fold, candidate), self.presses[candidate.change_offset]
                for i in fold.held_out:
                    of_presses[i] = score_of(prepared[i], self.found[i], reader)
        return [Trial(candidate, of) for candidate, of in zip(candidates, scores)]


def score_of(press: PreparedPress, found: ContactCircle, reader: SlopeReader) -> SlopeScore:
    """Errors inside the contact's edge."""
    rows, cols = press.pixels(found, 1.0, SCORED_PIXELS)
    slopes = reader.frame(press).gradients[rows, cols]
    score = score_slopes(slopes, cols, rows, (found.x_px, found.y_px), press.ball_radius_px)
    error = float(np.sqrt(np.mean(np.sum(score.errors**2, axis=1))))
    return SlopeScore(max(error, 1e-9), score.normal_deg)


def select(
    candidates: Sequence[Candidate], held_out: HeldOutPresses, *, progress: Progress = no_progress
) -> Selection:
    """Choose among candidates of one color model, and then its step: by all presses, and without each fold's.

    Parameters
    ----------
    candidates : of one color model, without a step
    held_out : the presses and their folds
    progress : called with (done, total, what)
    """
    plain = held_out.try_candidates(candidates)
    progress(1, 2, f"tried {candidates[0].model}")
    leaders = dict.fromkeys(_best(plain, fold.held_out) for fold in held_out.folds)
    leaders[_best(plain)] = None
    stepped = {
        leader: held_out.try_candidates([replace(leader, step_ridge=ridge) for ridge in RIDGES])
        for leader in leaders
    }
    progress(2, 2, "tried the forward response")

    def chosen(without: Sequence[int] = ()) -> Candidate:
        leader = _best(plain, without)
        return _best([next(t for t in plain if t.candidate == leader), *stepped[leader]], without)

    by_fold = tuple(chosen(fold.held_out) for fold in held_out.folds)
    trials = (*plain, *(trial for trials in stepped.values() for trial in trials))
    return Selection(chosen(), by_fold, trials)


def _best(trials: Sequence[Trial], without: Sequence[int] = ()) -> Candidate:
    """The candidate of the least mean logarithm; the first one where too few presses say."""
    return min(trials, key=lambda trial: trial.mean_log(without)).candidate
