"""A candidate on trial: fitted without some presses, scored on those, and what its scores say of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.samples import TOTAL_SAMPLES, PreparedPress
from gelform.calibration.selection.candidates import Candidate
from gelform.calibration.selection.folds import Fold
from gelform.calibration.selection.press_score import Lattice, PressScore, lattice_of, press_score
from gelform.color_models import ColorModel, Samples

SELECTION_SAMPLES = 5_000
SAMPLES_KEPT = 40  # of the folds, the sizes and the pairs of folds, of one zone

Scores = Mapping[int, PressScore]  # by the index of the press


@dataclass(frozen=True)
class Trial:
    """A candidate's scores on presses that its models had not seen.

    Attributes
    ----------
    candidate : Candidate
    by_fold : press -> score, the press's fold left out
    by_size : press -> score, all balls of its size left out; empty where no size can be
    by_pair : fold -> press of another fold -> score, both folds left out; empty until `with_pairs`
    """

    candidate: Candidate
    by_fold: Scores
    by_size: Scores
    by_pair: Mapping[int, Scores] = field(default_factory=dict)

    def mean_deg(self, by_size: bool = False) -> float:
        """Mean held-out normal error, degrees; NaN where no size was left out."""
        scores = self.by_size if by_size else self.by_fold
        return float(np.mean([s.normal_deg for s in scores.values()])) if scores else float("nan")

    def fold_losses(self, without: Sequence[int] = ()) -> NDArray[np.float64]:
        """Cap error of each press, px, its fold left out; without some presses."""
        return np.array([score.cap_px for i, score in sorted(self.by_fold.items()) if i not in without])

    def zone_losses(self, without: Sequence[int] = ()) -> NDArray[np.float64]:
        """Cap error of each press, px, the mean of both ways to leave it out; without some presses."""
        ways = self.by_fold, self.by_size
        asked = sorted(set(self.by_fold) - set(without))
        return np.array([np.mean([scores[i].cap_px for scores in ways if i in scores]) for i in asked])

    def losses_without(self, fold: int) -> NDArray[np.float64]:
        """Cap error, px, of the presses outside a fold, as if that fold did not exist."""
        return np.array([score.cap_px for _, score in sorted(self.by_pair[fold].items())])

    def size_ratio(self, without_fold: int | None = None) -> float:
        """Cap error on balls of a size that was left out over that with as few presses of all sizes; 1 if unknown."""
        pairs = [self.by_pair[without_fold]] if without_fold is not None else list(self.by_pair.values())
        fewer = _cap_px(pairs)
        asked = {i for scores in pairs for i in scores}
        by_size = [score.cap_px for i, score in self.by_size.items() if i in asked]
        return float(np.mean(by_size) / np.mean(fewer)) if by_size and fewer else 1.0


def _cap_px(parts: Iterable[Scores]) -> list[float]:
    return [score.cap_px for scores in parts for score in scores.values()]


@dataclass(frozen=True)
class HeldOutPresses:
    """The presses, and the ways to leave some of them out.

    Attributes
    ----------
    presses : prepared, by the `change_offset` that candidates want
    found : the circles found in single images, one per press
    folds, sizes : from `make_folds` and `size_folds`

    Where presses are scored and the pixels that folds train on are the same for many candidates: worked out once.
    """

    presses: Mapping[float, Sequence[PreparedPress]]
    found: Sequence[ContactCircle]
    folds: Sequence[Fold]
    sizes: Sequence[Fold]
    _lattices: dict[int, Lattice] = field(default_factory=dict, init=False, repr=False, compare=False)
    _samples: dict[Any, Samples] = field(default_factory=dict, init=False, repr=False, compare=False)

    def fit(self, candidate: Candidate, fold: Fold, *, total: int = TOTAL_SAMPLES) -> ColorModel:
        """A candidate, fitted on about `total` pixels of a fold's training presses."""
        suited = self.presses[candidate.change_offset]
        training = [suited[i] for i in fold.training]
        if candidate.reads_depth:
            return candidate.fit(training, fold.contacts, total=total)
        key = candidate.change_offset, candidate.zone, fold.training, fold.contacts, total
        if key not in self._samples:
            if len(self._samples) >= SAMPLES_KEPT:
                self._samples.clear()
            self._samples[key] = candidate.samples(training, fold.contacts, total=total)
        return candidate.fit_samples(self._samples[key])

    def try_candidates(self, candidates: Sequence[Candidate]) -> list[Trial]:
        """Fit candidates without each fold and without each size that can be left out; score what was left out."""
        scores = zip(*(self._scores(candidates, folds) for folds in (self.folds, self.sizes)))
        return [Trial(candidate, *of) for candidate, of in zip(candidates, scores)]

    def with_pairs(self, trials: Sequence[Trial]) -> list[Trial]:
        """The trials with their scores where two folds are left out."""
        candidates = [trial.candidate for trial in trials]
        by_pair: list[dict[int, Scores]] = [{} for _ in trials]
        for f, fold in enumerate(self.folds):
            others = [other for g, other in enumerate(self.folds) if g != f]
            pairs = [fold.without(other.held_out) for other in others]
            for k, scores in enumerate(self._scores(candidates, pairs)):
                by_pair[k][f] = scores
        return [replace(trial, by_pair=pairs) for trial, pairs in zip(trials, by_pair)]

    def _scores(self, candidates: Sequence[Candidate], folds: Sequence[Fold]) -> list[dict[int, PressScore]]:
        """Of each candidate; all are fitted on a fold's samples in turn, so that what they share is at hand."""
        scores: list[dict[int, PressScore]] = [{} for _ in candidates]
        for fold in folds:
            for k, candidate in enumerate(candidates if fold.training else ()):
                suited = self.presses[candidate.change_offset]
                model = self.fit(candidate, fold, total=SELECTION_SAMPLES)
                for i in fold.held_out:
                    scores[k][i] = press_score(suited[i], self.found[i], model, self._lattice(i))
        return scores

    def _lattice(self, press: int) -> Lattice:
        if press not in self._lattices:
            any_of = next(iter(self.presses.values()))
            self._lattices[press] = lattice_of(any_of[press], self.found[press])
        return self._lattices[press]
