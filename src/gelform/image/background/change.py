"""image -> color_change: the effect of a touch, by dividing by or subtracting the background image."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform._native import Kernel
from gelform.foundations.checks import check_image, check_is, check_response, check_values, check_within
from gelform.foundations.fill import fill_unknown
from gelform.foundations.filters import CHANGE_OFFSET, LANES, blur_taps
from gelform.foundations.findings import Finding
from gelform.image.background.check import compared
from gelform.image.background.light import FrameLight, block_means, scale_of_light, without_light
from gelform.image.background.orientation import largest_touch

MAX_CONDITION = 30.0  # of a crosstalk matrix; with a larger one, two channels count as one
MAX_OFFSET, MAX_BLUR_PX = 1e4, 100.0  # gray levels and px, the largest values that a file may have
Matrix = tuple[tuple[float, ...], ...]
_color_change = Kernel(
    "color_change",
    "u8[h,w,3]? image, f32[h,w,3]? light, f32[s] scale, f32[h,w,3] untouched, f32[h,w,3] gain, f32[t] taps, "
    "out f32[n] work, out f32[h,w,3] change",
)


@dataclass(frozen=True)
class ChangeSettings:
    """The settings of the conversion from an image to a color change.

    Attributes
    ----------
    method : "divide" gives (I - I0)/(I0 + offset), "subtract" gives (I - I0)/255
    offset : gray levels added to the divisor, so that dark pixels do not amplify noise
    blur_px : standard deviation of a Gaussian blur of the change, px; 0 for none
    crosstalk : 3x3, row c: the fractions of the red, green and blue light that channel c records; None: no crosstalk
        From `crosstalk_from_frames`. It is removed from image and background before the change is computed.
    response : exponent of the camera's response curve, I = 255 (light/255)^response; 1: linear
        It is removed first, so that I and I0 above are linear light, 0-255.
    """

    method: Literal["divide", "subtract"] = "divide"
    offset: float = CHANGE_OFFSET
    blur_px: float = 0.0
    crosstalk: Matrix | None = None
    response: float = 1.0

    def __post_init__(self) -> None:
        if self.method not in ("divide", "subtract"):
            raise ValueError(f"Expected method 'divide' or 'subtract', got {self.method!r}.")
        check_within(self.offset, "offset", 0, MAX_OFFSET)
        check_within(self.blur_px, "blur_px", 0, MAX_BLUR_PX)
        check_response(self.response)
        if self.crosstalk is not None:
            object.__setattr__(self, "crosstalk", _checked_crosstalk(self.crosstalk))


def _checked_settings(settings: ChangeSettings | None) -> ChangeSettings:
    return ChangeSettings() if settings is None else check_is(settings, ChangeSettings, "settings")


def _checked_crosstalk(crosstalk: Any) -> Matrix:
    matrix = check_values(crosstalk, "crosstalk", (3, 3), np.float64)
    if matrix.ndim != 2:
        raise ValueError(f"Expected crosstalk as 3x3 finite numbers, got {crosstalk}.")
    condition = float(np.linalg.cond(matrix))
    if not condition < MAX_CONDITION:
        raise ValueError(
            f"Expected channels that tell the three lights apart, got a crosstalk matrix of condition number "
            f"{condition:.3g} (limit {MAX_CONDITION:g}). Are two of the LED frames of the same LED?"
        )
    return tuple(tuple(float(value) for value in row) for row in matrix)


def linear_light(image: NDArray[Any], settings: ChangeSettings) -> NDArray[Any]:
    """The image without response curve and crosstalk, (H, W, 3) float32; the image itself if it has neither.

    Linear light keeps the scale of 0-255; the inverse of a crosstalk matrix can make it a little negative.
    """
    light = image
    if settings.response != 1:
        if image.dtype == np.uint8:
            light = cv2.LUT(image, _linear(np.arange(256), settings.response))
        else:
            light = _linear(image, settings.response)
    if settings.crosstalk is not None:
        # The settings refuse a crosstalk that is nearly singular.
        light = cv2.transform(light.astype(np.float32, copy=False), np.linalg.inv(settings.crosstalk))
    return light


def _linear(levels: NDArray[Any], response: float) -> NDArray[np.float32]:
    return np.asarray(255 * (np.asarray(levels) / 255) ** (1 / response), dtype=np.float32)


def gain_from_background(background: ArrayLike, settings: ChangeSettings) -> NDArray[np.float32]:
    """The factor of each pixel's difference to the background, (H, W, 3) float32; 0 where the divisor is 0."""
    reference = check_image(background, name="background").astype(np.float32)
    if settings.method == "subtract":
        return np.full(reference.shape, 1 / 255, dtype=np.float32)
    divisor = linear_light(reference, settings) + np.float32(settings.offset)
    return np.divide(1, divisor, out=np.zeros_like(divisor), where=divisor > 0)


def color_change_from_image(
    image: ArrayLike, background: ArrayLike, settings: ChangeSettings | None = None
) -> NDArray[np.float32]:
    """Relative change of color from the background image; zero means the slope of rest.

    Parameters
    ----------
    image, background : (H, W, 3), RGB, 0-255
    settings : of the conversion; (I - I0)/(I0 + 10) without blur by default

    Returns
    -------
    color_change : (H, W, 3) float32
        A difference in exposure between the images is part of it (see `PreparedBackground`).

    Raises
    ------
    ValueError, TypeError
        The image or the background is no (H, W, 3) of numbers in 0-255, or they differ in size.
    """
    reference = check_image(background, name="background")
    pressed = check_image(image, shape=reference.shape[:2])
    return PreparedBackground(reference, _checked_settings(settings)).change(pressed)


class PreparedBackground:
    """The background image and everything about it that does not depend on the frame; immutable.

    Parameters
    ----------
    background : (H, W, 3), RGB, 0-255
    settings : of the conversion from an image to a color change
    usual : the light of the frames before, or None

    Attributes
    ----------
    gain : (H, W, 3), factor of each pixel's difference, as `gain_from_background`
    """

    def __init__(
        self, background: ArrayLike, settings: ChangeSettings, usual: FrameLight | None = None
    ) -> None:
        self.settings, self._usual = settings, usual
        self.background = check_image(background, name="background").astype(np.float32, order="C")
        self._light = linear_light(self.background, settings)
        self.gain = gain_from_background(self.background, settings)
        self._taps = blur_taps(settings.blur_px)
        self._blocks = block_means(self.background)

    def compare(self, image: NDArray[Any]) -> tuple[FrameLight, tuple[Finding, ...]]:
        """Compare the frame's light with the background's; return it and findings.

        CalibrationError: as `check_background`.
        """
        return compared(block_means(image), self._blocks, self._usual)

    def touched(self, image: NDArray[Any]) -> float:
        """Share of an image (H, W, 3) in its largest region that no light explains."""
        return largest_touch(block_means(image), self._blocks).share

    def bridged(self, image: NDArray[Any], hidden: NDArray[np.bool_]) -> NDArray[Any]:
        """The image (H, W, 3) with hidden pixels (H, W), such as markers, filled by the color change around them.

        A blur of the change then carries nothing from the hidden pixels to others.
        """
        if not hidden.any() or hidden.all():
            return image
        divisor = self.background + np.float32(CHANGE_OFFSET)
        filled = fill_unknown((image + np.float32(CHANGE_OFFSET)) / divisor, ~hidden)
        levels = np.clip(filled[hidden] * divisor[hidden] - np.float32(CHANGE_OFFSET), 0, 255)
        bridged = image.copy()
        bridged[hidden] = np.rint(levels) if np.issubdtype(image.dtype, np.integer) else levels
        return bridged

    def change(self, image: NDArray[Any], light: FrameLight | None = None) -> NDArray[np.float32]:
        """Color change (H, W, 3) float32; with `light`, of the image under the background's light.

        It removes room light and tilt, and divides by the gain.
        """
        return self.pending(image, light).write(np.empty(self._light.shape, dtype=np.float32))

    def light_sigma(self, light: FrameLight) -> NDArray[np.float32] | None:
        """Standard deviation (H, W) of the color change from an unsure light; None for a gain that is known."""
        if light.is_plain and light.is_known:
            return None
        sigma, size = light.change_sigma(self._blocks), self._light.shape[1::-1]
        return np.asarray(cv2.resize(sigma, size, interpolation=cv2.INTER_LINEAR), dtype=np.float32)

    def pending(self, image: NDArray[Any], of_frame: FrameLight | None = None) -> PendingChange:
        """The work of `change` that precedes the pass over the pixels."""
        values, response = np.zeros((3, 4)) if of_frame is None else of_frame.values, self.settings.response
        # The light belongs to the camera's channels, so it acts before response and crosstalk are removed. Factors may wait.
        waits = self.settings.crosstalk is None and (response == 1 or not values[:, 3].any())
        if values.any() and not waits:
            image, values = without_light(image, values), np.zeros((3, 4))
        image = linear_light(image, self.settings)
        is_bytes = image.dtype == np.uint8
        image = np.ascontiguousarray(image, dtype=np.uint8 if is_bytes else np.float32)
        either = (image, None) if is_bytes else (None, image)
        return PendingChange(
            (*either, scale_of_light(image.shape, values / response), self._light, self.gain, self._taps)
        )


@dataclass(frozen=True)
class PendingChange:
    """A color change without its pass over the pixels, which runs alone or together with a color model.

    Attributes
    ----------
    arguments : of the kernel `color_change`, up to its work array
    """

    arguments: tuple[Any, ...]

    @property
    def work_size(self) -> int:
        """Floats of work memory that the kernel needs: a row with its border, and the rows within a blur's reach."""
        row, radius = 3 * self.arguments[3].shape[1], len(self.arguments[5]) - 1
        whole = -(-row // LANES) * LANES
        return row + 6 * radius + LANES + (2 * radius + 1) * whole

    def write(self, out: NDArray[np.float32]) -> NDArray[np.float32]:
        """Compute the color change into `out` (H, W, 3), and return it."""
        _color_change(*self.arguments, np.empty(self.work_size, dtype=np.float32), out)
        return out


def image_from_color_change(
    color_change: ArrayLike, background: ArrayLike, settings: ChangeSettings | None = None
) -> NDArray[np.float32]:
    """The image (H, W, 3) float32, 0-255, of an unblurred color change: the inverse of `color_change_from_image`.

    Values are clipped to 0-255, as a camera would.

    Parameters
    ----------
    color_change : (H, W, 3), from `color_change_from_image` with the same settings
    background : (H, W, 3), RGB, 0-255
    settings : of the conversion; (I - I0)/(I0 + 10) by default

    Raises
    ------
    ValueError, TypeError
        A change or background of another shape, or not finite.
    """
    settings = _checked_settings(settings)
    untouched = check_image(background, name="background").astype(np.float32)
    change = check_values(color_change, "color_change", (3,))
    if change.shape != untouched.shape:
        raise ValueError(
            f"Expected color_change of the background's shape {untouched.shape}, got {change.shape}."
        )
    gain = gain_from_background(untouched, settings)
    light = linear_light(untouched, settings) + change / gain
    if settings.crosstalk is not None:
        light = cv2.transform(light, np.asarray(settings.crosstalk))
    light = np.clip(light, 0, 255)
    image = light if settings.response == 1 else 255 * (light / 255) ** settings.response
    return np.asarray(image, dtype=np.float32)
