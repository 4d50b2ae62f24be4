"""Slopes of whole frames after the forward response's step, and the coarse depth of the frame that it needs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelform.depth.coarse import coarse_of
from gelform.foundations.fill import fill_unknown
from gelform.foundations.filters import MIN_UNTOUCHED, medians_where
from gelform.slopes.color_models.forward_response import ForwardResponse, PreparedStep, Step


class CoarseDepth:
    """Least-squares depth of frames; immutable. A color change up to `untouched` means rest, where depth is 0."""

    def __init__(self, shape: tuple[int, int], untouched: float) -> None:
        self._square = np.float32(untouched**2)
        self._coarse = coarse_of(shape)

    def __call__(
        self,
        color_change: NDArray[np.float32],
        gradients: NDArray[np.float32],
        hidden: NDArray[np.bool_] | None = None,
    ) -> NDArray[np.float32]:
        """Depth (rows, columns) on the coarser grid, px; its median over the samples at rest is 0, and no depth is less.

        It comes from a color change (H, W, 3) and the gradients (H, W, 2) of a color model. The slopes around hidden pixels
        (H, W) are continued across them.
        """
        means = self._coarse.means
        change, slopes = means(color_change), means(gradients)
        if hidden is not None and hidden.any():
            shown = ~hidden
            part = means(shown)
            known = part > 0
            part[~known] = 1
            change, slopes = (
                means(m * shown[..., None]) / part[..., None] for m in (color_change, gradients)
            )
            if known.any():
                change, slopes = fill_unknown(change, known), fill_unknown(slopes, known)
        change = change - medians_where(change)[0]
        square = np.einsum("...c,...c->...", change, change)
        rest = square <= self._square
        if np.count_nonzero(rest) < MIN_UNTOUCHED * rest.size:
            rest = square <= np.quantile(square, MIN_UNTOUCHED)
        depth = self._coarse.depth_px(slopes - medians_where(slopes, rest)[0])
        depth -= medians_where(depth[..., None], rest)[0]
        np.maximum(depth, 0, out=depth)
        return depth

    def at_pixels(
        self,
        color_change: NDArray[np.float32],
        gradients: NDArray[np.float32],
        hidden: NDArray[np.bool_] | None = None,
    ) -> NDArray[np.float32]:
        """The depth at every pixel (H, W)."""
        return self._coarse.at_pixels(self(color_change, gradients, hidden))


class SteppedSlopes:
    """Steps of the frames of one calibration. It is immutable; threads can share it.

    Without a response or its `step_sigma` there is no step, and slopes stay as they were read.
    """

    def __init__(self, forward: ForwardResponse | None, shape: tuple[int, int], untouched: float) -> None:
        self._depth = CoarseDepth(shape, untouched)
        self._step = None if forward is None or forward.step_sigma is None else PreparedStep(forward)

    @property
    def steps(self) -> bool:
        """Whether there is a step."""
        return self._step is not None

    def __call__(
        self,
        color_change: NDArray[np.float32],
        gradients: NDArray[np.float32],
        hidden: NDArray[np.bool_] | None = None,
        clipped: NDArray[np.uint8] | None = None,
    ) -> Step | None:
        """The step of a frame, from the gradients (H, W, 2) of the color model; None without a step.

        Pixels without gel are `hidden` (H, W), unusable channels are `clipped` (H, W, 3).
        """
        if self._step is None:
            return None
        return self._step(color_change, gradients, self._depth(color_change, gradients, hidden), clipped)
