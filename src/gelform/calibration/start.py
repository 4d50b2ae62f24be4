"""Where the calibration of a second unit begins: at what the first unit's color model says, of whatever kind it is.

A second unit's model is drawn to coefficients of `hierarchical`. A first unit's model of another kind is therefore
translated: a `hierarchical` is fitted to what that model reads from the colours that slopes give on the first unit.
"""

from __future__ import annotations

from os import PathLike
from typing import TYPE_CHECKING

import numpy as np

from gelform.background.change import ChangeSettings, gain_from_background
from gelform.calibration.selection.candidates import Start
from gelform.calibration_file import Calibration, as_calibration
from gelform.color_models import HierarchicalModel, Samples
from gelform.errors import CalibrationError

if TYPE_CHECKING:
    from gelform.calibration.presses.folder import Presses

TRANSLATED_SAMPLES = 20_000
STEEPEST = 0.7  # mm/mm, of translated slopes, where the first unit does not say up to which it was measured


def start_from(start: Calibration | str | PathLike[str], presses: Presses, color_model: str) -> Start:
    """What a first unit's calibration gives a second one to begin with.

    Parameters
    ----------
    start : the calibration or its file
    presses : of the second unit
    color_model : that the second unit's calibration asks for

    Raises
    ------
    ValueError
        The second unit asks for another color model than `hierarchical`, or its images are of another size.
    CalibrationError
        The first unit's calibration was imported and does not say what colour a slope gives.
    """
    first = as_calibration(start)
    if color_model not in ("auto", "hierarchical"):
        raise ValueError(
            f"Expected the color model hierarchical, which can be drawn to another unit's, got {color_model}. "
            "Leave it out, or give --model hierarchical."
        )
    model = first.color_model
    if isinstance(model, HierarchicalModel):
        model.check_like(model.degree, presses.image_shape)
    elif tuple(first.image_shape) != tuple(presses.image_shape):
        (height, width), (rows, columns) = presses.image_shape, first.image_shape
        raise ValueError(
            f"Expected to start from a calibration for images of {height}x{width} px, got one for {rows}x{columns} px."
        )
    else:
        model = translated(first)
    return Start(model, first.digest)


def translated(first: Calibration) -> HierarchicalModel:
    """A `hierarchical` that reads the slopes that a calibration's model reads, where its gel gives colours.

    Places and slopes are drawn at random, always the same ones; the forward response gives their colours, its noise
    is added, and the model says which slopes it reads there.

    Raises
    ------
    CalibrationError
        The calibration has no forward response.
    """
    if first.forward is None:
        raise CalibrationError(
            f"Expected a first unit that was calibrated on presses of a ball, got {first.sensor_name} with the imported "
            f"color model {first.color_model.name}: it does not say what colour a slope gives. Calibrate it on presses."
        )
    rng, shape = np.random.default_rng(0), first.image_shape
    x, y = (rng.integers(0, n, TRANSLATED_SAMPLES) for n in (shape[1], shape[0]))
    steepest = STEEPEST if first.slope_sigma is None else first.slope_sigma.slopes[-1]
    size = steepest * np.sqrt(rng.uniform(size=TRANSLATED_SAMPLES))
    turn = rng.uniform(0, 2 * np.pi, TRANSLATED_SAMPLES)
    slopes = size[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    noise = rng.multivariate_normal(np.zeros(3), first.forward.covariance, len(x))
    change = first.forward.color_from_gradients(slopes, x, y) + noise
    usual = ChangeSettings(
        offset=HierarchicalModel.change_offset,
        crosstalk=first.change.crosstalk,
        response=first.change.response,
    )
    gains = (gain_from_background(first.background, settings)[y, x] for settings in (usual, first.change))
    usual_change = (change * (next(gains) / next(gains))).astype(np.float32)
    read = first.color_model.gradients_at(change.astype(np.float32), x, y)
    samples = Samples(usual_change, x, y, read, np.ones(len(x)), shape, first.background)
    return HierarchicalModel.fit(samples)
