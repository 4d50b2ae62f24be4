"""The slopes that a fitted color model and its forward response read of a press: as a Reconstructor does of a frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.circles.samples import PreparedPress
from gelform.color_models import ColorModel, ForwardResponse
from gelform.color_models.forward_response import Step
from gelform.color_models.stepped import SteppedSlopes


class SlopeReader:
    """Reads whole presses of one sensor.

    Parameters
    ----------
    model : fitted
    forward : fitted with it, for a step; None, or one without `step_sigma`: slopes stay as the model reads them
    press : any of those that it will read
    untouched : color changes up to it say untouched gel
    """

    def __init__(
        self, model: ColorModel, forward: ForwardResponse | None, press: PreparedPress, untouched: float
    ) -> None:
        shape = press.size.shape
        rest = np.zeros((*shape, 3), np.float32) if press.background is None else press.background
        self._model = model.prepare(rest, shape)
        self._stepped = SteppedSlopes(forward, shape, untouched)

    def frame(self, press: PreparedPress) -> Step:
        """Slopes of the whole press; where no step is taken their variance is 1 and their residual 0."""
        change = np.ascontiguousarray(press.color_change)
        read, _ = self._model.gradients_from_color(change)
        step = self._stepped(change, read)
        if step is None:
            return Step(read, np.ones(read.shape[:2], np.float32), np.zeros(read.shape[:2], np.float32))
        return step

    def depth_px(self, press: PreparedPress) -> NDArray[np.float32]:
        """Depth (H, W), px, by the slopes that the color model reads: what forward responses are fitted with."""
        change = np.ascontiguousarray(press.color_change)
        return self._stepped.depth_px(change, self._model.gradients_from_color(change)[0])
