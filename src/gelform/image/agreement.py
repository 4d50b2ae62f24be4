"""Whether a background belongs to an image, to a set of frames and to the sensor; and how an image lies.

48 readings of an image compete: eight orientations (mirrored, turned), each with six orders of the channels. In the
right one the image is the background times a smooth light, but for what touches the gel. In a wrong one the lamps shine
from elsewhere, and no light near the usual one explains it. So each reading is scored by its evidence (Bishop, Pattern
Recognition and Machine Learning, 2006, section 3.4): a light is fitted, a polynomial with a prior, and blocks that it does
not explain count as touched.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations
from math import inf, log
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike

from gelform.arrays import Array, Image, Map, Mask, Numbers
from gelform.errors import CalibrationError, Finding
from gelform.foundations.checks import check_image
from gelform.foundations.filters import CHANGE_OFFSET
from gelform.image.light import (
    ALIKE,
    LIGHT_SIGMAS,
    MARGIN,
    REST_SIGMA,
    TOUCHED_SIGMA,
    FrameLight,
    block_means,
    gain_from_blocks,
    light_from_blocks,
)
from gelform.image.markers import MarkerFollower
from gelform.image.view import BRIGHT, DARK, pixels_digest, scale_of

# Fraction of the brightness by which all but a quarter of an image differs, if it lies otherwise: 0.048 or more on six
# sensors. Frames that lie as the background differ by up to 0.036.
UNLIKE = 0.036


# Whether rows and columns are exchanged, and the flip then: in words, and the view's flip and turn that undo it.
LYING = {
    (False, "none"): ("", "none", "none"),
    (False, "x"): ("mirrored left to right", "x", "none"),
    (False, "y"): ("mirrored top to bottom", "y", "none"),
    (False, "xy"): ("turned by 180 degrees", "xy", "none"),
    (True, "none"): ("turned by 90 degrees and mirrored", "y", "right"),
    (True, "x"): ("turned by 90 degrees counter-clockwise", "none", "right"),
    (True, "y"): ("turned by 90 degrees clockwise", "none", "left"),
    (True, "xy"): ("turned by 90 degrees and mirrored", "x", "right"),
}


class Orientation(NamedTuple):
    """A reading of an image."""

    flip: str  # "none", "x" (left and right exchanged), "y" (top and bottom), "xy"
    transposed: bool  # whether rows and columns are exchanged, before the flip is undone
    order: str = "RGB"  # of the channels as they are stored

    @property
    def is_upright(self) -> bool:
        """Whether nothing is exchanged."""
        return self == UPRIGHT

    @property
    def named(self) -> str:
        """What is exchanged, in words: "BGR", "mirrored left to right", "turned by 90 degrees and BGR"."""
        words = LYING[self.transposed, self.flip][0], "" if self.order == "RGB" else self.order
        return " and ".join(filter(None, words))

    @property
    def remedy(self) -> str:
        """What undoes it: the view's flip and turn, and the order of the channels."""
        _, flip, turn = LYING[self.transposed, self.flip]
        words = [f'{name} "{value}"' for name, value in (("flip", flip), ("turn", turn)) if value != "none"]
        parts = [f"the view's {' and '.join(words)}"] if words else []
        if self.order == "BGR":
            parts.append("red and blue exchanged (--bgr)")
        elif self.order != "RGB":
            parts.append(f"the channels, which are stored as {self.order}, put in the order RGB")
        return ", and ".join(parts)

    def undone(self, image: Array) -> Array:
        """The image (H, W, 3) as it should be."""
        upright = image.transpose(1, 0, 2) if self.transposed else image
        upright = upright[:: -1 if "y" in self.flip else 1, :: -1 if "x" in self.flip else 1]
        return np.ascontiguousarray(upright[..., [self.order.index(one) for one in "RGB"]])


USUAL_ORDERS = ("RGB", "BGR")
READINGS = tuple(
    Orientation(flip, transposed, "".join(order))
    for transposed, flip in LYING
    for order in permutations("RGB")
)
UPRIGHT = READINGS[0]


def orientation_from_image(image: Array, background: Array) -> Orientation | None:
    """How an image (H, W, 3) or (W, H, 3), 0-255, lies compared with a background image (H, W, 3).

    None if it cannot be told: the lights are alike from all sides, or the image is of another sensor.
    """
    return orientation_from_blocks(block_means(image), block_means(background))


def orientation_if_doubtful(image: Array, background: Array) -> Orientation | None:
    """`orientation_from_image` of an image of which not even a quarter is as in the background image; else None.

    It is the cheap question first: no image of six sensors that lies otherwise agrees by so much.
    """
    blocks, untouched = block_means(image), block_means(background)
    if gain_from_blocks(blocks, untouched).least_change <= UNLIKE:
        return None
    return orientation_from_blocks(blocks, untouched)


def orientation_from_blocks(image: Map, untouched: Map) -> Orientation | None:
    """`orientation_from_image` for images averaged by `block_means`."""
    shape = untouched.shape[:2]
    fitting = [
        one for one in READINGS if shape == (image.shape[1::-1] if one.transposed else image.shape[:2])
    ]
    if not fitting:
        return None
    change, lit = _log_change(np.stack([one.undone(image) for one in fitting]), untouched)
    if not lit.any():
        return None
    terms, prior = of_place = _terms(shape)
    share = ALIKE / np.maximum(lit.sum(axis=1), 1)
    light, normal = _fitted_light(change, lit, of_place)
    left = change - terms @ light
    explained = np.where(lit, np.logaddexp(*_log_likelihoods(left)), 0).sum(axis=1) * share
    apart = (prior[None, :, None] * light**2).sum(axis=(1, 2)) / 2
    narrowed = np.linalg.slogdet(normal)[1] - np.log(prior).sum()
    unusual = np.array([one.order not in USUAL_ORDERS for one in fitting])
    # Of each reading, in nats; few programs exchange other channels than red and blue.
    evidence = explained - apart - 3 / 2 * narrowed - MARGIN * unusual  # 3 channels
    order = np.argsort(evidence)[::-1]
    first = evidence[order[0]]
    unexplained = float(ALIKE * _log_likelihoods(change[lit])[1].mean())  # if no reading explains the image
    others = max(evidence[order[1]], unexplained)
    # It fits if a quarter of the image is as in the background: 0.02 or less in the right reading of six sensors, while a
    # negative, whose best reading may be a wrong one, has 0.22.
    fits = np.quantile(np.linalg.norm(left[order[0]][lit[order[0]]], axis=-1), 0.25) <= UNLIKE
    return fitting[order[0]] if fits and first - others > MARGIN else None


class SuspectedTouch(NamedTuple):
    """What looks like a touch in an image."""

    x_px: int
    y_px: int
    energy: float  # RMS of the image's logarithm there, between the scales of noise and of light
    ratio: float  # energy over the image's median

    def finding(self, what: str = "smooth light") -> Finding:
        """The finding `background_touched` about a background image; `what` it was compared with."""
        seen = f"it has {self.ratio:.1f} times as much structure as elsewhere, compared with {what}"
        return touched_finding((self.x_px, self.y_px), seen, self.ratio)


def touched_finding(place_px: tuple[int, int], seen: str, figure: float) -> Finding:
    """The finding `background_touched`, about a place (x, y) in a background image and what is seen there."""
    message = (
        f"Something seems to touch the gel in the background image, about ({place_px[0]}, {place_px[1]}) px: there {seen}. "
        "Depth is relative to it. Take it again, with nothing touching the gel. A gel that is scratched, dirty or marked "
        "there looks the same."
    )
    return Finding("background_touched", message, figure)


# px at 240 rows, standard deviations of the Gaussians between which an object has structure: noise is finer, light coarser.
FINE_PX, COARSE_PX = 3.0, 12.0
# Highest of gels at rest: energy of 53 images of eight units 0.064, of 320 differences of moments of two units 0.061; ratio
# of images 2.4, of differences 5.4. Half of a press (70 of Minis and DIGITs) exceeds one of them in 97 % of them.
TOUCHED_ENERGY, TOUCHED_RATIO, TOUCHED_RATIO_OF_CHANGE = 0.07, 2.5, 6.0


def touch_in(image: Array, untouched: Array | None = None) -> SuspectedTouch | None:
    """The place in an image of gel at rest (H, W, 3), 0-255, where something seems to touch it; None without one.

    The light on gel at rest is smooth, and a touch has structure that light has not. So the energy of the logarithm
    between two scales is compared with its median over the image: no exposure, unit or make enters. `untouched` is another
    image of the same gel at rest; then the change between both is looked at, which shows fainter touches. Objects without
    an edge in sight, and those in the outer eighth of the image, are not found.
    """
    factor, image = _reduced(image)
    if untouched is None:
        energy, least = structure(_log(image)), TOUCHED_RATIO
    else:
        energy, least = structure(_log(image) - _log(_reduced(untouched)[1])), TOUCHED_RATIO_OF_CHANGE
    (height, width), (top, left) = energy.shape, (n // 8 for n in energy.shape)
    # Nearer to the border the blurs see its mirror image.
    inner = energy[top : height - top, left : width - left]
    y, x = np.unravel_index(int(inner.argmax()), inner.shape)
    most = float(inner[y, x])
    x_px, y_px = (factor * (int(at) + before) + factor // 2 for at, before in ((x, left), (y, top)))
    found = SuspectedTouch(x_px, y_px, most, most / max(float(np.median(inner)), 1e-9))
    # What is less than two images at rest differ by is noise, which is more where the light is weak.
    if most < REST_SIGMA or (most < TOUCHED_ENERGY and found.ratio < least):
        return None
    # Markers have structure at rest, too.
    return None if untouched is None and len(MarkerFollower(image)) else found


def touch_in_first(image: Array, untouched: Array) -> SuspectedTouch | None:
    """`touch_in`, if the image itself, not `untouched`, has the structure; both are (H, W, 3), 0-255."""
    found = touch_in(image, untouched)
    if found is None:
        return None
    of_both = [_reduced(one) for one in (image, untouched)]
    own, other = (structure(_log(one))[found.y_px // factor, found.x_px // factor] for factor, one in of_both)
    return found if own > other else None


def _reduced(image: Array) -> tuple[int, Array]:
    """How many times fewer rows and columns, and the image (H, W, 3) with 240 to 479: what is finer is noise here."""
    factor = max(1, int(scale_of(image.shape)))
    if factor == 1:
        return 1, image
    size = image.shape[1] // factor, image.shape[0] // factor
    return factor, np.asarray(cv2.resize(np.asarray(image, np.float32), size, interpolation=cv2.INTER_AREA))


def _log(image: Array) -> Map:
    smooth = cv2.GaussianBlur(
        np.asarray(image, dtype=np.float32), (0, 0), FINE_PX / 2 * scale_of(image.shape)
    )
    return np.log(smooth + np.float32(CHANGE_OFFSET))


def structure(log: Map) -> Map:
    """Root of the local energy (H, W) of an image's logarithm (H, W, 3) between the scales of noise and of light."""
    fine, coarse = (cv2.GaussianBlur(log, (0, 0), px * scale_of(log.shape)) for px in (FINE_PX, COARSE_PX))
    square = np.square(fine - coarse).sum(axis=-1)
    return np.sqrt(cv2.GaussianBlur(square, (0, 0), COARSE_PX * scale_of(log.shape)))


def _log_change(images: Map, untouched: Map) -> tuple[Numbers, Mask]:
    """Log ratios (n, N, 3) of images (n, h, w, 3) to the background (h, w, 3), and the blocks (n, N) lit in both."""
    read, background = images.reshape(len(images), -1, 3), untouched.reshape(1, -1, 3)
    lit = np.all((background > DARK) & (background < BRIGHT) & (read > DARK) & (read < BRIGHT), axis=-1)
    return np.log((read + CHANGE_OFFSET) / (background + CHANGE_OFFSET)).astype(np.float64), lit


def _terms(shape: tuple[int, int]) -> tuple[Numbers, Numbers]:
    """Monomials (N, 10) of the place in blocks (h, w), and the weights (10,) of their prior."""
    y, x = (np.linspace(-1, 1, n) for n in shape)
    across, down = (part.ravel() for part in np.meshgrid(x, y))
    powers = [(i, j) for i in range(len(LIGHT_SIGMAS)) for j in range(len(LIGHT_SIGMAS) - i)]
    terms = np.stack([across**i * down**j for i, j in powers], axis=1)
    return terms, np.array([LIGHT_SIGMAS[i + j] ** -2 for i, j in powers])


def _fitted_light(change: Numbers, lit: Mask, of_place: tuple[Numbers, Numbers]) -> tuple[Numbers, Numbers]:
    """Coefficients (readings, 10, 3) of the light that explains most blocks, and their inverse covariance."""
    terms, prior = of_place
    share = ALIKE / np.maximum(lit.sum(axis=1), 1)
    products = (terms[:, :, None] * terms[:, None, :]).reshape(len(terms), -1)
    light = np.zeros((len(change), terms.shape[1], 3))
    light[:, 0] = [np.median(one[chosen], axis=0) if chosen.any() else 0 for one, chosen in zip(change, lit)]
    for _ in range(6):  # rounds, each with the touched blocks of the last
        sides = _log_likelihoods(change - terms @ light)
        weight = lit * np.exp(sides[0] - np.logaddexp(*sides)) * share[:, None] / REST_SIGMA**2
        normal = (weight @ products).reshape(len(change), *2 * (terms.shape[1],)) + np.diag(prior)
        # definite by the prior
        light = np.linalg.solve(normal, terms.T @ (weight[..., None] * change))
    return light, normal


def _log_likelihoods(residual: Numbers) -> list[Numbers]:
    """Of blocks at rest and of touched ones, each half of all, from their residuals (..., 3)."""
    square = (residual**2).sum(axis=-1)
    return [-square / (2 * sigma**2) - 3 * np.log(sigma) for sigma in (REST_SIGMA, TOUCHED_SIGMA)]


# Gain of the brightness, or its inverse: below the first a new background is requested, below the second it is refused.
RATIO_WARN, RATIO_REFUSE = 0.9, 0.7
# Fraction of the brightness, and gray levels of room light; a smaller difference is compensated without a finding.
GAIN_REPORTED, ROOM_REPORTED = 0.02, 3.0
# Smallest correlation over pixels at rest; with less, an image is another sensor's, or shifted.
CORRELATION_REFUSE = 0.8
# Fractions of the brightness: half of an image differs by more than the first for a finding, half of the presses' median by
# more than the second for a refusal.
PATTERN_WARN, PATTERN_REFUSE = 0.02, 0.053
OTHER_SENSOR = "The calibration is not of the sensor that took this background"
OWN_CALIBRATION = (
    "If frames agree with this background, no new one helps: use this sensor's own calibration. If it is the same unit, its "
    "gel or lights have moved, so calibrate again."
)


def check_own_background(background: Array, calibrated: Array) -> tuple[Finding, ...]:
    """Refuse a background image that is clearly not of the calibrated sensor; return findings.

    It goes beyond `compared`: both images show the gel at rest, so that they should be equal everywhere, up to a gain for
    each channel. A touch, another unit of the make and a gel that has moved are doubts, which findings name.

    CalibrationError: as `compared`.
    """
    today, untouched = block_means(background), block_means(calibrated)
    compared(today, untouched, own=True)
    gain = gain_from_blocks(today, untouched)
    differs = gain.middle_pattern
    findings = list(_exposure_findings(gain, "the calibration's", remedy=""))
    if touch := touch_in(background, calibrated):
        findings.append(touch.finding("the calibration's"))
    if PATTERN_WARN < differs < inf:
        message = (
            f"Today's background differs from the calibration's by {100 * differs:.1f} % after a common gain "
            f"({_times(gain.gain)}): half of it by more. The gel or a light has moved, objects touch the gel, or it "
            f"is another unit. {OWN_CALIBRATION}"
        )
        findings.append(Finding("background_pattern", message, differs))
    return tuple(findings)


def check_background_of_frames(frames: Sequence[Array], background: Array) -> tuple[Finding, ...]:
    """Refuse a background that is not of the sensor that took the frames; return findings.

    Each frame is touched, at another place. Therefore the blocks' median over eight frames or more is nearly the background
    image; fewer frames are not checked.

    CalibrationError: the quarter that changed least differs by more than 3.6 %, and half by more than 5.3 %.
    """
    if len(frames) < 8:
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


def background_digest(background: Array) -> str:
    """SHA-256 of the pixels of a background image, by which a calibration recognizes its own."""
    return pixels_digest(np.asarray(background, dtype="<f4"))


def compared(
    image: Map,
    untouched: Map,
    usual: FrameLight | None = None,
    pixels: Image | None = None,
    own: bool = False,
) -> tuple[FrameLight, tuple[Finding, ...]]:
    """Light and findings of an image compared with the background image, with the arguments of `light_from_blocks`.

    Where nothing touches, the image should be the background times a gain near 1. CalibrationError: the image is mirrored,
    turned or BGR, a channel's gain is outside 0.7-1.4, or the correlation is under 0.8; the message has the figure.
    `own`: the image is today's background, and `untouched` the calibration's; the error then blames the calibration.
    """
    light = light_from_blocks(image, untouched, usual, pixels)
    if light.least_change > UNLIKE:
        if np.ptp(image, axis=-1).max() == 0 < np.ptp(untouched, axis=-1).max():
            raise CalibrationError(
                "The image is gray: red, green and blue are equal everywhere, and in the background they are not. Slopes "
                "are read from colors, so read the camera's frames in color."
            )
        check_upright(orientation_from_blocks(image, untouched))
    _refuse_unlike(light, own)
    findings = [*_exposure_findings(light), *room_light_finding(light)]
    tilted = not light.is_plain and _sure(light.tilt, light.covariance[:, [1, 2], [1, 2]], GAIN_REPORTED)
    if tilt := abs(tilted):
        message = (
            f"The light is tilted by up to {100 * tilt:.0f} % between the middle and a border, as if a lamp had moved. "
            "gelform compensates it."
        )
        findings.append(Finding("tilted_light", message, tilt))
    # The light of another unit of the make is not far from a tilt.
    least = light.least_pattern if not light.is_plain and light.tilt.any() else light.least_change
    if UNLIKE < least < inf:
        message = (
            f"Even the quarter of the image that changed least differs from the background by {100 * least:.1f} %. Either a "
            "contact fills the image, or the calibration or background is of another sensor."
        )
        findings.append(Finding("background_differs", message, least))
    return light, tuple(findings)


def check_viewed_image(
    background: Map, frame_shape: tuple[int, int] | None, image: ArrayLike, name: str = "image"
) -> Array:
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
            f"The image is {orientation.named} compared with the background: so it fits it best of {len(READINGS)} "
            f"readings. Undo it where images are read: {orientation.remedy}."
        )


def _refuse_unlike(light: FrameLight, own: bool) -> None:
    what, than = (
        (OTHER_SENSOR, "the calibration's")
        if own
        else ("The background is not of this image", "the background")
    )
    gains = light.gain.tolist()
    if min(gains) < RATIO_REFUSE or max(gains) > 1 / RATIO_REFUSE:
        remedy = (
            f"{OWN_CALIBRATION} Or set exposure and white balance as they were at calibration."
            if own
            else "Take a new background with the same exposure, white balance and lights."
        )
        raise CalibrationError(
            f"{what}: pixels at rest are {_times(light.gain)} times as bright as in {than} "
            f"(expected {RATIO_REFUSE}-{1 / RATIO_REFUSE:.2g}). {remedy}"
        )
    if light.correlation < CORRELATION_REFUSE:
        raise CalibrationError(
            f"{what}: the two correlate by {light.correlation:.2f} on pixels at rest (expected {CORRELATION_REFUSE} or more)"
            ". " + (OWN_CALIBRATION if own else "Is it of another sensor, or shifted?")
        )


def room_light_finding(light: FrameLight) -> tuple[Finding, ...]:
    """Find `room_light`: light added to all channels; figure: gray levels, of the channel that changed most.

    The sensor's own light multiplies the background image. Light from outside is added to it, in dark places too.
    """
    room = 0.0 if light.is_plain else _sure(light.room, light.covariance[:, 3, 3], ROOM_REPORTED)
    if not room:
        return ()
    message = (
        f"Room light changes the colors by up to {room:+.0f} gray levels. gelform removes it. Shade the gel."
    )
    return (Finding("room_light", message, room),)


def _sure(values: Numbers, variances: Numbers, least: float) -> float:
    """The value that exceeds `least` most clearly; 0 if none does by 3 sigma, with 0.1 % of false alarms."""
    over = np.abs(values) - 3.0 * np.sqrt(variances)
    at = np.unravel_index(over.argmax(), over.shape)
    return float(values[at]) if over[at] > least else 0.0


def _exposure_findings(
    light: FrameLight, whose: str = "the background's", remedy: str = " Take a new background."
) -> tuple[Finding, ...]:
    if not light.share:
        message = "gelform cannot compare the exposure: every part of the image is too dark in some channel, or saturated."
        return (Finding("exposure_unknown", message, 0.0),)
    if not light.is_known:
        sigma = float(np.sqrt(light.covariance[:, 0, 0].max()))
        message = (
            f"gelform cannot tell the exposure well: its standard deviation is {100 * sigma:.2g} %, as where a contact or "
            "noise fills the image. The slopes' sigma contains what an unknown exposure does."
        )
        return (Finding("exposure_unknown", message, light.share),)
    gains = light.gain.tolist()
    largest = max(gains, key=lambda one: abs(log(one)))
    if min(gains) < RATIO_WARN or max(gains) > 1 / RATIO_WARN:
        message = f"Pixels at rest are {_times(light.gain)} times as bright as {whose}.{remedy}"
        return (Finding("background_ratio", message, largest),)
    if abs(largest - 1) > GAIN_REPORTED:
        percents = ", ".join(f"{name} {100 * (one - 1):+.0f} %" for name, one in zip("RGB", gains))
        message = f"The exposure differs from {whose} by {percents}. gelform compensates it."
        return (Finding("exposure", message, largest),)
    return ()


def _times(gain: Numbers) -> str:
    return ", ".join(f"{name} {value:.2f}" for name, value in zip("RGB", gain))
