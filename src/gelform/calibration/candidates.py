"""Candidates of a calibration: a color model with its settings, its start, and the forward response of its step.

The model's own class has the settings to try (`variants`). "auto" is `DEFAULT_MODEL` for any number of presses: on four real
sensors its errors with 8 and 11 presses are smaller than those of a polynomial in 14 of 16 draws, with 5 in 4 of 8.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from os import PathLike
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.circles.find import (
    TOTAL_SAMPLES,
    ContactCircle,
    PreparedPress,
    contact_samples,
    with_rest_samples,
)
from gelform.calibration.coverage import NEEDED
from gelform.calibration.presses.press_set import Presses
from gelform.calibration.starters import (
    check_light,
    light_from_background,
    starter_for,
    starter_of_make,
)
from gelform.calibration.starters.starter import Starter, make_name
from gelform.calibration_file import Calibration, as_calibration
from gelform.depth.coarse import CoarseDepth
from gelform.errors import CalibrationError
from gelform.image.background import ChangeSettings, gain_from_background
from gelform.sensors.profiles import make_of
from gelform.slopes.color_models import (
    COLOR_MODELS,
    DEFAULT_MODEL,
    ColorModel,
    ForwardResponse,
    Samples,
    StartableModel,
)
from gelform.slopes.color_models.forward_response import RIDGES, PreparedStep, Step
from gelform.slopes.color_models.least_squares import node_positions

AUTO = "auto"
# Ridges of a fit that is pulled toward another unit's, times its number of presses: the other unit counts as much as this
# part of a press. The stiffest is first; under 12 presses it is the only one.
START_RIDGES = (0.6, 0.06, 0.006)
STEP_SIGMAS = 1.25  # times the color model's residual on its training slopes; 1.0-1.5 give the same errors on nine sensors
LEAST_STEP_SIGMA = 1e-4  # mm/mm, for images without noise
TRANSLATED_SAMPLES = 20_000  # number of colors that a first unit's model reads
# Steepest slope, mm/mm, if the first unit's calibration does not have the largest slope that it was measured to.
TRANSLATED_SLOPE = 0.7
# Relative spread of slopes between units of a make without a starter: that of DIGITs, the larger of two makes.
UNIT_SPREAD = 0.10


@dataclass(frozen=True, eq=False)
class Start:
    """Another unit's fitted model, where a fit may begin; equal to itself alone."""

    model: StartableModel  # color model for this unit's color changes
    forward: ForwardResponse  # for them
    digest: str  # of its calibration
    spread: float  # relative standard deviation of slopes between units
    by: str  # description of its origin
    offered: bool = False  # whether a fit without it is tried too, and kept if held-out presses prefer it
    note: str = ""  # for the user, if it is of another gel

    @property
    def subject(self) -> str:
        """Its origin, at the head of a sentence."""
        return f"{self.by[0].upper()}{self.by[1:]}"


@dataclass(frozen=True)
class Candidate:
    """A color model with its settings, its start, and the forward response of its step."""

    model: str  # a name in `COLOR_MODELS`
    settings: tuple[tuple[str, Any], ...] = ()  # keywords of the model's `fit`, as pairs
    start: Start | None = None  # another unit's model, or None
    step_ridge: float | None = None  # ridge of the forward response; None: no step

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

    def may_not_step(self, presses: int) -> bool:
        """Whether the candidate is also tried without a step; folds of few presses cannot decide it."""
        return self.start is None or NEEDED.edge.met(presses)

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

    Raises
    ------
    ValueError
        The name is unknown.
    """
    if color_model not in color_model_names():
        raise ValueError(f"Expected color_model among {', '.join(color_model_names())}, got {color_model!r}.")
    if color_model == AUTO:
        color_model = DEFAULT_MODEL
    return [
        Candidate(color_model, tuple(variant.items()))
        for variant in COLOR_MODELS[color_model].variants(presses)
    ]


def candidates_from(start: Start, presses: int) -> list[Candidate]:
    """The candidates for a second unit, stiffest first: the first unit's model, changed more and more freely."""
    return [Candidate(start.model.name, (("ridge", ridge),), start) for ridge in start_ridges(presses)]


def start_ridges(presses: int) -> list[float]:
    """Ridges of a fit that begins with another unit's, for a number of presses; folds of few presses cannot choose one."""
    chosen = START_RIDGES if NEEDED.edge.met(presses) else START_RIDGES[:1]
    return [ridge / presses for ridge in chosen]


def training_samples(
    presses: Sequence[PreparedPress], contacts: Sequence[ContactCircle], *, total: int = TOTAL_SAMPLES
) -> Samples:
    """The samples that color models are fitted on: pixels inside the contact edges, and pixels at rest."""
    return with_rest_samples(contact_samples(presses, contacts, total=total), presses, contacts)


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

    def depth_px(self, press: PreparedPress) -> NDArray[np.float32]:
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
    depths = [reader.depth_px(press) for press in presses]
    inside = contact_samples(presses, contacts, total=total, depths_px=depths)
    samples = with_rest_samples(inside, presses, contacts, depths)
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


def starter_start(presses: Presses, color_model: str) -> Start | None:
    """The starter of the sensor's make; None if there is none, or its light differs.

    It is offered to fits of the default color model, except for the presses that it was made from.
    """
    starter = starter_for(presses.make, presses.image_shape)
    if starter is None or _why_other_light(starter, presses):
        return None  # a make that is named wrongly does not make it that sensor; a start given by name raises the error
    light, _ = light_from_background(presses.background)
    model, forward = starter.models_for(light, presses.mm_per_px)
    offered = not _why_not_offered(starter, presses, color_model)
    by = f"the starter of a {starter.make}"
    return Start(model, forward, starter.calibration.digest, starter.spread, by, offered)


def starter_note(presses: Presses, color_model: str) -> tuple[str, ...]:
    """A note why the starter of a known make was not tried; () if it was, or if the make has none."""
    starter = starter_of_make(presses.make)
    if starter is None:
        return ()
    shape = starter.calibration.image_shape
    if shape != presses.image_shape:
        (high, wide), (own_high, own_wide) = shape, presses.image_shape
        why = f"it is for images of {high}x{wide} px, and these are {own_high}x{own_wide} px"
    else:
        why = _why_not_offered(starter, presses, color_model) or _why_other_light(starter, presses)
    return (f"The starter of a {starter.make} was not tried, because {why.rstrip('.')}.",) if why else ()


def _why_not_offered(starter: Starter, presses: Presses, color_model: str) -> str:
    """The reason that a starter is not offered to a fit of presses of its sensor; "" if it is."""
    if color_model not in (AUTO, DEFAULT_MODEL):
        return f"it is of the color model {DEFAULT_MODEL}, and {color_model} was asked for"
    seen = set(starter.calibration.training_digests)
    return (
        "" if seen.isdisjoint(press.digest for press in presses.presses) else "it was made from these presses"
    )


def _why_other_light(starter: Starter, presses: Presses) -> str:
    """The reason that presses are not of a starter's light; "" if they are."""
    try:
        check_light(presses.background, starter.light, starter.make)
    except CalibrationError as problem:
        return str(problem)
    return ""


def start_from(start: Calibration | str | PathLike[str], presses: Presses, color_model: str) -> Start:
    """The start for a second unit from a first unit's calibration or its file: its color model, or a translation of it.

    Raises
    ------
    ValueError
        The second unit uses another color model than the default one, or its images are of another size.
    CalibrationError
        The first unit is of another make, or its calibration was imported and has no forward response.
    """
    first = as_calibration(start)
    if color_model not in (AUTO, DEFAULT_MODEL):
        raise ValueError(
            f"Expected the color model {DEFAULT_MODEL}, which can be drawn to another unit's, got {color_model}. "
            f"Leave it out, or give --model {DEFAULT_MODEL}."
        )
    make = make_of(first.sensor_name)
    if None not in (make, presses.make) and make != presses.make:
        raise CalibrationError(
            f"Expected a start of the make of these presses, a {make_name(str(presses.make))}, got a calibration of a "
            f"{make_name(str(make))}, whose lamps stand elsewhere. Leave the start out, or give one of the same make."
        )
    model, by = first.color_model, f"a calibration of {first.sensor_name}"
    spread = first.unit_spread or UNIT_SPREAD
    other_gel = first.gel_id and presses.gel_id and first.gel_id != presses.gel_id
    note = f"The start is of gel {first.gel_id}, the presses are of {presses.gel_id}." if other_gel else ""
    if isinstance(model, StartableModel) and first.forward is not None:
        model.check_like(model.degree, presses.image_shape)
        forward = first.forward
        if first.mm_per_px is not None:
            alike = np.ones((1, 1, 3)), presses.mm_per_px / first.mm_per_px
            model, forward = model.of_other_unit(*alike), forward.of_other_unit(*alike)
        return Start(model, forward, first.digest, spread, by, note=note)
    if tuple(first.image_shape) != tuple(presses.image_shape):
        (height, width), (rows, columns) = presses.image_shape, first.image_shape
        raise ValueError(
            f"Expected to start from a calibration for images of {height}x{width} px, got one for {rows}x{columns} px."
        )
    return Start(*translated(first), first.digest, spread, by, note=note)


def translated(first: Calibration) -> tuple[StartableModel, ForwardResponse]:
    """A model of the default kind that reads the same slopes as a calibration's model, for the colors of its gel.

    It is followed by the forward response for the color changes of that kind. Places and slopes are drawn at random, always
    the same ones. The forward response gives their colors, its noise is added, and the model reads their slopes. A
    CalibrationError is raised if there is no forward response.
    """
    if first.forward is None:
        raise CalibrationError(
            f"Expected a first unit that was calibrated on presses of a ball, got {first.sensor_name} with the imported "
            f"color model {first.color_model.name}: it does not say what color a slope gives. Calibrate it on presses."
        )
    rng, shape, kind = np.random.default_rng(0), first.image_shape, COLOR_MODELS[DEFAULT_MODEL]
    x, y = (rng.integers(0, n, TRANSLATED_SAMPLES) for n in (shape[1], shape[0]))
    steepest = TRANSLATED_SLOPE if first.slope_sigma is None else first.slope_sigma.shown[1]
    size = steepest * np.sqrt(rng.uniform(size=TRANSLATED_SAMPLES))
    turn = rng.uniform(0, 2 * np.pi, TRANSLATED_SAMPLES)
    slopes = size[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    noise = rng.multivariate_normal(np.zeros(3), first.forward.covariance, len(x))
    change = first.forward.color_from_gradients(slopes, x, y) + noise
    usual = ChangeSettings(
        offset=kind.change_offset, crosstalk=first.change.crosstalk, response=first.change.response
    )
    usual_gain, own_gain = (
        gain_from_background(first.background, settings) for settings in (usual, first.change)
    )
    divisor = own_gain / usual_gain
    usual_change = (change / divisor[y, x]).astype(np.float32)
    read = first.color_model.gradients_at(change.astype(np.float32), x, y)
    model = kind.fit(Samples(usual_change, x, y, read, np.ones(len(x)), shape, first.background))
    assert isinstance(model, StartableModel)
    rows, columns = (np.minimum(at, n - 1) for at, n in zip(node_positions(shape), shape))
    return model, first.forward.of_other_unit(divisor[np.ix_(rows, columns)].astype(np.float64), 1.0)
