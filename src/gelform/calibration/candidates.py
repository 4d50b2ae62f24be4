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

from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.samples import (
    TOTAL_SAMPLES,
    PreparedPress,
    contact_samples,
    with_rest_samples,
)
from gelform.calibration.presses.press_set import Presses
from gelform.calibration.starters import (
    check_light,
    light_from_background,
    load_starter,
    starter_for,
    starter_names,
)
from gelform.calibration_file import Calibration, as_calibration
from gelform.depth.stepped import CoarseDepth
from gelform.errors import CalibrationError
from gelform.image.background.change import ChangeSettings, gain_from_background
from gelform.slopes.color_models import (
    COLOR_MODELS,
    DEFAULT_MODEL,
    ColorModel,
    ForwardResponse,
    Samples,
    StartableModel,
)
from gelform.slopes.color_models.forward_response import PreparedStep, Step

AUTO = "auto"
# Ridges of a model that is pulled toward another unit's, the stiffest first.
START_RIDGES = (1e-1, 1e-2, 1e-3)
STEP_SIGMAS = 1.25  # times the color model's residual on its training slopes; 1.0-1.5 give the same errors on nine sensors
LEAST_STEP_SIGMA = 1e-4  # mm/mm, for images without noise
TRANSLATED_SAMPLES = 20_000  # number of colors that a first unit's model reads
# Steepest slope, mm/mm, if the first unit's calibration does not have the largest slope that it was measured to.
TRANSLATED_SLOPE = 0.7
# Relative spread of slopes between units of a make without a starter: that of DIGITs, the larger of two makes.
UNIT_SPREAD = 0.10


@dataclass(frozen=True, eq=False)
class Start:
    """Another unit's fitted model, where a fit may begin; equal to itself alone.

    Attributes
    ----------
    model : color model for this unit's color changes
    digest : digest of its calibration
    spread : relative standard deviation of slopes between units
    by : description of its origin
    offered : whether a fit without it is tried too, and kept if it reads held-out presses better
    """

    model: StartableModel
    digest: str
    spread: float
    by: str
    offered: bool = False


@dataclass(frozen=True)
class Candidate:
    """A color model with its settings, its start, and the forward response of its step.

    Attributes
    ----------
    model : a name in `COLOR_MODELS`
    settings : keywords of the model's `fit`, as pairs
    start : another unit's model, or None
    step_ridge : ridge of the forward response; None: no step
    """

    model: str
    settings: tuple[tuple[str, Any], ...] = ()
    start: Start | None = None
    step_ridge: float | None = None

    @property
    def plain(self) -> Candidate:
        """The same candidate without a step."""
        return replace(self, step_ridge=None)

    @property
    def change_offset(self) -> float:
        """Gray levels added to the background in the divisor of its color changes."""
        return float(COLOR_MODELS[self.model].change_offset)

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


def candidates_from(start: Start) -> list[Candidate]:
    """The candidates for a second unit, stiffest first: the first unit's model, changed more and more freely."""
    return [Candidate(start.model.name, (("ridge", ridge),), start) for ridge in START_RIDGES]


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
    total: int = TOTAL_SAMPLES,
) -> list[ForwardResponse]:
    """Forward responses of presses, one for each ridge, with the depths from the reader's color model.

    The model was fitted on the same presses; about `total` pixels are used.
    """
    depths = [reader.depth_px(press) for press in presses]
    inside = contact_samples(presses, contacts, total=total, depths_px=depths)
    samples = with_rest_samples(inside, presses, contacts, depths)
    return ForwardResponse.fit_each(samples, ridges, step_sigma=step_sigma_of(reader.model, samples))


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
    if starter is None:
        return None
    try:
        check_light(presses.background, starter.light, starter.make)
    except CalibrationError:
        return None  # a make that is named wrongly does not make it that sensor; a start given by name raises the error
    model, _ = starter.models_for(light_from_background(presses.background)[0], presses.mm_per_px)
    made = starter.calibration
    unseen = set(made.training_digests).isdisjoint(press.digest for press in presses.presses)
    offered = unseen and color_model in (AUTO, DEFAULT_MODEL)
    return Start(model, made.digest, starter.spread, f"the starter of a {starter.make}", offered)


def starter_note(presses: Presses, color_model: str) -> tuple[str, ...]:
    """A note why the starter of a known make was not tried; () if it was, or if the make has none."""
    if presses.make not in starter_names():
        return ()
    starter, why = load_starter(presses.make), ""
    made = starter.calibration
    if made.image_shape != presses.image_shape:
        (high, wide), (own_high, own_wide) = made.image_shape, presses.image_shape
        why = f"it is for images of {high}x{wide} px, and these are {own_high}x{own_wide} px"
    elif color_model not in (AUTO, DEFAULT_MODEL):
        why = f"it is of the color model {DEFAULT_MODEL}, and {color_model} was asked for"
    elif not set(made.training_digests).isdisjoint(press.digest for press in presses.presses):
        why = "it was made from these presses"
    else:
        try:
            check_light(presses.background, starter.light, starter.make)
        except CalibrationError as problem:
            why = str(problem)
    return (f"The starter of a {starter.make} was not tried, because {why.rstrip('.')}.",) if why else ()


def start_from(start: Calibration | str | PathLike[str], presses: Presses, color_model: str) -> Start:
    """The start for a second unit from a first unit's calibration or its file: its color model, or a translation of it.

    Raises
    ------
    ValueError
        The second unit uses another color model than the default one, or its images are of another size.
    CalibrationError
        The first unit's calibration was imported and has no forward response.
    """
    first = as_calibration(start)
    if color_model not in (AUTO, DEFAULT_MODEL):
        raise ValueError(
            f"Expected the color model {DEFAULT_MODEL}, which can be drawn to another unit's, got {color_model}. "
            f"Leave it out, or give --model {DEFAULT_MODEL}."
        )
    model, by = first.color_model, f"a calibration of {first.sensor_name}"
    spread = first.unit_spread or UNIT_SPREAD
    if isinstance(model, StartableModel):
        model.check_like(model.degree, presses.image_shape)
        if first.mm_per_px is not None:
            model = model.of_other_unit(np.ones((1, 1, 3)), presses.mm_per_px / first.mm_per_px)
        return Start(model, first.digest, spread, by)
    if tuple(first.image_shape) != tuple(presses.image_shape):
        (height, width), (rows, columns) = presses.image_shape, first.image_shape
        raise ValueError(
            f"Expected to start from a calibration for images of {height}x{width} px, got one for {rows}x{columns} px."
        )
    return Start(translated(first), first.digest, spread, by)


def translated(first: Calibration) -> StartableModel:
    """A model of the default kind that reads the same slopes as a calibration's model, for the colors of its gel.

    Places and slopes are drawn at random, always the same ones. The forward response gives their colors, its noise
    is added, and the model reads their slopes. A CalibrationError is raised if there is no forward response.
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
    gains = (gain_from_background(first.background, settings)[y, x] for settings in (usual, first.change))
    usual_change = (change * (next(gains) / next(gains))).astype(np.float32)
    read = first.color_model.gradients_at(change.astype(np.float32), x, y)
    model = kind.fit(Samples(usual_change, x, y, read, np.ones(len(x)), shape, first.background))
    assert isinstance(model, StartableModel)
    return model
