"""Causes in a frame: its sigma raised by all of them in one pass, and the confidence that follows."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.background.untouched import Reference
from gelform.confidence.cast_shadows import CastShadows
from gelform.confidence.causes import dark, saturated, seen
from gelform.confidence.causes.compression import added_levels
from gelform.confidence.causes.seen import Limits, Seen, with_margin
from gelform.confidence.forward_cells import explained_change
from gelform.errors import GelformError

_raise_sigma = Kernel(
    "raise_sigma",
    "u8[h,w,3] image, f32[h,w,3] change, f32[h,w,2] gradients, bool[h,w]? unseen_at, f32[ch,cw,9,3]? cells, f32[2] bias, "
    "f32[h,w] gain, out f32[h,w] sigma, out f32[h,w] confidence, out bool[h,w] marked, f32 unexplained, f32 sure, "
    "f32 per_change, f32 unseen, f32 clean, f32 added, f32 per_bend, f32 bend_from, f32 per_slope, "
    "f32 least, i32 reach, i32 dark_to, i32 saturated_from",
)


class PreparedCauses:
    """All causes of one calibration and background; immutable, shared by threads.

    Parameters
    ----------
    limits : what does not depend on the frame
    cells : of the forward response, `coefficients_of_cells`; None where there is none
    rest : (H, W, 3), the untouched image
    shadows : of a sensor whose presses cast some, or None
    """

    def __init__(
        self,
        limits: Limits,
        cells: NDArray[np.float32] | None,
        rest: NDArray[Any],
        shadows: CastShadows | None = None,
    ) -> None:
        self.limits = limits
        self._cells = cells
        self._shadows = shadows
        self._rest = as_levels(rest)
        unexplained = limits.unexplained, limits.sure, limits.per_change
        self._variances = *unexplained, limits.unseen, limits.clean
        self._bend = limits.per_bend, seen.BEND_FROM, seen.STEEP, seen.LEAST_CONFIDENCE, limits.reach_px

    def __call__(
        self,
        image: NDArray[Any],
        color_change: NDArray[np.float32],
        gradients: NDArray[np.float32],
        reference: Reference,
        hidden: NDArray[np.bool_] | None,
        sigma: NDArray[np.float32],
        came: NDArray[Any] | None = None,
    ) -> NDArray[np.float32]:
        """Raise the sigma (H, W) of a frame's slopes in place; the confidence (H, W) that follows.

        Confidence is min(1, (clean / sigma)^2): the only rule, whatever the cause; but 0.002 at least where the image says
        something of the slope. In cast shadows the slopes change in place to those that the other lights show, and are
        doubted.

        Parameters
        ----------
        image : (H, W, 3), 0-255
        color_change : (H, W, 3)
        gradients : (H, W, 2), without the reference's bias
        reference : what untouched pixels have in common
        hidden : (H, W) bool, pixels that markers hide or that are lost, or None
        sigma : (H, W), of the law and the colours' distance to those of the training presses
        came : (H, W, 3), the image as it came, where `image` has parts replaced: its noise counts
        """
        limits, pixels = self.limits, as_levels(image)
        added = self.added_levels(pixels if came is None else as_levels(came))
        unseen = self._unseen(hidden)
        confidence, marked = np.empty_like(sigma), np.empty(sigma.shape, dtype=bool)
        count = _raise_sigma(
            pixels, color_change, gradients, unseen, self._cells, reference.bias, limits.gain, sigma,
            confidence, marked, *self._variances, limits.worth * added, *self._bend,
            dark.DARK_TO, saturated.SATURATED_FROM,
        )  # fmt: skip
        if count:
            self._raise_around(marked if unseen is None else marked & ~unseen, sigma, confidence)
        if self._shadows is not None:
            frame = color_change, gradients, reference.bias, unseen
            self._shadows.take_back(*frame, sigma, confidence, seen.LEAST_CONFIDENCE)
        return confidence

    def seen(
        self,
        image: NDArray[Any],
        color_change: NDArray[np.float32],
        gradients: NDArray[np.float32],
        *,
        markers: NDArray[np.bool_] | None,
        lost: NDArray[np.bool_] | None,
        lost_image: NDArray[Any],
    ) -> Seen:
        """A frame as the single causes look at it; the gradients (H, W, 2) as the color model read them."""
        residual = gentle = None
        if self._cells is not None:
            slopes = gradients, seen.no_steeper(gradients)
            residual, gentle = (color_change - explained_change(self._cells, one) for one in slopes)
        pixels, came = as_levels(image), as_levels(lost_image)
        added = self.added_levels(came)
        cast = None
        if self._shadows is not None:
            hidden = lost if markers is None else markers if lost is None else markers | lost
            cast = self._shadows.sigma(color_change, gradients, self._unseen(hidden))
        masks = markers, lost, came
        return Seen(pixels, color_change, gradients, residual, *masks, added, self.limits, cast, gentle)

    def added_levels(self, pixels: NDArray[np.uint8]) -> float:
        """Noise of an image beyond the calibrated images', grey levels."""
        return added_levels(pixels, self._rest, self.limits.levels)

    def _unseen(self, hidden: NDArray[np.bool_] | None) -> NDArray[np.bool_] | None:
        outside = self.limits.outside
        return hidden if outside is None else outside if hidden is None else hidden | outside

    def _raise_around(
        self, marked: NDArray[np.bool_], sigma: NDArray[np.float32], confidence: NDArray[np.float32]
    ) -> None:
        limits = self.limits
        reached = with_margin(marked, limits.margin_px)
        raised = np.hypot(sigma[reached], np.float32(limits.unseen))
        sigma[reached] = raised
        confidence[reached] = np.minimum(np.square(np.float32(limits.clean) / raised), 1)


class AllAlike:
    """Where results state no deviation of the slopes: each has a confidence of 1, as solvers without weights count it."""

    def __call__(self, *frame: Any) -> NDArray[np.float32]:
        """Confidence (H, W), of the arguments of `PreparedCauses`; the sigma stays as it is."""
        _, _, gradients, *_ = frame
        return np.ones(gradients.shape[:2], dtype=np.float32)

    def seen(self, *frame: Any, **masks: Any) -> Seen:
        """Refused: nothing was looked for.

        Raises
        ------
        GelformError
            Always.
        """
        raise GelformError("Expected a Reconstructor with slope_sigma=True, which alone knows of causes.")


def as_levels(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Whole grey levels of an image (H, W, 3), 0-255, in C order."""
    if image.dtype != np.uint8:
        image = np.rint(image).astype(np.uint8)
    return np.ascontiguousarray(image)
