"""image -> color_change: what a touch changed, by dividing by or subtracting the untouched image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from gelform.checks import check_image
from gelform.errors import CalibrationError

RATIO_WARN = (0.9, 1.1)
RATIO_REFUSE = (0.7, 1.4)
CORRELATION_REFUSE = 0.8
CHECKED_PIXELS = 1200
TOUCHED_SHARE = 0.4


@dataclass(frozen=True)
class ChangeSettings:
    """How an image becomes a color change.

    Attributes
    ----------
    method : "divide" gives (I - I0)/(I0 + offset), "subtract" gives (I - I0)/255
    offset : grey levels added to the divisor, so that dark pixels do not amplify noise
    blur_px : standard deviation of a Gaussian blur of the change, px; 0 for none
    """

    method: Literal["divide", "subtract"] = "divide"
    offset: float = 10.0
    blur_px: float = 0.0

    def __post_init__(self) -> None:
        if self.method not in ("divide", "subtract"):
            raise ValueError(f"Expected method 'divide' or 'subtract', got {self.method!r}.")
        if not (self.offset >= 0 and self.blur_px >= 0):
            raise ValueError(f"Expected offset and blur_px >= 0, got {self.offset} and {self.blur_px}.")


@dataclass(frozen=True)
class Finding:
    """Something that a user should know, with its figure."""

    name: str
    message: str
    figure: float


def gain_from_background(background: ArrayLike, settings: ChangeSettings) -> NDArray[np.float32]:
    """What each pixel's difference to the background is multiplied by, (H, W, 3) float32: prepared once."""
    reference = check_image(background, name="background").astype(np.float32)
    if settings.method == "subtract":
        return np.full(reference.shape, 1 / 255, dtype=np.float32)
    divisor = reference + np.float32(settings.offset)
    if float(divisor.min()) <= 0:
        raise ValueError(
            "Expected a background above 0 where it is divided by, got pixels of 0 with offset 0. "
            "Give an offset (10 grey levels is usual) or subtract instead."
        )
    return np.reciprocal(divisor)


def color_change_from_image(
    image: ArrayLike, background: ArrayLike, settings: ChangeSettings | None = None
) -> NDArray[np.float32]:
    """Relative change of colour against the untouched image; zero means: slope as at rest.

    Parameters
    ----------
    image, background : (H, W, 3), RGB, 0-255
    settings : how; (I - I0)/(I0 + 10) without blur by default

    Returns
    -------
    color_change : (H, W, 3) float32
    """
    settings = settings or ChangeSettings()
    reference = check_image(background, name="background").astype(np.float32)
    pressed = check_image(image, shape=reference.shape[:2])
    return change_with_gain(pressed, reference, gain_from_background(reference, settings), settings.blur_px)


def change_with_gain(
    image: NDArray[Any],
    background: NDArray[np.float32],
    gain: NDArray[np.float32],
    blur_px: float,
    out: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:
    """`color_change_from_image` with what a frame needs prepared: the path of `Reconstructor`."""
    change: NDArray[np.float32] = np.empty(image.shape, dtype=np.float32) if out is None else out
    cv2.subtract(image, background, dst=change, dtype=cv2.CV_32F)
    cv2.multiply(change, gain, dst=change)
    if blur_px > 0:
        cv2.GaussianBlur(change, (0, 0), blur_px, dst=change, borderType=cv2.BORDER_REFLECT_101)
    return change


def image_from_color_change(
    color_change: ArrayLike, background: ArrayLike, settings: ChangeSettings | None = None
) -> NDArray[np.float32]:
    """The image (H, W, 3) float32, 0-255, of an unblurred color change: what the forward path inverts.

    Values are clipped to 0-255, as a camera would.
    """
    gain = gain_from_background(background, settings or ChangeSettings())
    change = np.asarray(color_change, dtype=np.float32)
    return np.clip(np.asarray(background, dtype=np.float32) + change / gain, 0, 255)


def untouched_from_color_change(color_change: NDArray[np.float32], threshold: float) -> NDArray[np.bool_]:
    """Pixels (H, W) whose colour did not change: |change - its median over the frame| < threshold.

    The median is taken on a coarse grid: an exposure step moves all pixels alike and touches none.
    """
    common = np.median(color_change[::8, ::8].reshape(-1, 3), axis=0).astype(np.float32)
    inside: NDArray[np.bool_] = _within(color_change, common, float(threshold) ** 2)
    return inside


@njit(cache=True, fastmath=True, nogil=True)
def _within(change, center, square):  # type: ignore[no-untyped-def]
    """Where the distance of a pixel's change to a center is less than the root of `square`."""
    height, width, _ = change.shape
    inside = np.empty((height, width), dtype=np.bool_)
    limit = np.float32(square)
    for y in range(height):
        for x in range(width):
            red = change[y, x, 0] - center[0]
            green = change[y, x, 1] - center[1]
            blue = change[y, x, 2] - center[2]
            inside[y, x] = red * red + green * green + blue * blue < limit
    return inside


def check_background(image: NDArray[Any], background: NDArray[Any]) -> tuple[Finding, ...]:
    """Refuse a background that is not of this image; return what should be warned of.

    On the pixels that a touch left alone (the mode of image over background), the ratio should be 1 and the
    two frames should correlate.

    Raises
    ------
    CalibrationError
        The channels fit better reversed (RGB against BGR), a channel's ratio is outside 0.7-1.4, or the
        correlation is under 0.8. The figure is in the message.
    """
    step = max(1, round((image.shape[0] * image.shape[1] / CHECKED_PIXELS) ** 0.5))
    seen = np.asarray(image[::step, ::step], dtype=np.float32)
    rest = np.asarray(background[::step, ::step], dtype=np.float32)
    ratio = _untouched_ratio(seen, rest)
    correlation = _correlation(seen, rest, ratio)
    turned = _correlation_reversed(seen, rest) if correlation < 0.97 else 0.0
    if turned > max(0.9, correlation + 0.03):
        raise CalibrationError(
            f"The image looks like BGR: its channels fit the background better reversed (correlation "
            f"{turned:.2f} against {correlation:.2f}). Turn them: image[..., ::-1]."
        )
    figures = ", ".join(f"{name} {value:.2f}" for name, value in zip("RGB", ratio))
    if ratio.min() < RATIO_REFUSE[0] or ratio.max() > RATIO_REFUSE[1]:
        raise CalibrationError(
            f"The background is not of this image: untouched pixels are {figures} times as bright as in the "
            f"background (expected {RATIO_REFUSE[0]}-{RATIO_REFUSE[1]}). Take a new background with the same "
            "exposure, white balance and lights."
        )
    if correlation < CORRELATION_REFUSE:
        raise CalibrationError(
            f"The background is not of this image: the two correlate by {correlation:.2f} on untouched pixels "
            f"(expected {CORRELATION_REFUSE} or more). Is it of another sensor, or shifted?"
        )
    if ratio.min() < RATIO_WARN[0] or ratio.max() > RATIO_WARN[1]:
        message = (
            f"Untouched pixels are {figures} times as bright as in the background: take a new background."
        )
        return (Finding("background_ratio", message, float(ratio[np.argmax(np.abs(np.log(ratio)))])),)
    return ()


def _untouched_ratio(seen: NDArray[np.float32], rest: NDArray[np.float32]) -> NDArray[np.float64]:
    return np.array([_mode((seen[..., c] + 1) / (rest[..., c] + 1)) for c in range(3)])


def _correlation_reversed(seen: NDArray[np.float32], rest: NDArray[np.float32]) -> float:
    turned = seen[..., ::-1]
    return _correlation(turned, rest, _untouched_ratio(turned, rest))


def _mode(values: NDArray[np.float32]) -> float:
    """Middle of the shortest interval that holds 30 % of the values: the untouched ones, if so many are."""
    ordered = np.sort(values, axis=None)
    count = max(1, int(0.3 * ordered.size))
    widths = ordered[count - 1 :] - ordered[: ordered.size - count + 1]
    start = int(np.argmin(widths))
    return float(np.median(ordered[start : start + count]))


def _correlation(seen: NDArray[np.float32], rest: NDArray[np.float32], ratio: NDArray[Any]) -> float:
    """Correlation over all but the `TOUCHED_SHARE` of the pixels that changed most, channels together."""
    scaled = seen / ratio.astype(np.float32)
    distance = np.abs(scaled - rest).sum(axis=-1)
    least = distance <= np.quantile(distance, 1 - TOUCHED_SHARE)
    a, b = scaled[least].ravel(), rest[least].ravel()
    if a.std() < 1e-3 or b.std() < 1e-3:  # a featureless background can neither agree nor disagree
        return 1.0
    return float(np.corrcoef(a, b)[0, 1])
