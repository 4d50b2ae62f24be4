"""Standard deviation of a frame's slopes as they are read: by their step, their size and their place, for each pixel."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.foundations.checks import HIGHEST_SLOPE, check_slopes
from gelform.image.background.change import PreparedBackground
from gelform.image.background.untouched import Reference
from gelform.slopes.color_models.seam import PreparedColorModel
from gelform.slopes.confidence.slope_sigma import SlopeSigma, factor_at, law_at
from gelform.slopes.confidence.solved import for_both

LAW_STEPS = 64  # steps of the table of the law in the frame's kernel, linear in between
USUAL_LEVELS = 2.0  # gray levels, a pixel's noise if the calibration does not know that of its images
NOISE_BLUR_PX = 8.0  # px, standard deviation of the blur of the map of noise; light and model are smooth
_frame_sigma = Kernel(
    "frame_sigma",
    "f32[h,w,3] change, bool[h,w]? hidden, bool[h,w]? given, f32[3] common, f32[2] bias, f32[h,w] rest, f32[h,w] place, "
    "f32[t] law, f32[h,w]? variance, out f32[h,w,2] gradients, out bool[h,w] at_rest, out f32[h,w] sigma, f32 square, "
    "f32 steps, f32 grows, f32 highest",
)
_subtract_bias = Kernel(
    "subtract_bias",
    "f32[h,w,3] change, bool[h,w]? hidden, bool[h,w]? given, f32[3] common, f32[2] bias, out f32[h,w,2] gradients, "
    "out bool[h,w] at_rest, f32 square, f32 highest",
)


class PreparedSigma:
    """Standard deviation for whole frames: that of the step, times factors of slope and place. Threads can share it.

    Parameters
    ----------
    sigma : of the calibration
    noise : (H, W), variance of a slope at rest from the image's noise alone, as `noise_at_rest` gives it

    Attributes
    ----------
    rest_variance : (H, W), variance of a slope at rest
    """

    def __init__(self, sigma: SlopeSigma, noise: NDArray[np.float32]) -> None:
        shape = noise.shape
        y, x = ((np.arange(n) + 0.5) / n for n in shape)
        self._place = (factor_at(np.array(sigma.place), x[None, :], y[:, None]) ** 2).astype(np.float32)
        step = np.float32(1.25 * max(sigma.slopes) / (LAW_STEPS - 2))
        knots = np.array(sigma.slopes), np.array(sigma.sigmas)
        self._law = (law_at(step * np.arange(LAW_STEPS), *knots) ** 2).astype(np.float32)
        grows = (knots[1][-1] / knots[0][-1]) ** 2 if knots[0][-1] > 0 else 0.0
        self._numbers = {"steps": 1 / step, "grows": grows, "highest": HIGHEST_SLOPE}
        self.rest_variance = np.float32(sigma.rest**2) + np.float32(sigma.rest_per_noise**2) * noise

    def __call__(
        self,
        color_change: NDArray[np.float32],
        gradients: NDArray[np.float32],
        reference: Reference,
        hidden: NDArray[np.bool_] | None = None,
        variance: NDArray[np.float32] | None = None,
    ) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
        """The pixels (H, W) at rest, and the standard deviation (H, W) of the slopes, equal for both components.

        Pixels at rest have the deviation of rest at their place. The reference's bias is subtracted from the gradients
        (H, W, 2) in place.
        Hidden pixels are not at rest. `variance` (H, W) is that of the forward response's step, or 1 without a step.

        Raises
        ------
        ValueError
            As `check_slopes` of the gradients.
        """
        shape = gradients.shape[:2]
        at_rest, sigma = np.empty(shape, dtype=bool), np.empty(shape, dtype=np.float32)
        refused = _frame_sigma(
            color_change, hidden, reference.given, reference.common_change, reference.bias, rest=self.rest_variance,
            place=self._place, law=self._law, variance=variance, gradients=gradients, at_rest=at_rest, sigma=sigma,
            square=reference.threshold**2, **self._numbers,
        )  # fmt: skip
        if refused:
            check_slopes(gradients)
        return at_rest, sigma


class UnknownSigma:
    """For an imported calibration: one usual deviation everywhere; it weights the slopes, and results do not state it."""

    def __init__(self, usual: float) -> None:
        self._usual = np.float32(usual)

    def __call__(
        self,
        color_change: NDArray[np.float32],
        gradients: NDArray[np.float32],
        reference: Reference,
        hidden: NDArray[np.bool_] | None = None,
        variance: NDArray[np.float32] | None = None,
    ) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
        """As `PreparedSigma`."""
        shape = gradients.shape[:2]
        at_rest = np.empty(shape, dtype=bool)
        refused = _subtract_bias(
            color_change, hidden, reference.given, reference.common_change, reference.bias, gradients, at_rest,
            square=reference.threshold**2, highest=HIGHEST_SLOPE,
        )  # fmt: skip
        if refused:
            check_slopes(gradients)
        return at_rest, np.full(shape, self._usual)


def noise_at_rest(
    model: PreparedColorModel, background: PreparedBackground, levels: Sequence[float] | None
) -> NDArray[np.float32]:
    """Variance (H, W) of the slopes at rest, if the image's noise were their only error.

    It is larger where light is weak, or where a slope changes the colors little. Noise makes a channel brighter, and the
    color model's derivative says by how much the slopes change; it is one difference for each channel. The noise counts as
    alike over the color change's blur, so only the ratio of two places is meant.

    Parameters
    ----------
    model : color model, ready for frames over this background
    background : in use
    levels : standard deviation of a pixel's red, green and blue, gray levels; None if unknown
    """
    rest = model.gradients_from_color(np.zeros_like(background.background))[0].copy()
    variance = np.zeros(rest.shape[:2], dtype=np.float32)
    for channel, level in enumerate(levels or (USUAL_LEVELS,) * 3):
        brighter = background.background.copy()
        brighter[..., channel] += np.float32(level)
        off = model.gradients_from_color(background.change(brighter))[0] - rest
        variance += off[..., 0] ** 2 + off[..., 1] ** 2
    return np.asarray(cv2.GaussianBlur(variance / 2, (0, 0), NOISE_BLUR_PX, borderType=cv2.BORDER_REPLICATE))


def with_model_sigma(
    sigma: NDArray[np.float32] | None,
    confidence: NDArray[np.float32],
    model_sigma: NDArray[np.float32] | None,
    full_confidence_sigma: float,
) -> tuple[NDArray[np.float32] | None, NDArray[np.float32]]:
    """Standard deviation (H, W, 2) and confidence (H, W), if the color model has a deviation (H, W, 2) of its own.

    The larger of two deviations counts, and the smaller of two confidences; up to `full_confidence_sigma` confidence is 1.
    """
    both = None if sigma is None else for_both(sigma)
    if model_sigma is None:
        return both, confidence
    limit = np.square(np.float32(full_confidence_sigma) / model_sigma.max(axis=-1))
    larger = model_sigma if both is None else np.maximum(model_sigma, both)
    return larger, np.minimum(confidence, limit)
