"""Candidates of a calibration, the selection among them on held-out presses, and the fit of the selected one on all.

A candidate is a color model with its settings, its start, and the forward response of its step. The model's own class has
the settings to try (`variants`). "auto" is `DEFAULT_MODEL`: on four real sensors its errors with 8 and 11 presses are less
than those of a polynomial in 14 of 16 draws, with 5 in 4 of 8.

For each fold of held-out presses the circles of the other presses are refined from scratch. So neither a pixel of a scored
press nor a circle that it helped to place is ever in the model that scores it.

The score is the mean logarithm of each press's slope error inside the contact edge, which one wrong circle moves little.
Reporting the scores of the selection would flatter them. So each fold's presses are reported with the candidate that the
other folds' presses select.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
import scipy  # its parts load at first use

from gelform import __version__
from gelform.arrays import Array, Map, Mask, Numbers, Slopes
from gelform.calibration.circles.find import (
    PRESS_PIXELS,
    TOTAL_SAMPLES,
    TRIAL_SAMPLES,
    ZONE,
    ContactCircle,
    PreparedPress,
    change_settings,
    prepared_with,
    training_samples,
    untouched_change,
)
from gelform.calibration.circles.locate import Located, refine
from gelform.calibration.coverage import FOLDS, NEEDED, SAMPLED
from gelform.calibration.presses.press_set import Presses
from gelform.calibration.start import AUTO, Start
from gelform.calibration_file import Calibration, CalibrationSettings
from gelform.depth.coarse import CoarseDepth
from gelform.errors import CalibrationError, GelformError, Progress, no_progress
from gelform.image.background import noise_from_image
from gelform.result.metrics import score_slopes
from gelform.slopes.color_models import (
    COLOR_MODELS,
    DEFAULT_MODEL,
    ColorModel,
    ForwardResponse,
    Samples,
    StartableModel,
)
from gelform.slopes.color_models.forward_response import RIDGES, PreparedStep, Step
from gelform.slopes.sigma import SlopeSigma, ends_shown

STEP_SIGMAS = 1.25  # times the color model's residual on its training slopes; 1.0-1.5 give the same errors on nine sensors
LEAST_STEP_SIGMA = 1e-4  # mm/mm, for images without noise
# Weights of slopes before held-out presses are measured; roughly those of any sensor.
FIRST_GUESS = SlopeSigma(rest=0.02, per_step=0.04, full_confidence_sigma=0.04, correlation_px=10.0)


@dataclass(frozen=True)
class Candidate:
    """A color model with its settings, its start, and the forward response of its step."""

    model: str  # a name in `COLOR_MODELS`
    settings: tuple[tuple[str, Any], ...] = ()  # keywords of the model's `fit`, as pairs
    start: Start | None = None  # another unit's model, or None
    step_ridge: float | None = None  # ridge of the forward response; None: no step
    # For an average: (share, candidate) of each fit with a step; the settings then only describe it.
    parts: tuple[tuple[float, Candidate], ...] = ()

    @property
    def plain(self) -> Candidate:
        """The same candidate without a step."""
        return replace(self, step_ridge=None)

    @property
    def change_offset(self) -> float:
        """Gray levels added to the background in the divisor of its color changes."""
        return float(COLOR_MODELS[self.model].change_offset)

    def with_steps(self, presses: int) -> list[Candidate]:
        """The same candidate with each step to try for a number of presses, the stiffest first."""
        ridges = RIDGES if self.start is None else start_ridges(presses)
        return [replace(self, step_ridge=ridge) for ridge in ridges]

    def fit(self, samples: Samples) -> ColorModel:
        """The color model, fitted on samples."""
        start = {} if self.start is None else {"start": self.start.model}
        return COLOR_MODELS[self.model].fit(samples, **dict(self.settings), **start)

    def describe(self) -> str:
        """Name and settings, short."""
        settings = ["-".join(map(str, v)) if isinstance(v, tuple) else f"{k} {v:g}" for k, v in self.settings]
        step = [] if self.step_ridge is None else [f"step {self.step_ridge:g}"]
        begun = [] if self.start is None else [f"from {self.start.by}"]
        return " ".join([self.model, *settings, *step, *begun])


def color_model_names() -> list[str]:
    """The names that `calibrate` takes as its color model."""
    return [AUTO, *COLOR_MODELS]


def candidates_for(color_model: str, presses: int) -> list[Candidate]:
    """The candidates for a number of accepted presses, simplest first: all variants of a color model, or those of "auto".

    ValueError: the name is unknown.
    """
    if color_model not in color_model_names():
        raise ValueError(f"Expected color_model among {', '.join(color_model_names())}, got {color_model!r}.")
    name = DEFAULT_MODEL if color_model == AUTO else color_model
    return [Candidate(name, tuple(variant.items())) for variant in COLOR_MODELS[name].variants(presses)]


def candidates_from(start: Start, presses: int) -> list[Candidate]:
    """The candidates for a second unit, stiffest first: the first unit's model, changed more and more freely."""
    return [Candidate(start.model.name, (("ridge", ridge),), start) for ridge in start_ridges(presses)]


def start_ridges(presses: int) -> list[float]:
    """Ridges of a fit that is pulled toward another unit's, for a number of presses, the stiffest first.

    The other unit counts as much as a part of a press: that of each ridge, times the presses. Folds of few presses cannot
    choose one.
    """
    stiffest, *softer = (0.6 / (10**k * presses) for k in range(3))
    return [stiffest, *softer] if NEEDED.edge.met(presses) else [stiffest]


class SlopeReader:
    """Reads whole presses of one sensor by a fitted color model and steps of forward responses, as a Reconstructor does.

    `press` is any press that it will read; a color change up to `untouched` means rest.
    """

    def __init__(self, model: ColorModel, press: PreparedPress, untouched: float) -> None:
        shape = press.size.shape
        background = np.zeros((*shape, 3), np.float32) if press.background is None else press.background
        self.model = model
        self._prepared = model.prepare(background, shape)
        self._depth = CoarseDepth(shape, untouched)

    def frames(self, press: PreparedPress, responses: Sequence[ForwardResponse | None]) -> list[Step]:
        """Slopes of the whole press by the step of each response; without a step, variance is 1 and residual 0."""
        change = np.ascontiguousarray(press.color_change)
        slopes, _ = self._prepared.gradients_from_color(change)
        ones, zeros = np.ones(slopes.shape[:2], np.float32), np.zeros(slopes.shape[:2], np.float32)
        stepping = any(one is not None and one.step_sigma is not None for one in responses)
        depth = self._depth(change, slopes) if stepping else None
        return [
            Step(slopes, ones, zeros)
            if depth is None or one is None or one.step_sigma is None
            else PreparedStep(one)(change, slopes, depth)
            for one in responses
        ]

    def depth_px(self, press: PreparedPress) -> Map:
        """Depth (H, W), px, from the slopes of the color model, for the fit of forward responses."""
        change = np.ascontiguousarray(press.color_change)
        return self._depth.at_pixels(change, self._prepared.gradients_from_color(change)[0])


class FittedSlopes(NamedTuple):
    """A fitted candidate: the reader with its color model, and the forward response of its step or None."""

    reader: SlopeReader
    forward: ForwardResponse | None

    def frame(self, press: PreparedPress) -> Step:
        """Slopes of the whole press."""
        return self.reader.frames(press, [self.forward])[0]


def averaged(
    average: Candidate, fits: Sequence[FittedSlopes], press: PreparedPress, untouched: float
) -> FittedSlopes:
    """One color model and one forward response, the means of those of an average's fits."""
    shares = [share for share, _ in average.parts]
    kind = fits[0].reader.model
    assert isinstance(kind, StartableModel)
    model = kind.average([fit.reader.model for fit in fits], shares)
    responses = [fit.forward for fit in fits if fit.forward is not None]
    return FittedSlopes(SlopeReader(model, press, untouched), ForwardResponse.average(responses, shares))


def fitted_responses(
    reader: SlopeReader,
    presses: Sequence[PreparedPress],
    contacts: Sequence[ContactCircle],
    ridges: Sequence[float],
    *,
    start: Start | None = None,
    total: int = TOTAL_SAMPLES,
) -> list[ForwardResponse]:
    """Forward responses of presses, one for each ridge, with the depths from the reader's color model.

    The model was fitted on the same presses, from the same start; about `total` pixels are used.
    """
    presses = [replace(press, depth_px=reader.depth_px(press)) for press in presses]
    samples = training_samples(presses, contacts, total=total)
    sigma = step_sigma_of(reader.model, samples)
    forward = None if start is None else start.forward
    return ForwardResponse.fit_each(samples, ridges, step_sigma=sigma, start=forward)


def step_sigma_of(model: ColorModel, samples: Samples) -> tuple[float, float]:
    """Standard deviations for a step's prior: error of a component of the color model's slopes, at rest and per slope."""
    error = model.gradients_at(samples.color_change, samples.x_px, samples.y_px) - samples.gradients
    square, slope = np.mean(error**2, axis=1), np.sum(np.square(samples.gradients), axis=1)
    at_rest, pressed = (float(square[part].mean()) if part.any() else 0.0 for part in (slope == 0, slope > 0))
    growth = max(pressed - at_rest, 0.0) / float(slope[slope > 0].mean())
    return STEP_SIGMAS * max(at_rest, LEAST_STEP_SIGMA**2) ** 0.5, STEP_SIGMAS * growth**0.5


@dataclass(frozen=True)
class Fold:
    """Indices of the held-out presses and of the training presses, with the refined circles of the latter."""

    held_out: tuple[int, ...]
    training: tuple[int, ...]
    contacts: tuple[ContactCircle, ...]


def make_folds(located: Located, *, progress: Progress = no_progress) -> list[Fold]:
    """Split the accepted presses into folds, each size of ball evenly, and refine each fold's training circles.

    Of under 12 presses each is a fold by itself, because a fold of two would leave too few to train. No two accepted presses
    show the same contact (`circles.locate`). CalibrationError: the presses agree with each other only because of a few.
    """
    ordered = sorted(located.refined.accepted, key=lambda i: located.prepared[i].ball_radius_px)
    count = FOLDS if NEEDED.edge.met(len(ordered)) else len(ordered)
    folds = []
    for f in range(count):
        held_out = ordered[f::count]
        folds.append(fold_of(located, held_out, [i for i in ordered if i not in held_out]))
        progress(f + 1, count, "holding presses out")
    for fold in folds:
        if not NEEDED.model.met(len(fold.training)):
            names = ", ".join(located.presses.presses[i].name for i in fold.held_out)
            raise CalibrationError(
                f"Expected presses of a ball that fit each other, but without {names} only {len(fold.training)} of the "
                f"other {len(ordered) - len(fold.held_out)} do. {' '.join(located.notes)} Press a ball of known diameter "
                "firmly at more places."
            )
    return folds


def fold_of(located: Located, held_out: Sequence[int], training: Sequence[int]) -> Fold:
    """The fold of some held-out presses, with those of the training presses that fit each other."""
    refined = refine([located.prepared[i] for i in training], start=located.refined_by)
    kept = refined.accepted
    return Fold(tuple(held_out), tuple(training[k] for k in kept), tuple(refined.contacts[k] for k in kept))


def refined_alone(located: Located, fold: Fold) -> Fold:
    """The fold, with the circles of its training presses as they are without a start; as it is if too few then fit."""
    if located.refined_by is None:
        return fold
    alone = fold_of(replace(located, refined_by=None), fold.held_out, fold.training)
    return alone if NEEDED.model.met(len(alone.training)) else fold


class HeldOutSlopeScore(NamedTuple):
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
    _alone: dict[Fold, Fold] = field(default_factory=dict, init=False, repr=False)

    def prepared_for(self, candidate: Candidate) -> tuple[list[PreparedPress], float]:
        """The presses with the color changes that a candidate reads, and the largest change of gel at rest; kept."""
        offset = candidate.change_offset
        if offset not in self._prepared:
            own = prepared_with(self.located.presses, self.located.prepared, offset)
            self._prepared[offset] = own, untouched_change(*self.located.refined.of_accepted(own))
        return self._prepared[offset]

    def fit(self, fold: Fold, candidates: Sequence[Candidate]) -> list[FittedSlopes]:
        """Fit candidates that differ only in their settings on a fold's training presses; the fits are kept."""
        unknown = [one for one in dict.fromkeys(candidates) if (fold, one) not in self._fits]
        for one in unknown:
            if one.parts:
                presses, untouched = self.prepared_for(one)
                fits = [self.fit(fold, [part])[0] for _, part in one.parts]
                self._fits[fold, one] = averaged(one, fits, presses[0], untouched)
        new = [one for one in unknown if not one.parts]
        if new:
            presses, untouched = self.prepared_for(new[0])
            own = fold if new[0].start is not None else self._refined_alone(fold)
            training = [presses[i] for i in own.training]
            samples = training_samples(training, own.contacts, total=TRIAL_SAMPLES)
            for plain in dict.fromkeys(one.plain for one in new):
                if (fold, plain) not in self._fits:
                    reader = SlopeReader(plain.fit(samples), presses[0], untouched)
                    self._fits[fold, plain] = FittedSlopes(reader, None)
                reader = self._fits[fold, plain].reader
                stepped = {s.step_ridge: s for s in new if s.plain == plain and s.step_ridge is not None}
                if stepped:
                    responses = fitted_responses(
                        reader, training, own.contacts, list(stepped), start=plain.start, total=TRIAL_SAMPLES
                    )
                    for one, forward in zip(stepped.values(), responses):
                        self._fits[fold, one] = FittedSlopes(reader, forward)
        return [self._fits[fold, one] for one in candidates]

    def _refined_alone(self, fold: Fold) -> Fold:
        """The fold with circles that no start has moved, for fits without one; kept."""
        if fold not in self._alone:
            self._alone[fold] = refined_alone(self.located, fold)
        return self._alone[fold]

    def try_candidates(
        self, candidates: Sequence[Candidate], folds: Sequence[Fold] | None = None
    ) -> list[Trial]:
        """Fit candidates that differ only in their settings without each fold, its own or others, and score them on it."""
        scores: list[dict[int, HeldOutSlopeScore]] = [{} for _ in candidates]
        prepared, _ = self.prepared_for(candidates[0])
        for fold in self.folds if folds is None else folds:
            readers: dict[SlopeReader, list[int]] = {}
            fits = self.fit(fold, candidates)
            for k, fit in enumerate(fits):
                readers.setdefault(fit.reader, []).append(k)
            for reader, members in readers.items():  # candidates that differ only by steps are read once
                for i in fold.held_out:
                    frames = reader.frames(prepared[i], [fits[k].forward for k in members])
                    for k, frame in zip(members, frames):
                        scores[k][i] = score_of(prepared[i], frame)
        return [Trial(candidate, of) for candidate, of in zip(candidates, scores)]


def score_of(press: PreparedPress, frame: Step) -> HeldOutSlopeScore:
    """Errors of the slopes that were read on a press, inside the contact edge."""
    rows, cols = press.pixels(press.found, 1.0, PRESS_PIXELS)
    start = press.found.circle_px[:2]
    score = score_slopes(frame.gradients[rows, cols], cols, rows, start, press.ball_radius_px)
    error = float(np.sqrt(np.mean(np.sum(score.errors**2, axis=1))))
    return HeldOutSlopeScore(max(error, 1e-9), score.normal_deg)


def select(
    group: Sequence[Candidate],
    held_out: HeldOutPresses,
    *,
    averaging: bool = False,
    progress: Progress = no_progress,
) -> Selection:
    """Select among candidates of one color model, then the step: by all presses, and without each fold's.

    If candidates read held-out presses equally well, the first one is selected. For `averaging`, it is one with a step.
    """
    left_out = [*(fold.held_out for fold in held_out.folds), ()]
    presses = sum(map(len, left_out))
    plain = held_out.try_candidates(group)
    progress(1, 2, f"tried {group[0].model}")
    leaders = [_best(plain, without) for without in left_out]
    stepped = {one: held_out.try_candidates(one.with_steps(presses)) for one in dict.fromkeys(leaders)}
    progress(2, 2, "tried the forward response")

    def chosen(leader: Candidate, without: Sequence[int]) -> Candidate:
        unstepped = [] if averaging else [trial for trial in plain if trial.candidate == leader]
        return _best([*unstepped, *stepped[leader]], without)

    *by_fold, by_all = map(chosen, leaders, left_out)
    return Selection(by_all, tuple(by_fold), tuple(chain(plain, *stepped.values())))


def mean_of(parts: Sequence[Candidate], own_share: float) -> Candidate:
    """The average of a candidate from a start, or the stiffest, and one without it."""
    begun, own = parts
    of_own = (*((f"own_{key}", value) for key, value in own.settings), ("own_share", own_share))
    return replace(begun, settings=begun.settings + of_own, parts=((1 - own_share, begun), (own_share, own)))


def average(selections: Sequence[Selection], held_out: HeldOutPresses) -> Selection:
    """The average of two selections, as from a start and without it, in proportion to their likelihoods.

    Each press is one observation, of unknown variance, so that a likelihood is the product of one over the presses' errors.
    """
    trials = {trial.candidate: trial for one in selections for trial in one.trials}

    def of(parts: Sequence[Candidate], without: Sequence[int]) -> Candidate:
        begun, own = (trials[part].mean_log(without) for part in parts)
        presses = len(trials[parts[0]].scores) - len(without)
        return mean_of(parts, float(scipy.special.expit(presses * (begun - own))))

    pairs = zip(*((*one.by_fold, one.chosen) for one in selections))
    *by_fold, by_all = map(of, pairs, [*(fold.held_out for fold in held_out.folds), ()])
    return Selection(by_all, tuple(by_fold), (*trials.values(), *held_out.try_candidates([by_all])))


def _best(trials: Sequence[Trial], without: Sequence[int]) -> Candidate:
    """The candidate with the smallest mean logarithm; the first one if there are too few presses."""
    return min(trials, key=lambda trial: trial.mean_log(without)).candidate


@dataclass(frozen=True, eq=False)
class Fitted:
    """The selected color model and forward response, fitted on all accepted presses, and without each fold."""

    held_out: HeldOutPresses  # the located presses, split into folds, with the fits without each
    selection: Selection  # the selected candidate
    calibration: Calibration  # of all accepted presses, without its errors yet
    notes: tuple[str, ...] = ()  # the color models that could not be compared, with the reasons


def fit(
    located: Located,
    folds: Sequence[Fold],
    color_model: str,
    *,
    compare: bool = False,
    progress: Progress = no_progress,
) -> Fitted:
    """Select the stiffness of the color model and its forward response on held-out presses, and fit both on all.

    A fit from another unit's model is of its kind, and averaged with one without it. Under 12 presses choose nothing: these
    two are the stiffest, and without a start it is averaged with what held-out presses prefer. `compare` tries all models
    and does not change the selection.
    """
    accepted, start = len(located.refined.accepted), located.start
    held_out, groups = HeldOutPresses(located, folds), [candidates_for(color_model, accepted)]
    if start is not None:
        groups.insert(0, candidates_from(start, accepted))
    few = color_model in (AUTO, DEFAULT_MODEL) and not NEEDED.edge.met(accepted)
    stiffest = [one[0].with_steps(accepted)[0] for one in groups if few]
    trials = [tuple(held_out.try_candidates([one])) for one in stiffest]
    selections = [Selection(one, (one,) * len(folds), tried) for one, tried in zip(stiffest, trials)]
    if not few or start is None:
        averaging = few or start is not None
        selections += [select(one, held_out, averaging=averaging, progress=progress) for one in groups]
    selection = selections[0] if len(selections) == 1 else average(selections, held_out)
    notes: tuple[str, ...] = ()
    if compare:
        selection, notes = _compared(selection, held_out, accepted, progress)
    prepared, untouched = held_out.prepared_for(selection.chosen)
    used, contacts = located.refined.of_accepted(prepared)
    own = located.presses.subset(located.refined.accepted)
    whole = refined_alone(located, Fold((), tuple(located.refined.accepted), tuple(contacts)))
    unmoved = [prepared[i] for i in whole.training], whole.contacts
    calibration = fit_all(own, used, contacts, selection.chosen, untouched, unmoved)
    shown = set(located.refined.accepted)  # a frame that shows a used press again is no new one either
    digests = [
        one.digest for i, one in enumerate(located.presses.presses) if located.repeated.get(i, i) in shown
    ]
    calibration = replace(calibration, training_digests=tuple(digests))
    return Fitted(held_out, selection, calibration, notes)


def _compared(
    selection: Selection, held_out: HeldOutPresses, presses: int, progress: Progress
) -> tuple[Selection, tuple[str, ...]]:
    """The selection followed by the trials of every other color model, and the models that could not be tried."""
    trials = {trial.candidate: trial for trial in selection.trials}
    left_out: list[str] = []
    for name in COLOR_MODELS:
        try:
            others = select(candidates_for(name, presses), held_out, progress=progress).trials
        except GelformError as problem:  # its extra is not installed, or it needs more presses
            left_out.append(f"{name} was not compared: {problem}")
            continue
        trials |= {trial.candidate: trial for trial in others if trial.candidate not in trials}
    return replace(selection, trials=tuple(trials.values())), tuple(left_out)


def fit_all(
    presses: Presses,
    prepared: Sequence[PreparedPress],
    contacts: Sequence[ContactCircle],
    chosen: Candidate,
    untouched: float,
    alone: tuple[Sequence[PreparedPress], Sequence[ContactCircle]] | None = None,
) -> Calibration:
    """The calibration of presses by the selected candidate; its errors and its slope sigma are filled in later.

    A fit without a start takes the presses and circles `alone` instead, if they are given.
    """
    noise, fits, of_all = presses.background_noise, [], (prepared, contacts)
    for one in [part for _, part in chosen.parts] or [chosen]:
        how = of_all if alone is None or one.start is not None else alone
        reader = SlopeReader(one.fit(training_samples(*how)), prepared[0], untouched)
        step = one if one.step_ridge is not None else one.with_steps(len(prepared))[0]
        assert step.step_ridge is not None
        (response,) = fitted_responses(reader, *how, [step.step_ridge], start=one.start)
        fits.append(FittedSlopes(reader, response))
    reader, forward = averaged(chosen, fits, prepared[0], untouched) if chosen.parts else fits[0]
    assert forward is not None
    images = [press.image for press in presses.presses]
    levels = [image[one.pixels(contact, ZONE)] for image, one, contact in zip(images, prepared, contacts)]
    shares = ends_shown(np.concatenate(levels))  # under 1 % do not teach the effect of a clipped channel
    forward = replace(
        forward,
        step_sigma=None if chosen.step_ridge is None else forward.step_sigma,
        clipped=np.asarray(shares > 0.01),
    )
    few_from = None if NEEDED.edge.met(len(prepared)) else chosen.start
    length_mm = None if few_from is None else few_from.relaxation_mm
    if length_mm is None:
        length_mm = relaxation_from_presses(reader.model, *of_all, presses.background, presses.mm_per_px)
    return Calibration(
        sensor_name=presses.sensor_name,
        serial=presses.serial,
        gel_id=presses.gel_id,
        view=presses.camera_view,
        image_shape=presses.image_shape,
        mm_per_px=presses.mm_per_px,
        mm_per_px_sigma=presses.mm_per_px_sigma,
        background=presses.background,
        background_noise=noise_from_image(presses.background) if noise is None else noise,
        change=change_settings(presses, chosen.change_offset),
        color_model=reader.model,
        forward=forward,
        slope_sigma=FIRST_GUESS if forward.step_sigma is None else replace(FIRST_GUESS, per_step=1.0),
        untouched_change=untouched,
        held_out={},
        training_digests=tuple(press.digest for press in presses.presses),
        settings=_settings(presses, chosen, images, prepared[0].contact_radius_ratio, length_mm),
        library_version=__version__,
        created_utc=datetime.now(timezone.utc).isoformat(timespec="seconds"),
    )


def _settings(
    presses: Presses,
    chosen: Candidate,
    images: Sequence[Any],
    contact_radius_ratio: float,
    relaxation_mm: float | None = None,
) -> CalibrationSettings:
    """Inputs and choices of the run and the gel's relaxation, as the calibration records them."""
    return CalibrationSettings(
        contact_radius_ratio=contact_radius_ratio,
        step_ridge=chosen.step_ridge,
        start=None if chosen.start is None else chosen.start.digest,
        presses=len(images),
        response=presses.response,
        camera=dict(presses.camera) if presses.camera else None,
        relaxation_mm=relaxation_mm,
        image_noise=image_noise(images, presses.background).tolist(),
        others=dict(chosen.settings),
        **presses.geometry.settings(),
    )


def image_noise(images: Sequence[Array], background: Map) -> Numbers:
    """Standard deviation (3,) of an image's pixel, gray levels: the median over some of the images.

    A background is often an average of frames, with less noise than the images of presses.
    """
    some = images[:: max(1, len(images) // SAMPLED)]
    found = [noise_from_image(image.astype(np.float32) - background) for image in some]
    return np.asarray(np.median(found, axis=0), dtype=np.float64)


def relaxation_from_presses(
    model: ColorModel,
    presses: Sequence[PreparedPress],
    contacts: Sequence[ContactCircle],
    background: Map,
    mm_per_px: float,
) -> float | None:
    """The gel's relaxation length L in mm; None if the surroundings of the contacts do not show it.

    Around a ball's contact the gel is a membrane under tension on an elastic bed, `laplace(z) = z/L^2` (Kerr, J. Appl.
    Mech. 31, 1964). It has the depth A K0(r/L) and the slope -A/L K1(r/L) at the distance r from the ball's axis. One L is
    fitted to the slopes of all presses by least squares, and one A to each.
    """
    prepared, step = model.prepare(background, presses[0].size.shape), -(-len(presses) // SAMPLED)
    lengths_mm = np.geomspace(0.15, 2.0, 53)
    errors, squares = np.zeros(lengths_mm.size), 0.0
    for press, contact in zip(presses[::step], contacts[::step]):
        slopes = prepared.gradients_from_color(np.ascontiguousarray(press.color_change))[0]
        r, slope, pixels = slopes_around(slopes, contact, press.usable, mm_per_px)
        if r.size:
            for k, length in enumerate(lengths_mm):  # what the best -A K1(r/L) with A >= 0 leaves
                shape = scipy.special.k1e(r / length) * np.exp((r[0] - r) / length)
                size = max(-float(pixels @ (slope * shape)) / float(pixels @ shape**2), 0.0)
                errors[k] += float(pixels @ (slope + size * shape) ** 2)
            squares += float(pixels @ slope**2)
    best = int(np.argmin(errors))
    explained = 0 < best < errors.size - 1 and errors[best] < 0.5 * squares
    return float(lengths_mm[best]) if explained else None


def slopes_around(
    gradients: Slopes, contact: ContactCircle, usable: Mask | None, mm_per_px: float
) -> tuple[Numbers, Numbers, Numbers]:
    """Distance (mm), mean outward slope and number of visible pixels of rings around a contact, 1 px wide."""
    height, width = gradients.shape[:2]
    dx = np.arange(width, dtype=np.float32) - np.float32(contact.x_px)
    dy = (np.arange(height, dtype=np.float32) - np.float32(contact.y_px))[:, None]
    r = np.hypot(dx, dy)
    outward = (gradients[..., 0] * dx + gradients[..., 1] * dy) / np.maximum(r, 1)
    ring = r.astype(np.intp)
    # From 4 px on, within which the blurred image still shows the ball; beyond 3 mm the gel is level.
    first, last = int(contact.radius_px + 4) + 1, int(contact.radius_px + 3 / mm_per_px)
    inside = (ring >= first) & (ring < last) & (True if usable is None else usable)
    at, size = ring[inside] - first, max(last - first, 1)
    count, sums, far = (
        np.bincount(at, weights=of, minlength=size)
        for of in (None, outward[inside].astype(np.float64), r[inside].astype(np.float64))
    )
    whole = 2 * np.pi * (first + np.arange(size) + 0.5)
    known = count > 0.75 * whole  # a tilt of all slopes cancels over a whole ring
    n = count[known].astype(np.float64)
    return far[known] / n * mm_per_px, sums[known] / n, n
