"""Checks that a background belongs to an image, to a set of frames, and to the calibrated sensor; with figures."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, log
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform._native import Kernel
from gelform.errors import CalibrationError
from gelform.foundations.checks import check_image
from gelform.foundations.findings import Finding
from gelform.image.background.light import (
    FrameLight,
    block_means,
    gain_from_blocks,
    light_from_blocks,
    without_light,
)
from gelform.image.background.orientation import (
    UNLIKE,
    Orientation,
    largest_touch,
    orientation_from_blocks,
    orientation_from_image,
)
from gelform.image.frame import pixels_digest

# Gain of the brightness: outside the first range a new background is requested, outside the second the image is refused.
RATIO_WARN, RATIO_REFUSE = (0.9, 1.1), (0.7, 1.4)
# Fraction of the brightness, and gray levels of room light; a smaller difference is compensated without a finding.
GAIN_REPORTED, ROOM_REPORTED = 0.02, 3.0
SURE_SIGMAS = 3.0  # standard deviations by which tilt and room light exceed these: 0.1 % of false alarms
CORRELATION_REFUSE = (
    0.8  # smallest correlation over pixels at rest; with less, an image is another sensor's, or shifted
)
# Fractions of the brightness: half of an image differs by more than the first for a warning, the second for a refusal.
PATTERN_WARN, PATTERN_REFUSE = 0.02, 0.053
# Fraction of a background image in one region that no light explains: two moments at rest 0.015 or less (223 pairs of a
# Mini, a wedge and a DIGIT), presses 0.033 or more on six sensors and 0.014-0.05 on a GelSlim.
TOUCHED_SHARE = 0.025
TOUCHED_IN_CONTACT = 0.015  # the same where the calibration shows contact
TOUCHED_FRACTION = 0.4  # fraction of an image that the correlation leaves out
OTHER_SENSOR = "The calibration is not of the sensor that took this background"
OWN_CALIBRATION = (
    "If frames agree with this background, no new one helps: use this sensor's own calibration. If it is the same unit, its "
    "gel or lights have moved, so calibrate again."
)
MIN_FRAMES = (
    8  # smallest number of frames, each touched elsewhere, whose median is nearly the background image
)

_least_changed_sums = Kernel(
    "least_changed_sums",
    "f32[n,3] seen, f32[n,3] untouched, f32[3] scale, i64 last, out f32[m] work, out f64[3] sums",
)


def check_background(image: NDArray[Any], background: NDArray[Any]) -> tuple[Finding, ...]:
    """Refuse a background that does not belong to this image; return findings.

    Where nothing touches, the image should be the background times a gain near 1.

    CalibrationError: the image is mirrored, turned or BGR, a channel's gain is outside 0.7-1.4, or the correlation is under
    0.8. The message has the figure.
    """
    return compared(block_means(image), block_means(background))[1]


def check_own_background(background: NDArray[Any], calibrated: NDArray[Any]) -> tuple[Finding, ...]:
    """Refuse a background image that is not of the calibrated sensor; return findings.

    It goes beyond `check_background`: both images show the gel at rest, so that they should be equal everywhere, up to
    a gain for each channel. Another unit of the same model passes every other check.

    CalibrationError: as `check_background`, half of the image differs by more than 5.3 %, or something touches the gel. The
    message has the figure.
    """
    today, untouched = block_means(background), block_means(calibrated)
    compared(today, untouched, own=True)
    gain = gain_from_blocks(today, untouched)
    differs = gain.middle_pattern
    if np.isfinite(differs) and differs > PATTERN_REFUSE:
        raise CalibrationError(
            f"{OTHER_SENSOR}: after a common gain ({_times(gain.gain)}), half of the background given differs from the "
            f"calibration's by {100 * differs:.1f} % or more (expected under {100 * PATTERN_REFUSE:g} %). {OWN_CALIBRATION}"
        )
    check_untouched(background, calibrated)
    findings = list(_exposure_findings(gain))
    if np.isfinite(differs) and differs > PATTERN_WARN:
        message = (
            f"Today's background differs from the calibration's by {100 * differs:.1f} % after a common gain. "
            "The gel or a light may have moved."
        )
        findings.append(Finding("background_pattern", message, differs))
    return tuple(findings)


def check_untouched(
    background: NDArray[Any], calibrated: NDArray[Any], contact: NDArray[np.bool_] | None = None
) -> None:
    """Refuse a background image in which something touches the gel, compared with the calibration's.

    Parameters
    ----------
    background, calibrated : (H, W, 3), 0-255
    contact : (H, W), where the calibration shows contact in it; a smaller difference there is enough

    Raises
    ------
    CalibrationError
        The message has the place and the share.
    """
    touch = largest_touch(block_means(background), block_means(calibrated))
    x, y = (int(part * size) for part, size in zip(touch.center, background.shape[1::-1]))
    least = TOUCHED_SHARE if contact is None or not contact[y, x] else TOUCHED_IN_CONTACT
    if touch.share > least:
        raise CalibrationError(
            f"Something touches the gel in this background image, about ({x}, {y}) px: {100 * touch.share:.1f} % of it "
            "differ from the calibration's as no light does. Take it again, with nothing touching the gel. If the gel is "
            "damaged there, calibrate again."
        )


def check_background_of_frames(
    frames: Sequence[NDArray[Any]], background: NDArray[Any]
) -> tuple[Finding, ...]:
    """Refuse a background that is not of the sensor that took the frames; return findings.

    Each frame is touched, at another place. Therefore the blocks' median over eight frames or more is nearly the background
    image; fewer frames are not checked.

    CalibrationError: the quarter that changed least differs by more than 3.6 %, and half by more than 5.3 %.
    """
    if len(frames) < MIN_FRAMES:
        return ()
    middle = np.median([block_means(frame) for frame in frames], axis=0).astype(np.float32)
    light = gain_from_blocks(middle, block_means(background))
    if light.share and light.least_pattern > UNLIKE and light.middle_pattern > PATTERN_REFUSE:
        raise CalibrationError(
            f"The background is not of these images. After a common gain ({_times(light.gain)}), a quarter of "
            f"their median differs by {100 * light.least_pattern:.1f} % or more, and half by "
            f"{100 * light.middle_pattern:.1f} % (expected under {100 * UNLIKE:g} and "
            f"{100 * PATTERN_REFUSE:g} %). Take a background with the same sensor, just before the presses."
        )
    if not PATTERN_WARN < light.middle_pattern < inf:
        return ()
    message = (
        f"After a common gain ({_times(light.gain)}), half of the presses' median differs from the background by "
        f"{100 * light.middle_pattern:.1f} % or more (usual: under {100 * PATTERN_WARN:g} %). Light or gel have "
        "drifted, or most presses touch the same place. Depth off contact is wrong by as much. Take a background just "
        "before the presses."
    )
    return (Finding("background_drift", message, light.middle_pattern),)


def background_digest(background: NDArray[Any]) -> str:
    """SHA-256 of the pixels of a background image, by which a calibration recognizes its own."""
    return pixels_digest(np.asarray(background, dtype="<f4"))


def compared(
    image: NDArray[np.float32],
    untouched: NDArray[np.float32],
    usual: FrameLight | None = None,
    own: bool = False,
) -> tuple[FrameLight, tuple[Finding, ...]]:
    """Light and findings of an image compared with the background image, as in `light_from_blocks`.

    `own`: the image is today's background, and `untouched` the calibration's; an error then blames the calibration.
    """
    light = light_from_blocks(image, untouched, usual)
    if light.least_change > UNLIKE:
        _refuse_gray(image, untouched)
        check_upright(orientation_from_blocks(image, untouched))
    _refuse_unlike(light, _correlation(image, untouched, light), own)
    # The light of another unit of the make is not far from a tilt.
    pattern = light.least_pattern if light.tilt.any() else light.least_change
    return light, (*_light_findings(light), *_pattern_findings(pattern))


def check_viewed_image(
    background: NDArray[np.float32],
    frame_shape: tuple[int, int] | None,
    image: ArrayLike,
    name: str = "image",
) -> NDArray[Any]:
    """Return an RGB image of the background's size, as `check_image` does; the error says if it is a frame.

    ValueError, TypeError: as `check_image`. CalibrationError: the image lies on its side.
    """
    shape = background.shape[:2]
    try:
        return check_image(image, shape=shape, name=name)
    except ValueError as problem:
        got = getattr(image, "shape", ())[:2]
        if got == shape[::-1] != shape:
            check_upright(orientation_from_image(check_image(image, name=name), background))
        if got != frame_shape or frame_shape == shape:
            raise
        hint = "It has the size of the camera's frames: image_from_frame(frame, calibration.view) first."
        raise ValueError(f"{problem} {hint}") from None


def check_upright(orientation: Orientation | None) -> None:
    """Raise a CalibrationError that names how an image lies, if it is known and not as the background image does."""
    if orientation is not None and not orientation.is_upright:
        raise CalibrationError(
            f"The image is {orientation.named} compared with the background: so it fits it best of 16 readings. Undo it "
            f"where images are read: {orientation.remedy}."
        )


def _refuse_gray(image: NDArray[np.float32], untouched: NDArray[np.float32]) -> None:
    if np.ptp(image, axis=-1).max() == 0 < np.ptp(untouched, axis=-1).max():
        raise CalibrationError(
            "The image is gray: red, green and blue are equal everywhere, and in the background they are not. Slopes are "
            "read from colors, so read the camera's frames in color."
        )


def _refuse_unlike(light: FrameLight, correlation: float | None, own: bool) -> None:
    what, than = (
        (OTHER_SENSOR, "the calibration's")
        if own
        else ("The background is not of this image", "the background")
    )
    gains = light.gain.tolist()
    if min(gains) < RATIO_REFUSE[0] or max(gains) > RATIO_REFUSE[1]:
        remedy = (
            f"{OWN_CALIBRATION} Or set exposure and white balance as they were at calibration."
            if own
            else "Take a new background with the same exposure, white balance and lights."
        )
        raise CalibrationError(
            f"{what}: pixels at rest are {_times(light.gain)} times as bright as in {than} "
            f"(expected {RATIO_REFUSE[0]}-{RATIO_REFUSE[1]}). {remedy}"
        )
    if correlation is not None and correlation < CORRELATION_REFUSE:
        raise CalibrationError(
            f"{what}: the two correlate by {correlation:.2f} on pixels at rest (expected {CORRELATION_REFUSE} or more). "
            + (OWN_CALIBRATION if own else "Is it of another sensor, or shifted?")
        )


def _light_findings(light: FrameLight) -> tuple[Finding, ...]:
    findings = (*_exposure_findings(light), *room_light_finding(light))
    tilt = abs(_sure(light.tilt, light.covariance[:, [1, 2], [1, 2]], GAIN_REPORTED))
    if not tilt:
        return findings
    message = (
        f"The light is tilted by up to {100 * tilt:.0f} % between the middle and a border, as if a lamp had moved. gelform "
        "compensates it."
    )
    return (*findings, Finding("tilted_light", message, tilt))


def room_light_finding(light: FrameLight) -> tuple[Finding, ...]:
    """Find `room_light`: light added to all channels; figure: gray levels, of the channel that changed most.

    The sensor's own light multiplies the background image. Light from outside is added to it, in dark places too.
    """
    room = _sure(light.room, light.covariance[:, 3, 3], ROOM_REPORTED)
    message = (
        f"Room light changes the colors by up to {room:+.0f} gray levels. gelform removes it. Shade the gel."
    )
    return (Finding("room_light", message, room),) if room else ()


def _sure(values: NDArray[np.float64], variances: NDArray[np.float64], least: float) -> float:
    """The value that exceeds `least` most clearly; 0 if none does by `SURE_SIGMAS`."""
    over = np.abs(values) - SURE_SIGMAS * np.sqrt(variances)
    at = np.unravel_index(over.argmax(), over.shape)
    return float(values[at]) if over[at] > least else 0.0


def _exposure_findings(light: FrameLight) -> tuple[Finding, ...]:
    if not light.share:
        message = "gelform cannot compare the exposure: every part of the image is too dark in some channel, or saturated."
        return (Finding("exposure_unknown", message, 0.0),)
    if not light.is_known:
        message = (
            f"gelform cannot tell the exposure well, because {100 * light.share:.0f} % of the image is at rest. "
            "The slopes' sigma contains what an unknown exposure does."
        )
        return (Finding("exposure_unknown", message, light.share),)
    gains = light.gain.tolist()
    largest = max(gains, key=lambda one: abs(log(one)))
    if min(gains) < RATIO_WARN[0] or max(gains) > RATIO_WARN[1]:
        message = f"Pixels at rest are {_times(light.gain)} times as bright as in the background. Take a new background."
        return (Finding("background_ratio", message, largest),)
    if abs(largest - 1) > GAIN_REPORTED:
        percents = ", ".join(f"{name} {100 * (one - 1):+.0f} %" for name, one in zip("RGB", gains))
        message = f"The exposure differs from the background's by {percents}. gelform compensates it."
        return (Finding("exposure", message, largest),)
    return ()


def _pattern_findings(least: float) -> tuple[Finding, ...]:
    if not UNLIKE < least < inf:
        return ()
    message = (
        f"Even the quarter of the image that changed least differs from the background by {100 * least:.1f} %. Either a "
        "contact fills the image, or the calibration or background is of another sensor."
    )
    return (Finding("background_differs", message, least),)


def _times(gain: NDArray[np.float64]) -> str:
    return ", ".join(f"{name} {value:.2f}" for name, value in zip("RGB", gain))


def _correlation(
    image: NDArray[np.float32], untouched: NDArray[np.float32], light: FrameLight
) -> float | None:
    """Correlation, without the light, over all blocks but the `TOUCHED_FRACTION` that changed most, channels together.

    None if the background image is featureless, so that nothing can correlate with it. 0 if only the image is featureless.
    """
    blocks = image.size // 3
    if light.is_plain:
        scale = (1 / light.gain).astype(np.float32)
    else:
        image, scale = without_light(image, light.values), np.ones(3, dtype=np.float32)
    last = min(int((1 - TOUCHED_FRACTION) * blocks), blocks - 1)
    sums, work = np.empty(3), np.empty(2 * blocks, dtype=np.float32)
    count = _least_changed_sums(image.reshape(-1, 3), untouched.reshape(-1, 3), scale, last, work, sums)
    of_image, of_untouched, of_both = sums.tolist()
    if of_untouched < 1e-4 * count:
        return None
    return of_both / (of_image * of_untouched) ** 0.5 if of_image >= 1e-4 * count else 0.0
