"""What calibration fits: a color model with its settings, where it starts, and the forward response of its step.

Which settings a color model is tried with is said by the model's own class (`variants`); which model "auto" means for how
many presses, by `enough.AUTO_MODELS`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from os import PathLike
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gelform.background.change import ChangeSettings, gain_from_background
from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.samples import (
    TOTAL_SAMPLES,
    PreparedPress,
    contact_samples,
    with_rest_samples,
)
from gelform.calibration.enough import AUTO_MODELS
from gelform.calibration.presses.press_set import Presses
from gelform.calibration_file import Calibration, as_calibration
from gelform.color_models import (
    COLOR_MODELS,
    DEFAULT_MODEL,
    ColorModel,
    ForwardResponse,
    Samples,
    StartableModel,
)
from gelform.color_models.forward_response import PreparedStep, Step
from gelform.color_models.stepped import FrameDepth
from gelform.errors import CalibrationError
from gelform.starters import check_light, light_from_background, starter_for

AUTO = "auto"
START_RIDGES = (1e-1, 1e-2, 1e-3)  # of a model that is drawn to another unit's, the stiffest first
STEP_SIGMAS = 1.25  # of the color model's residual on its training slopes: 1.0-1.5 are alike on nine sensors
LEAST_STEP_SIGMA = 1e-4  # mm/mm, of images without noise
TRANSLATED_SAMPLES = 20_000  # colours that a first unit's model reads
# The steepest slope, mm/mm, where the first unit does not say up to which slope it was measured.
TRANSLATED_SLOPE = 0.7
# Relative, of slopes between units of a make that has no starter: that of DIGITs, the larger of two makes.
UNIT_SPREAD = 0.10


@dataclass(frozen=True, eq=False)
class Start:
    """Another unit's fitted model, where a fit may begin; equal to itself alone.

    Attributes
    ----------
    model : of this unit's color changes
    digest : of its calibration
    spread : relative standard deviation of slopes between units
    by : whose it is, in words
    offered : whether a fit without it is tried as well, and kept where held-out presses are read better by it
    """

    model: StartableModel
    digest: str
    spread: float
    by: str
    offered: bool = False


@dataclass(frozen=True)
class Candidate:
    """A color model with its settings, what it starts from, and the forward response of its step.

    Attributes
    ----------
    model : a name in `COLOR_MODELS`
    settings : keywords of the model's `fit`, as pairs
    start : another unit's model, or None
    step_ridge : of the forward response; None: slopes stay as the model reads them
    """

    model: str
    settings: tuple[tuple[str, Any], ...] = ()
    start: Start | None = None
    step_ridge: float | None = None

    @property
    def plain(self) -> Candidate:
        """The same without a step."""
        return replace(self, step_ridge=None)

    @property
    def change_offset(self) -> float:
        """Grey levels that are added to the background where its color changes are divided by it."""
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
    """What `calibrate` takes as its color model."""
    return [AUTO, *COLOR_MODELS]


def candidates_for(color_model: str, presses: int) -> list[Candidate]:
    """What is tried with so many accepted presses, simplest first: all variants of a color model, or what "auto" means.

    Raises
    ------
    ValueError
        The name is unknown.
    """
    if color_model not in color_model_names():
        raise ValueError(f"Expected color_model among {', '.join(color_model_names())}, got {color_model!r}.")
    if color_model == AUTO:
        color_model, settings = [row[1:] for row in AUTO_MODELS if presses >= row[0]][-1]
        if settings is not None:
            return [Candidate(color_model, settings)]
    return [
        Candidate(color_model, tuple(variant.items()))
        for variant in COLOR_MODELS[color_model].variants(presses)
    ]


def candidates_from(start: Start) -> list[Candidate]:
    """What is tried on a second unit, stiffest first: the first unit's model, changed more and more freely."""
    return [Candidate(start.model.name, (("ridge", ridge),), start) for ridge in START_RIDGES]


def training_samples(
    presses: Sequence[PreparedPress], contacts: Sequence[ContactCircle], *, total: int = TOTAL_SAMPLES
) -> Samples:
    """What color models are fitted on: pixels inside the contacts' edges, and untouched ones."""
    return with_rest_samples(contact_samples(presses, contacts, total=total), presses, contacts)


class SlopeReader:
    """Reads whole presses of one sensor by a fitted color model and steps of forward responses, as a Reconstructor does.

    `press` is any of those that it will read; color changes up to `untouched` are those of untouched gel.
    """

    def __init__(self, model: ColorModel, press: PreparedPress, untouched: float) -> None:
        shape = press.size.shape
        background = np.zeros((*shape, 3), np.float32) if press.background is None else press.background
        self.model = model
        self._prepared = model.prepare(background, shape)
        self._depth = FrameDepth(shape, untouched)

    def frames(self, press: PreparedPress, responses: Sequence[ForwardResponse | None]) -> list[Step]:
        """Slopes of the whole press by the step of each response; where none is taken variance is 1, residual 0."""
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
        """Depth (H, W), px, by the slopes that the color model reads: what forward responses are fitted with."""
        change = np.ascontiguousarray(press.color_change)
        return self._depth.at_pixels(change, self._prepared.gradients_from_color(change)[0])


class FittedSlopes(NamedTuple):
    """A fitted candidate: what reads presses by its color model, and the forward response of its step or None."""

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
    """Forward responses of presses, one for each ridge, with the depths that the reader's color model gives there.

    The model was fitted on the same presses; about `total` pixels are used.
    """
    depths = [reader.depth_px(press) for press in presses]
    inside = contact_samples(presses, contacts, total=total, depths_px=depths)
    samples = with_rest_samples(inside, presses, contacts, depths)
    return ForwardResponse.fit_each(samples, ridges, step_sigma=step_sigma_of(reader.model, samples))


def step_sigma_of(model: ColorModel, samples: Samples) -> tuple[float, float]:
    """Of a step's prior: how far off a component of the slopes is that a model reads, at rest and per slope."""
    error = model.gradients_at(samples.color_change, samples.x_px, samples.y_px) - samples.gradients
    square, slope = np.mean(error**2, axis=1), np.sum(np.square(samples.gradients), axis=1)
    at_rest, pressed = (float(square[part].mean()) if part.any() else 0.0 for part in (slope == 0, slope > 0))
    growth = max(pressed - at_rest, 0.0) / float(slope[slope > 0].mean())
    return STEP_SIGMAS * max(at_rest, LEAST_STEP_SIGMA**2) ** 0.5, STEP_SIGMAS * growth**0.5


def known_make(presses: Presses) -> Start | None:
    """The starter of the make that the sensor's name begins with; None where there is none, or its light is another."""
    starter = starter_for(presses.sensor_name, presses.image_shape)
    if starter is None:
        return None
    try:
        check_light(presses.background, starter.light, starter.make)
    except CalibrationError:
        return None  # a name alone does not make it that sensor; whoever names a start gets the error
    model, _ = starter.models_for(light_from_background(presses.background)[0])
    digest = starter.calibration.digest
    return Start(model, digest, starter.spread, f"the starter of a {starter.make}", offered=True)


def is_offered(make: Start | None, presses: Presses, color_model: str) -> bool:
    """Whether a fit begins with the starter by default: not where it was made from these very presses."""
    if make is None or color_model not in (AUTO, DEFAULT_MODEL):
        return False
    starter = starter_for(presses.sensor_name, presses.image_shape)
    seen = set() if starter is None else set(starter.calibration.training_digests)
    return seen.isdisjoint(press.digest for press in presses.presses)


def start_from(start: Calibration | str | PathLike[str], presses: Presses, color_model: str) -> Start:
    """What a first unit's calibration, or its file, gives a second one to begin with: its color model, or a translation.

    Raises
    ------
    ValueError
        The second unit asks for another color model than the default one, or its images are of another size.
    CalibrationError
        The first unit's calibration was imported and does not say what colour a slope gives.
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
        return Start(model, first.digest, spread, by)
    if tuple(first.image_shape) != tuple(presses.image_shape):
        (height, width), (rows, columns) = presses.image_shape, first.image_shape
        raise ValueError(
            f"Expected to start from a calibration for images of {height}x{width} px, got one for {rows}x{columns} px."
        )
    return Start(translated(first), first.digest, spread, by)


def translated(first: Calibration) -> StartableModel:
    """A model of the default kind that reads the slopes that a calibration's model reads, where its gel gives colours.

    Places and slopes are drawn at random, always the same ones; the forward response gives their colours, its noise
    is added, and the model says which slopes it reads there. A CalibrationError where there is no forward response.
    """
    if first.forward is None:
        raise CalibrationError(
            f"Expected a first unit that was calibrated on presses of a ball, got {first.sensor_name} with the imported "
            f"color model {first.color_model.name}: it does not say what colour a slope gives. Calibrate it on presses."
        )
    rng, shape, kind = np.random.default_rng(0), first.image_shape, COLOR_MODELS[DEFAULT_MODEL]
    x, y = (rng.integers(0, n, TRANSLATED_SAMPLES) for n in (shape[1], shape[0]))
    steepest = TRANSLATED_SLOPE if first.slope_sigma is None else first.slope_sigma.slopes[-1]
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
