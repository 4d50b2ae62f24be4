"""Where a fit may begin: at the fitted model of another unit, or at the starter of a make."""

from __future__ import annotations

from dataclasses import dataclass, replace
from os import PathLike

import numpy as np

from gelform.calibration.presses.press_set import Presses
from gelform.calibration.starters import (
    check_light,
    light_from_background,
    make_name,
    starter_of_make,
)
from gelform.calibration_file import Calibration, as_calibration
from gelform.errors import CalibrationError
from gelform.image.background import ChangeSettings, gain_from_background
from gelform.sensors.profiles import make_of
from gelform.slopes.color_models import COLOR_MODELS, DEFAULT_MODEL, ForwardResponse, Samples, StartableModel
from gelform.slopes.color_models.seam import MAX_SAMPLES, node_positions

AUTO = "auto"
USUAL_SPREAD = 0.10  # of slopes between units, relative: that of DIGITs, the larger of two makes


@dataclass(frozen=True, eq=False)
class Start:
    """Another unit's fitted model, where a fit may begin; equal to itself alone."""

    model: StartableModel  # color model for this unit's color changes
    forward: ForwardResponse  # for them
    digest: str  # of its calibration
    spread: float  # relative standard deviation of slopes between units
    by: str  # description of its origin
    # Radius of its contact edge over that of the visible rim, and its gel's relaxation length, mm, which few presses
    # cannot measure.
    edge: float | None = None
    relaxation_mm: float | None = None
    offered: bool = False  # whether nobody asked for it, so that circles do without it where presses suffice
    note: str = ""  # for the user, if it is of another gel
    own: bool = False  # whether it was made from these presses

    def at_size(self, shape: tuple[int, int], wider: float) -> Start:
        """The start for images (H, W) of the same gel, whose pixels are `wider` times as wide."""
        model = self.model.at_size(shape, wider)
        return replace(self, model=model, forward=self.forward.at_size(shape, wider))

    @property
    def subject(self) -> str:
        """Its origin, at the head of a sentence."""
        return f"{self.by[0].upper()}{self.by[1:]}"


def starter_start(presses: Presses, color_model: str) -> tuple[Start | None, tuple[str, ...]]:
    """The starter of the sensor's make, and a note why a fit is not offered it; None if its light or its images differ.

    It is offered to fits of the default color model, except for the presses that it was made from. A make without a starter
    needs no note.
    """
    starter = starter_of_make(presses.make)
    if starter is None:
        return None, ()
    start: Start | None = None
    why, own, shape = "", False, starter.calibration.image_shape
    if color_model not in (AUTO, DEFAULT_MODEL):
        why = f"it is of the color model {DEFAULT_MODEL}, and {color_model} was asked for"
    elif own := bool({press.digest for press in presses.presses} & set(starter.calibration.training_digests)):
        why = "it was made from these presses"
    if shape != presses.image_shape:
        (high, wide), (own_high, own_wide) = shape, presses.image_shape
        why = f"it is for images of {high}x{wide} px, and these are {own_high}x{own_wide} px"
    else:
        try:
            check_light(presses.background, starter.light, starter.make)
        except CalibrationError as problem:  # a make that is named wrongly does not make it that sensor
            why = why or str(problem).rstrip(".")
        else:
            light = light_from_background(presses.background)
            model, forward = starter.models_for(light, presses.mm_per_px)
            by = f"the starter of a {starter.make}"
            known = starter.calibration
            gel = known.settings.contact_radius_ratio, known.settings.relaxation_mm
            start = Start(model, forward, known.digest, starter.spread, by, *gel, offered=not why, own=own)
    return start, (f"The starter of a {starter.make} was not tried, because {why}.",) if why else ()


def start_from(start: Calibration | str | PathLike[str], presses: Presses, color_model: str) -> Start:
    """The start for a second unit from a first unit's calibration or its file: its color model, or a translation of it.

    ValueError: the second unit uses another color model than the default one, or its images are of another size.
    CalibrationError: the first unit is of another make, or its calibration was imported and has no forward response.
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
    gel = first.settings.contact_radius_ratio, first.settings.relaxation_mm
    spread = first.unit_spread or USUAL_SPREAD
    other_gel = first.gel_id and presses.gel_id and first.gel_id != presses.gel_id
    note = f"The start is of gel {first.gel_id}, the presses are of {presses.gel_id}." if other_gel else ""
    if isinstance(model, StartableModel) and first.forward is not None:
        model.check_like(model.degree, presses.image_shape)
        forward = first.forward
        if first.mm_per_px is not None:
            alike = np.ones((1, 1, 3)), presses.mm_per_px / first.mm_per_px
            model, forward = model.of_other_unit(*alike), forward.of_other_unit(*alike)
        return Start(model, forward, first.digest, spread, by, *gel, note=note)
    if tuple(first.image_shape) != tuple(presses.image_shape):
        (height, width), (rows, columns) = presses.image_shape, first.image_shape
        raise ValueError(
            f"Expected to start from a calibration for images of {height}x{width} px, got one for {rows}x{columns} px."
        )
    return Start(*translated(first), first.digest, spread, by, *gel, note=note)


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
    rng, count = np.random.default_rng(0), MAX_SAMPLES
    shape, kind = first.image_shape, COLOR_MODELS[DEFAULT_MODEL]
    x, y = (rng.integers(0, n, count) for n in (shape[1], shape[0]))
    steepest = 0.7 if first.slope_sigma is None else first.slope_sigma.shown[1]  # mm/mm
    size = steepest * np.sqrt(rng.uniform(size=count))
    turn = rng.uniform(0, 2 * np.pi, count)
    slopes = size[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    noise = rng.multivariate_normal(np.zeros(3), first.forward.covariance, count)
    change = first.forward.color_from_gradients(slopes, x, y) + noise
    own = first.change
    usual = ChangeSettings(offset=kind.change_offset, crosstalk=own.crosstalk, response=own.response)
    divisor = gain_from_background(first.background, own) / gain_from_background(first.background, usual)
    usual_change = (change / divisor[y, x]).astype(np.float32)
    read = first.color_model.gradients_at(change.astype(np.float32), x, y)
    model = kind.fit(Samples(usual_change, x, y, read, np.ones(count), shape, first.background))
    assert isinstance(model, StartableModel)
    rows, columns = (np.minimum(at, n - 1) for at, n in zip(node_positions(shape), shape))
    return model, first.forward.of_other_unit(divisor[np.ix_(rows, columns)].astype(np.float64), 1.0)
