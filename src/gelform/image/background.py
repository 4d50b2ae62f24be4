"""The background image: averaged from frames, the color change against it, its pixels at rest, and its dark surround."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike

from gelform._native import Kernel
from gelform.arrays import MIB, Array, Map, Mask, Numbers
from gelform.errors import DataError, Finding
from gelform.foundations.checks import (
    check_image,
    check_is,
    check_list,
    check_response,
    check_values,
    check_within,
)
from gelform.foundations.filters import (
    CHANGE_OFFSET,
    LANES,
    SIGMA_OF_MEDIAN,
    blur_taps,
    fill_unknown,
)
from gelform.foundations.information import check_condition
from gelform.image.agreement import check_own_background, compared, touch_in
from gelform.image.light import FrameLight, block_means, block_means_later, scale_of_light, without_light
from gelform.image.view import DARK

Matrix = tuple[tuple[float, ...], ...]
_color_change = Kernel(
    "color_change",
    "u8[h,w,3]? image, f32[h,w,3]? light, f32[s] scale, f32[h,w,3] untouched, f32[h,w,3] gain, f32[t] taps, "
    "out f32[n] work, out f32[h,w,3] change",
)


@dataclass(frozen=True)
class ChangeSettings:
    """The settings of the conversion from an image to a color change."""

    # "divide" gives (I - I0)/(I0 + offset), "subtract" gives (I - I0)/255
    method: Literal["divide", "subtract"] = "divide"
    # gray levels added to the divisor, so that dark pixels do not amplify noise
    offset: float = CHANGE_OFFSET
    blur_px: float = 0.0  # standard deviation of a Gaussian blur of the change, px; 0 for none
    # 3x3, row c: the fractions of the red, green and blue light that channel c records; None: no crosstalk. It comes
    # from `crosstalk_from_frames` and is removed from image and background before the change is computed.
    crosstalk: Matrix | None = None
    # exponent of the camera's response curve, I = 255 (light/255)^response; 1: linear. It is removed first, so that I
    # and I0 above are linear light, 0-255
    response: float = 1.0

    def __post_init__(self) -> None:
        if self.method not in ("divide", "subtract"):
            raise ValueError(f"Expected method 'divide' or 'subtract', got {self.method!r}.")
        check_within(self.offset, "offset", 0, 1e4)
        check_within(self.blur_px, "blur_px", 0, 100.0)
        check_response(self.response)
        if self.crosstalk is None:
            return
        matrix = check_values(self.crosstalk, "crosstalk", (3, 3), np.float64)
        if matrix.ndim != 2:
            raise ValueError(f"Expected crosstalk as 3x3 finite numbers, got {self.crosstalk}.")
        wanted = "crosstalk of channels that tell the three lights apart"
        check_condition(matrix, 30.0, wanted, "Are two of the LED frames of the same LED?")
        object.__setattr__(self, "crosstalk", tuple(map(tuple, matrix.tolist())))


def _checked_settings(settings: ChangeSettings | None) -> ChangeSettings:
    return ChangeSettings() if settings is None else check_is(settings, ChangeSettings, "settings")


def linear_light(image: Array, settings: ChangeSettings) -> Array:
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


def _linear(levels: Array, response: float) -> Map:
    return np.asarray(255 * (np.asarray(levels) / 255) ** (1 / response), dtype=np.float32)


def gain_from_background(background: ArrayLike, settings: ChangeSettings) -> Map:
    """The factor of each pixel's difference to the background, (H, W, 3) float32; 0 where the divisor is 0."""
    reference = check_image(background, name="background").astype(np.float32)
    if settings.method == "subtract":
        return np.full(reference.shape, 1 / 255, dtype=np.float32)
    divisor = linear_light(reference, settings) + np.float32(settings.offset)
    return np.divide(1, divisor, out=np.zeros_like(divisor), where=divisor > 0)


def color_change_from_image(
    image: ArrayLike, background: ArrayLike, settings: ChangeSettings | None = None
) -> Map:
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
    """The background image (H, W, 3) and everything about it that does not depend on the frame; immutable.

    `usual` is the light of the frames before, `gain` (H, W, 3) the factor of each pixel's difference.
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

    def compare(self, image: Array) -> tuple[FrameLight, tuple[Finding, ...]]:
        """Compare the frame's light with the background's; return it and findings.

        CalibrationError: as `agreement.compared`.
        """
        blocks, pixels = block_means_later(image)
        return compared(blocks, self._blocks, self._usual, pixels)

    def bridged(self, image: Array, hidden: Mask) -> Array:
        """The image (H, W, 3) with hidden pixels (H, W), such as markers, filled by the color change around them.

        A blur of the change then carries nothing from the hidden pixels to others.
        """
        if not hidden.any() or hidden.all():
            return image
        offset, at = np.float32(CHANGE_OFFSET), np.flatnonzero(hidden)
        divisor = self.background + offset
        change = np.add(image, offset, dtype=np.float32)
        change /= divisor
        filled = fill_unknown(change, ~hidden)
        there = (np.take(one.reshape(-1, 3), at, axis=0) for one in (filled, divisor))
        levels = np.clip(np.multiply(*there) - offset, 0, 255)
        bridged = image.copy(order="C")
        bridged.reshape(-1, 3)[at] = np.rint(levels) if np.issubdtype(image.dtype, np.integer) else levels
        return bridged

    def change(self, image: Array, light: FrameLight | None = None) -> Map:
        """Color change (H, W, 3) float32; with `light`, of the image under the background's light.

        It removes room light and tilt, and divides by the gain.
        """
        return self.pending(image, light).write(np.empty(self._light.shape, dtype=np.float32))

    def light_sigma(self, light: FrameLight) -> Map | None:
        """Standard deviation (H, W) of the color change from an unsure light; None for a gain that is known."""
        if light.is_plain and light.is_known:
            return None
        sigma, size = light.change_sigma(self._blocks), self._light.shape[1::-1]
        return np.asarray(cv2.resize(sigma, size, interpolation=cv2.INTER_LINEAR), dtype=np.float32)

    def pending(self, image: Array, of_frame: FrameLight | None = None) -> PendingChange:
        """The work of `change` that precedes the pass over the pixels."""
        values, response = np.zeros((3, 4)) if of_frame is None else of_frame.values, self.settings.response
        # The light belongs to the camera's channels, so it acts before response and crosstalk are removed. Factors may wait.
        waits = self.settings.crosstalk is None and (response == 1 or not values[:, 3].any())
        if not waits and values.any():
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
    """A color change without its pass over the pixels, which runs alone or together with a color model."""

    arguments: tuple[Any, ...]  # of the kernel `color_change`, up to its work array

    @property
    def work_size(self) -> int:
        """Floats of work memory that the kernel needs: a row with its border, and the rows within a blur's reach."""
        row, radius = 3 * self.arguments[3].shape[1], len(self.arguments[5]) - 1
        whole = -(-row // LANES) * LANES
        return row + 6 * radius + LANES + (2 * radius + 1) * whole

    def write(self, out: Map) -> Map:
        """Compute the color change into `out` (H, W, 3), and return it."""
        _color_change(*self.arguments, np.empty(self.work_size, dtype=np.float32), out)
        return out


def image_from_color_change(
    color_change: ArrayLike, background: ArrayLike, settings: ChangeSettings | None = None
) -> Map:
    """The image (H, W, 3) float32, 0-255, of an unblurred color change: the inverse of `color_change_from_image`.

    Values are clipped to 0-255, as a camera would. ValueError, TypeError: a change or background of another shape, or not
    finite.
    """
    settings = _checked_settings(settings)
    untouched = check_image(background, name="background").astype(np.float32)
    change = check_values(color_change, "color_change", (3,))
    if change.shape != untouched.shape:
        raise ValueError(
            f"Expected color_change of the background's shape {untouched.shape}, got {change.shape}."
        )
    gain = gain_from_background(untouched, settings)
    # Where nothing can be divided by, the change says nothing.
    change = np.divide(change, gain, out=np.zeros_like(change), where=gain > 0)
    light = linear_light(untouched, settings) + change
    if settings.crosstalk is not None:
        light = cv2.transform(light, np.asarray(settings.crosstalk))
    light = np.clip(light, 0, 255)
    image = light if settings.response == 1 else 255 * (light / 255) ** settings.response
    return np.asarray(image, dtype=np.float32)


USUAL_FRAMES = 15  # frames at rest that are averaged where they come by themselves
MAX_BYTES = 192 * MIB  # of frames that are held at once
# Fraction of the brightness: a touched block, or a frame of another exposure, differs by more.
OTHER_LEVEL = 0.03


class Background(NamedTuple):
    """An average of frames of the gel at rest."""

    background: Map  # (H, W, 3) float32, 0-255
    noise: Numbers  # (3,) float64, standard deviation of a pixel in one frame, gray levels
    left_out: tuple[tuple[str, str], ...]  # (name, why) of each frame that is not in the average
    findings: tuple[Finding, ...]  # what is doubted of the average

    @property
    def touch(self) -> Finding | None:
        """The finding that something seems to touch the gel."""
        return next((one for one in self.findings if one.name == "background_touched"), None)


def background_from_frames(
    frames: Iterable[ArrayLike],
    *,
    untouched: ArrayLike | None = None,
    smooth: bool = False,
    names: Sequence[str] | None = None,
    max_bytes: int = MAX_BYTES,
) -> Background:
    """A robust average of frames of the gel at rest.

    Frames that differ from the median of all by a touch, a shadow or another exposure are left out. From the
    others, the highest and the lowest fifth of each pixel's values are cut off, and the rest is averaged (a trimmed mean:
    P. J. Huber and E. M. Ronchetti, Robust Statistics, 2nd edition, 2009, section 1.3).

    Parameters
    ----------
    frames : (H, W, 3) each, RGB, 0-255; taken one at a time
    untouched : (H, W, 3), 0-255, a background of the same sensor, such as the calibration's; touch, exposure and pattern of
        the average are compared with it. Without one, and without `smooth`, only the frames are compared with each other
    smooth : whether the light on such a gel is known to be smooth, as of makes with a starter; structure is a touch then
    names : names of the frames in messages; "frame 0", "frame 1", ... by default
    max_bytes : of frames that are held at once; beyond that, evenly spaced frames are kept

    Returns
    -------
    Background
        (background, noise, left_out, findings). The noise of a single frame is estimated from second differences along rows.

    Raises
    ------
    DataError
        No frame, or fewer than half agree with the median of all; then none is surely at rest.
    ValueError, TypeError
        A frame that is no RGB image, or of another size than the first.
    CalibrationError
        The average is clearly not of the sensor of `untouched`.
    """
    kept = _kept(frames, None if names is None else check_list(names, "names", str), max_bytes)
    if not kept:
        raise DataError("Expected frames of the gel at rest, got none.")
    left_out = _odd_ones(kept)
    good = [image for name, image in kept if name not in left_out]
    if 2 * len(good) <= len(kept) and len(kept) > 1:
        listed = "; ".join(f"{name}: {why}" for name, why in list(left_out.items())[:4])
        raise DataError(
            f"Expected frames of the gel at rest that agree, got {len(left_out)} of {len(kept)} that differ from "
            f"the median of all ({listed}). Take them again with nothing on the gel and the exposure fixed."
        )
    average, noise = trimmed_mean(good)
    findings: tuple[Finding, ...] = ()
    if untouched is not None:
        findings = check_own_background(
            average, check_image(untouched, shape=average.shape[:2], name="untouched")
        )
    elif smooth and (touch := touch_in(average)):
        findings = (touch.finding(),)
    return Background(average, noise, tuple(left_out.items()), findings)


def noise_from_image(image: Array) -> Numbers:
    """Standard deviation (3,) of a pixel, gray levels, from second differences along rows (robust).

    The image (H, W, 3), or the difference of two images, is smooth along rows except for its noise.
    """
    pixels = np.asarray(image, dtype=np.float32)
    second = pixels[:, 2:] - 2 * pixels[:, 1:-1] + pixels[:, :-2]
    middle = np.median(np.abs(second), axis=(0, 1)).astype(np.float64)
    return np.asarray(SIGMA_OF_MEDIAN * middle / np.sqrt(6), dtype=np.float64)


def _kept(
    frames: Iterable[ArrayLike], names: Sequence[str] | None, max_bytes: int
) -> list[tuple[str, Array]]:
    """Every k-th frame; k is doubled each time the frames would exceed `max_bytes`."""
    kept: list[tuple[str, Array]] = []
    stride = 1
    if not isinstance(frames, Iterable) or isinstance(frames, (str, bytes, Mapping)):
        raise TypeError(f"Expected frames as several images (H, W, 3), got {type(frames).__name__}.")
    for number, frame in enumerate(frames):
        if number % stride:
            continue
        image = check_image(frame, shape=kept[0][1].shape[:2] if kept else None, name="frame")
        if names is not None and number >= len(names):
            raise ValueError(f"Expected a name for each frame, got {len(names)} names for more frames.")
        kept.append((names[number] if names is not None else f"frame {number}", image.copy()))
        if len(kept) > 8 and sum(one.nbytes for _, one in kept) > max_bytes:
            kept, stride = kept[::2], 2 * stride
    return kept


def _odd_ones(kept: Sequence[tuple[str, Array]]) -> dict[str, str]:
    """Names of the frames that differ from the median of all, with the reason."""
    blocks = np.stack([block_means(image) for _, image in kept])
    middle = np.median(blocks, axis=0)
    odd = {}
    for (name, _), own in zip(kept, blocks):
        gain = np.median((own + 1) / (middle + 1), axis=(0, 1))
        off = np.abs(own - gain * middle)
        noise = SIGMA_OF_MEDIAN * np.median(off, axis=(0, 1))
        # A block is touched if it is off by 3 % of its level, 1.5 gray levels and 6 sigma of noise.
        touched = (off > OTHER_LEVEL * middle + 1.5 + 6.0 * noise).any(axis=-1).mean()
        brighter = float(gain[np.argmax(np.abs(gain - 1))] - 1)
        if touched > 0.01:
            odd[name] = f"{100 * touched:.1f} % of it differs, by a touch or a shadow"
        elif abs(brighter) > OTHER_LEVEL:
            odd[name] = f"another exposure, {100 * brighter:+.0f} %"
    return odd


def trimmed_mean(images: Sequence[Array]) -> tuple[Map, Numbers]:
    """Mean of frames without the highest and the lowest fifth of each pixel's values, and their noise (3,), gray levels.

    No frame is left out; it is for frames that are known to be at rest.
    """
    if len(images) == 1:
        return images[0].astype(np.float32), noise_from_image(images[0])
    cut = int(0.2 * len(images))
    rows = max(1, 32 * MIB // (len(images) * images[0][0].nbytes))  # that are sorted at once, in 32 MiB
    average = np.empty(images[0].shape, dtype=np.float32)
    variances = []
    for first in range(0, len(average), rows):
        stack = np.sort(np.stack([image[first : first + rows] for image in images]), axis=0)
        average[first : first + rows] = stack[cut : len(images) - cut].mean(axis=0, dtype=np.float64)
        variances.append(stack.var(axis=0, ddof=1, dtype=np.float64).reshape(-1, 3))
    variance = np.sort(np.concatenate(variances), axis=0)
    # One pixel in a hundred may flicker, such as a fiber or an edge that trembles.
    return average, np.sqrt(variance[: max(1, int(0.99 * len(variance)))].mean(axis=0))


def surround_of(background: Array) -> Mask | None:
    """Pixels (H, W) outside the gel in a background image (H, W, 3): dark, and joined to its border; None without any."""
    strongest = np.asarray(background, dtype=np.float32).max(axis=-1)
    # The darkest corners of six real sensors have over 0.25 of the image's light.
    dark = strongest < max(DARK, 0.15 * float(np.percentile(strongest, 95)))
    _, labels = cv2.connectedComponents(dark.astype(np.uint8))
    at_border = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    outside = np.isin(labels, np.setdiff1d(at_border, 0))
    return outside if outside.mean() > 0.03 else None  # a smaller surround costs no press


def surround_finding(background: Array, remedy: str, *, viewed: bool = False) -> Finding | None:
    """The finding that a background image (H, W, 3) shows more than the gel; `{}` in the remedy is the crop that fits.

    Of an image that is already a view of the frame (`viewed`), the crop is not one of the frame, and the view is named.
    """
    outside = surround_of(background)
    if outside is None:
        return None
    crop = "a smaller crop in the [view] of sensor.toml"
    if not viewed:
        crop = remedy.format(",".join(map(str, crop_inside(outside))))
    message = (
        f"{100 * outside.mean():.0f} % of the image are outside the gel: dark, and joined to its border. Leave them out: "
        f"{crop}. If the camera sees the gel at an angle, undo that too: gelform lens."
    )
    return Finding("dark_surround", message, float(outside.mean()))


def crop_inside(outside: Mask) -> tuple[int, int, int, int]:
    """(left, top, width, height) of the largest rectangle, px, that is free of `outside` (H, W) and of its blurred edge.

    It is made up of whole blocks, 48 along the shorter side.
    """
    side = -(-min(outside.shape) // 48)
    rows, columns = (count // side for count in outside.shape)
    near = cv2.dilate(outside.astype(np.uint8), np.ones((5, 5), dtype=np.uint8))
    free = near[: rows * side, : columns * side].reshape(rows, side, columns, side).max(axis=(1, 3)) == 0
    area, best = 0, (0, 0, 0, 0)
    for top in range(rows):
        open_ = np.ones(columns, dtype=bool)
        for bottom in range(top, rows):
            open_ &= free[bottom]
            ends = np.flatnonzero(np.concatenate([[True], ~open_, [True]]))
            widths = np.diff(ends) - 1
            widest = int(widths.argmax())
            height, width = bottom + 1 - top, int(widths[widest])
            if height * width > area:
                area = height * width
                best = (int(ends[widest]) * side, top * side, width * side, height * side)
    return best
