"""Choose the color model and the zone that trains, by the depth error on presses that the model has not seen.

The training zone is chosen first, by errors on presses and, where there are two sizes of ball, on a whole size that
was left out: slopes near the rim are not the ball's, and which ball it was shows most there.

The model is chosen by the errors to expect of it with all presses. Those of folds (4/5 of the presses) still favour
models with few terms, so they are extrapolated from errors with 4/5 and with 3/5 of the presses, as a power of
their number. A model that fails on the other size of ball is out; the simplest within one standard error of the best
is chosen.

Choosing on the scores that are then reported flatters them. So the choice is made once more for each fold, without
its presses (by models that left out two folds, not extrapolated: a little pessimistic), and the fold's presses are
scored by what was chosen then.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.circles.find import Contact, scale_of
from gelform.calibration.circles.samples import PreparedPress
from gelform.calibration.selection.candidates import DEFAULT_ZONE, ZONES, Candidate, zone_judge
from gelform.calibration.selection.folds import Fold
from gelform.color_models import ColorModel
from gelform.depth import depth_from_gradients
from gelform.metrics import score_slopes
from gelform.progress import Progress, no_progress

INSET_PX = 3.0  # of the contact's rim, at 240 rows: as `metrics.press_errors` has it
SCORED_PIXELS = 500
PATCH = 24  # samples across the contact that are integrated to score the depth
SELECTION_SAMPLES = 5_000
SIZE_FACTOR = 1.5  # worse by size than the others, each measured by itself: it has learnt the ball
MIN_FOLDS = 4
SLOW = ("lookup", "interpolation")  # 54 bare DCT pairs a frame, and seconds: listed in the report, not chosen

Presses = Mapping[float, Sequence[PreparedPress]]  # by the offset of their color changes


@dataclass(frozen=True)
class PressScore:
    """How far off a press is: normals in degrees, and the cap's shape in px, both with a free centre."""

    normal_deg: float
    cap_px: float


@dataclass(frozen=True)
class Trial:
    """A candidate's scores on presses that its models had not seen.

    Attributes
    ----------
    candidate : Candidate
    by_fold : press -> score, the press's fold left out
    by_size : press -> score, all balls of its size left out; empty where no size can be
    by_pair : fold -> press of another fold -> score, both folds left out
    """

    candidate: Candidate
    by_fold: Mapping[int, PressScore]
    by_size: Mapping[int, PressScore]
    by_pair: Mapping[int, Mapping[int, PressScore]]

    def mean_deg(self, by_size: bool = False) -> float:
        """Mean held-out normal error, degrees; NaN where no size was left out."""
        scores = self.by_size if by_size else self.by_fold
        return float(np.mean([s.normal_deg for s in scores.values()])) if scores else float("nan")

    def zone_losses(self, without: Sequence[int] = ()) -> NDArray[np.float64]:
        """Cap error of each press, px, the mean of both ways to leave it out; some presses not asked."""
        ways = self.by_fold, self.by_size
        asked = sorted(set(self.by_fold) - set(without))
        return np.array([np.mean([scores[i].cap_px for scores in ways if i in scores]) for i in asked])

    def expected_losses(self) -> NDArray[np.float64]:
        """Cap error of each press, px, that a model of all presses can be expected to have.

        Errors fall as a power of the number of presses; which power, the models of fewer presses tell.
        """
        seen = np.array([self.by_fold[i].cap_px for i in sorted(self.by_fold)])
        folds = len(self.by_pair)
        if folds < MIN_FOLDS:
            return seen
        fewer = [score.cap_px for scores in self.by_pair.values() for score in scores.values()]
        learnt = min(float(seen.mean() / np.mean(fewer)), 1.0)
        power = np.log(folds / (folds - 1)) / np.log((folds - 1) / (folds - 2))
        return seen * learnt**power

    def losses_without(self, fold: int) -> NDArray[np.float64]:
        """Cap error, px, of the presses outside a fold, as if that fold did not exist."""
        return np.array([score.cap_px for _, score in sorted(self.by_pair[fold].items())])

    def size_ratio(self, without_fold: int | None = None) -> float:
        """Cap error on balls of a size that was left out over that with as few presses of all sizes; 1 if unknown."""
        pairs = [self.by_pair[without_fold]] if without_fold is not None else list(self.by_pair.values())
        fewer = [score.cap_px for scores in pairs for score in scores.values()]
        asked = {i for scores in pairs for i in scores}
        by_size = [score.cap_px for i, score in self.by_size.items() if i in asked]
        return float(np.mean(by_size) / np.mean(fewer)) if by_size and fewer else 1.0


@dataclass(frozen=True)
class Selection:
    """What was chosen, what each fold would have chosen without its own presses, and what was tried."""

    chosen: Candidate
    by_fold: tuple[Candidate, ...]
    trials: tuple[Trial, ...]


def select(
    candidates: Sequence[Candidate],
    presses: Presses,
    found: Sequence[Contact],
    folds: Sequence[Fold],
    sizes: Sequence[Fold],
    *,
    zones: Sequence[float] = ZONES,
    progress: Progress = no_progress,
) -> Selection:
    """The training zone, judged by a polynomial, then the candidate.

    Parameters
    ----------
    candidates : simplest first
    presses : prepared, by the `change_offset` that the candidates want
    found : the circles found in single images
    folds, sizes : from `make_folds` and `size_folds`
    zones : what to choose the zone among; a single one is taken as it is
    """
    known: dict[Candidate, Trial] = {}
    expected = len(zones) + len(candidates)

    def tried(candidate: Candidate, pairs: bool) -> Trial:
        if candidate not in known:
            known[candidate] = try_candidate(candidate, presses, found, folds, sizes)
            progress(len(known), max(expected, len(known)), f"trying {candidate.describe()}")
        if pairs and not known[candidate].by_pair:
            known[candidate] = with_pairs(known[candidate], presses, found, folds)
        return known[candidate]

    judge = zone_judge(min(len(fold.training) for fold in folds))
    zoned = [tried(replace(judge, zone=zone), pairs=False) for zone in zones] if len(zones) > 1 else []

    def ladder(without: Sequence[int] = ()) -> list[Trial]:
        zone = zone_within_one_error(zoned, without) if zoned else zones[0]
        once = [tried(replace(c, zone=zone), pairs=False) for c in candidates]
        return [tried(trial.candidate, pairs=True) for trial in not_out_of_reach(once, without)]

    steps = ladder()
    chosen = simplest_within_one_error(steps, [t.expected_losses() for t in steps])
    by_fold = []
    for f, fold in enumerate(folds):
        steps_without = ladder(fold.held_out)
        losses = [t.losses_without(f) for t in steps_without]
        by_fold.append(simplest_within_one_error(steps_without, losses, f) if losses[0].size else chosen)
    return Selection(chosen, tuple(by_fold), tuple(known.values()))


def not_out_of_reach(ladder: Sequence[Trial], without: Sequence[int] = ()) -> list[Trial]:
    """The trials within two standard errors of the best on folds: what pairs of folds are then fitted for.

    Models too slow for frames run only where nothing else was asked for.
    """
    ladder = [t for t in ladder if t.candidate.model not in SLOW] or ladder
    losses = [
        np.array([score.cap_px for i, score in sorted(t.by_fold.items()) if i not in without]) for t in ladder
    ]
    best = min(losses, key=lambda loss: float(loss.mean()))
    return [t for t, loss in zip(ladder, losses) if (loss - best).mean() <= 2 * standard_error(loss - best)]


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
    ladder: Sequence[Trial], losses: Sequence[NDArray[np.float64]], without_fold: int | None = None
) -> Candidate:
    """The first trial whose mean loss is within one standard error of the best's, press by press.

    Those that fail on a size of ball that was left out do not run.
    """
    ratios = [trial.size_ratio(without_fold) for trial in ladder]
    runs = [k for k, ratio in enumerate(ratios) if ratio <= SIZE_FACTOR * min(ratios)]
    best = losses[min(runs, key=lambda k: losses[k].mean())]
    within = [k for k in runs if (losses[k] - best).mean() <= standard_error(losses[k] - best)]
    return ladder[within[0]].candidate


def standard_error(values: Sequence[float] | NDArray[np.float64]) -> float:
    """Standard error of the mean of values; 0 of a single one."""
    return float(np.std(values, ddof=1) / np.sqrt(len(values))) if len(values) > 1 else 0.0


def try_candidate(
    candidate: Candidate,
    presses: Presses,
    found: Sequence[Contact],
    folds: Sequence[Fold],
    sizes: Sequence[Fold],
) -> Trial:
    """Fit a candidate on every fold and every size that can be left out; score what was left out."""
    suited = presses[candidate.change_offset]
    return Trial(
        candidate, _scores(candidate, suited, found, folds), _scores(candidate, suited, found, sizes), {}
    )


def with_pairs(trial: Trial, presses: Presses, found: Sequence[Contact], folds: Sequence[Fold]) -> Trial:
    """The trial with its scores where two folds are left out."""
    suited = presses[trial.candidate.change_offset]
    by_pair = {
        f: _scores(
            trial.candidate,
            suited,
            found,
            [fold.without(other.held_out) for g, other in enumerate(folds) if g != f],
        )
        for f, fold in enumerate(folds)
    }
    return replace(trial, by_pair=by_pair)


def _scores(
    candidate: Candidate, presses: Sequence[PreparedPress], found: Sequence[Contact], folds: Sequence[Fold]
) -> dict[int, PressScore]:
    left_out: dict[int, PressScore] = {}
    for fold in folds:
        if fold.training:
            model = candidate.fit([presses[i] for i in fold.training], fold.contacts, total=SELECTION_SAMPLES)
            left_out.update({i: press_score(presses[i], found[i], model) for i in fold.held_out})
    return left_out


def press_score(press: PreparedPress, found: Contact, model: ColorModel) -> PressScore:
    """Errors of a model inside a contact, 3 px off its rim; the centre is free, since labels are off by a pixel."""
    zone = max(0.5, 1 - INSET_PX * scale_of(press.size.shape) / found.radius_px)
    rows, cols = press.pixels(found, zone, SCORED_PIXELS)
    gradients = press.gradients(model, rows, cols)
    score = score_slopes(gradients, cols, rows, (found.x_px, found.y_px), press.ball_radius_px)
    return PressScore(score.normal_deg, _cap_error_px(press, found, model, score.center_px, rows, cols, zone))


def _cap_error_px(
    press: PreparedPress,
    found: Contact,
    model: ColorModel,
    center: tuple[float, float],
    rows: NDArray[np.intp],
    cols: NDArray[np.intp],
    zone: float,
) -> float:
    """Standard deviation of the depth, integrated over the contact's bounding box, minus the ball's cap."""
    step = max(1, round(2 * zone * found.radius_px / PATCH))
    y, x = np.mgrid[rows.min() : rows.max() + 1 : step, cols.min() : cols.max() + 1 : step]
    gradients = press.gradients(model, y.ravel(), x.ravel()).reshape(*y.shape, 2)
    depth = depth_from_gradients(gradients.astype(np.float32), mm_per_px=float(step), solver="dct")
    square = (x - center[0]) ** 2 + (y - center[1]) ** 2
    inside = (x - found.x_px) ** 2 + (y - found.y_px) ** 2 < (zone * found.radius_px) ** 2
    cap = np.sqrt(np.maximum(press.ball_radius_px**2 - square, 0))
    return float(np.std((depth - cap)[inside]))
