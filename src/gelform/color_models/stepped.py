"""Slopes of whole frames after the forward response's step, with the depth that it needs."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.color_models.forward_response import ForwardResponse, Step
from gelform.color_models.frame_depth import FrameDepth


class SteppedSlopes:
    """Steps of the frames of one calibration; immutable, shared by threads.

    Parameters
    ----------
    forward : None, or one without `step_sigma`: slopes stay as they were read
    shape : (H, W)
    untouched : color changes up to it say untouched gel
    """

    def __init__(self, forward: ForwardResponse | None, shape: tuple[int, int], untouched: float) -> None:
        self._depth = FrameDepth(shape, untouched)
        self._step = None if forward is None or forward.step_sigma is None else forward.prepare()

    @property
    def steps(self) -> bool:
        """Whether a step is taken."""
        return self._step is not None

    def __call__(
        self,
        color_change: NDArray[np.float32],
        gradients: NDArray[np.float32],
        hidden: NDArray[np.bool_] | None = None,
        clipped: NDArray[np.uint8] | None = None,
    ) -> Step | None:
        """The step of a frame; None where none is taken.

        Parameters
        ----------
        color_change : (H, W, 3)
        gradients : (H, W, 2), as the color model read them
        hidden : (H, W) bool, pixels that show no gel
        clipped : (H, W, 3), channels that say nothing
        """
        if self._step is None:
            return None
        return self._step(color_change, gradients, self._depth(color_change, gradients, hidden), clipped)

    def depth_px(
        self,
        color_change: NDArray[np.float32],
        gradients: NDArray[np.float32],
        hidden: NDArray[np.bool_] | None = None,
    ) -> NDArray[np.float32]:
        """Depth (H, W), px, of the slopes that the color model read."""
        depth = self._depth(color_change, gradients, hidden)
        return np.asarray(cv2.resize(depth, gradients.shape[1::-1], interpolation=cv2.INTER_LINEAR))
