"""Choose the training zone and the color model, by the depth error on presses that the model has not seen.

The training zone is chosen first, by errors on presses and, where there are two sizes of ball, on a whole size that
was left out: slopes near the rim are not the ball's, and which ball it was shows most there.

The color model is chosen by its errors on presses of folds that were left out. A model that fails on the other size of
ball is out; the simplest within one standard error of the best is chosen, of few presses the best itself. The errors are not
extrapolated from 4/5 and 3/5 to all of the presses: on a GelSight Mini that foretold 0.275 px of a polynomial that then had
0.291 on presses it had not seen, the worst of three, and chose what no fold chose.

Choosing on the scores that are then reported flatters them. So the choice is made once more for each fold, without
its presses (by models that left out two folds: a little pessimistic), and the fold's presses are
scored by what was chosen then.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.selection.candidates import DEFAULT_ZONE, ZONES, Candidate, zone_judge
from gelform.calibration.selection.trials import HeldOutPresses, Trial
from gelform.progress import Progress, no_progress

# Presses, of fewer than which the best is chosen: their standard error covers models that are much worse on presses that
# none has seen. Of 28 draws of 10 and 15 presses on simulated sensors it changes 8: four are worse, by at most 0.3 degrees,
# four better, by up to 1.5.
FEW = 18
SIZE_FACTOR = 1.5  # a size ratio this many times the least one: the model has learnt the ball, not the light


@dataclass(frozen=True)
class Selection:
    """What was chosen, what each fold would have chosen without its own presses, and what was tried."""

    chosen: Candidate
    by_fold: tuple[Candidate, ...]
    trials: tuple[Trial, ...]

    def exchanged(self, trial: Trial, exchange: Callable[[Candidate], Candidate]) -> Selection:
        """The candidate of a further trial in place of the chosen one, and in folds that chose the same color model."""
        by_fold = tuple(exchange(one) if one.model == self.chosen.model else one for one in self.by_fold)
        return Selection(trial.candidate, by_fold, (*self.trials, trial))


def select(
    candidates: Sequence[Candidate],
    held_out: HeldOutPresses,
    *,
    zones: Sequence[float] = ZONES,
    progress: Progress = no_progress,
) -> Selection:
    """Choose a zone, judged by a polynomial, and then a candidate: by all presses, and without each fold's.

    Parameters
    ----------
    candidates : simplest first
    held_out : the presses and their folds
    zones : what to choose the zone among; a single one is taken as it is
    progress : called with (done, total, what)
    """
    trials = _Trials(held_out, len(zones) + len(candidates), progress)
    judge = zone_judge(min(len(fold.training) for fold in held_out.folds))
    zoned = trials.of([replace(judge, zone=zone) for zone in zones]) if len(zones) > 1 else []

    def contenders(without: Sequence[int] = ()) -> list[Trial]:
        """The candidates at the zone that the other presses choose, but for those far behind, with their pairs."""
        zone = zone_within_one_error(zoned, without) if zoned else zones[0]
        tried = trials.of([replace(candidate, zone=zone) for candidate in candidates])
        return trials.with_pairs_of([trial.candidate for trial in not_out_of_reach(tried, without)])

    running = contenders()
    losses = [trial.fold_losses() for trial in running]
    few = losses[0].size < FEW
    chosen = simplest_within_one_error(running, losses, few=few)
    by_fold = []
    for f, fold in enumerate(held_out.folds):
        running = contenders(without=fold.held_out)
        losses = [trial.losses_without(f) for trial in running]
        by_fold.append(simplest_within_one_error(running, losses, f, few=few) if losses[0].size else chosen)
    return Selection(chosen, tuple(by_fold), trials.made)


class _Trials:
    """Each candidate tried once, however often it is asked for."""

    def __init__(self, held_out: HeldOutPresses, expected: int, progress: Progress) -> None:
        self._held_out, self._expected, self._progress = held_out, expected, progress
        self._made: dict[Candidate, Trial] = {}

    @property
    def made(self) -> tuple[Trial, ...]:
        """Every trial so far."""
        return tuple(self._made.values())

    def of(self, candidates: Sequence[Candidate]) -> list[Trial]:
        """The candidates' trials on folds and sizes."""
        for alike in _alike(
            [candidate for candidate in dict.fromkeys(candidates) if candidate not in self._made]
        ):
            for trial in self._held_out.try_candidates(alike):
                self._made[trial.candidate] = trial
                total = max(self._expected, len(self._made))
                self._progress(len(self._made), total, f"tried {trial.candidate.describe()}")
        return [self._made[candidate] for candidate in candidates]

    def with_pairs_of(self, candidates: Sequence[Candidate]) -> list[Trial]:
        """The candidates' trials with pairs of folds left out, too."""
        for alike in _alike([trial.candidate for trial in self.of(candidates) if not trial.by_pair]):
            trials = self._held_out.with_pairs([self._made[candidate] for candidate in alike])
            self._made |= {trial.candidate: trial for trial in trials}
        return [self._made[candidate] for candidate in candidates]


def _alike(candidates: Sequence[Candidate]) -> list[list[Candidate]]:
    """Neighbours of one model and zone: what they are fitted on is the same, and part of their fits."""
    groups = groupby(candidates, key=lambda one: (one.model, one.zone))
    return [list(group) for _, group in groups]


def not_out_of_reach(trials: Sequence[Trial], without: Sequence[int] = ()) -> list[Trial]:
    """The trials within two standard errors of the best on folds: what pairs of folds are then fitted for."""
    losses = [trial.fold_losses(without) for trial in trials]
    best = min(losses, key=lambda loss: float(loss.mean()))
    return [t for t, loss in zip(trials, losses) if (loss - best).mean() <= 2 * standard_error(loss - best)]


def zone_within_one_error(zoned: Sequence[Trial], without: Sequence[int] = ()) -> float:
    """The zone nearest the usual one whose mean loss is within one standard error of the best's, press by press."""
    losses = [trial.zone_losses(without) for trial in zoned]
    best = min(losses, key=lambda loss: float(loss.mean()))
    within = [
        trial.candidate.zone
        for trial, loss in zip(zoned, losses)
        if (loss - best).mean() <= standard_error(loss - best)
    ]
    return min(within, key=lambda zone: abs(zone - DEFAULT_ZONE))


def simplest_within_one_error(
    trials: Sequence[Trial],
    losses: Sequence[NDArray[np.float64]],
    without_fold: int | None = None,
    *,
    few: bool = False,
) -> Candidate:
    """The first candidate whose mean loss is within one standard error of the best's, press by press; of few, the best.

    Those that fail on a size of ball that was left out do not count.

    Parameters
    ----------
    trials : simplest first
    losses : of each trial, one per press
    without_fold : a fold whose presses must not decide, or None
    few : whether there are so few presses that the best is chosen
    """
    ratios = [trial.size_ratio(without_fold) for trial in trials]
    fair = [k for k, ratio in enumerate(ratios) if ratio <= SIZE_FACTOR * min(ratios)]
    lowest = min(fair, key=lambda k: losses[k].mean())
    if few:
        return trials[lowest].candidate
    best = losses[lowest]
    within = [k for k in fair if (losses[k] - best).mean() <= standard_error(losses[k] - best)]
    return trials[within[0]].candidate


def standard_error(values: Sequence[float] | NDArray[np.float64]) -> float:
    """Standard error of the mean of values; 0 of a single one."""
    return float(np.std(values, ddof=1) / np.sqrt(len(values))) if len(values) > 1 else 0.0


def worse_on_balls(trial: Trial, selection: Selection) -> bool:
    """Whether a trial's depth of balls is more than a standard error worse than that of what was chosen."""
    before = next(one for one in selection.trials if one.candidate == selection.chosen)
    more = trial.fold_losses() - before.fold_losses()
    return bool(more.mean() > standard_error(more))
