"""The standard deviation of slopes as a calibration states it, and what of a frame shows no slope."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import erf, pi, sqrt
from typing import Any, NamedTuple

import cv2
import numpy as np
import scipy  # its parts load at first use
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.arrays import Array, Image, Mask, Numbers
from gelform.foundations.checks import check_values, check_within
from gelform.image.view import DARK

# Of a normal distribution within one and two standard deviations.
ONE_SIGMA, TWO_SIGMA = erf(sqrt(0.5)), erf(sqrt(2))
MIN_IN_BIN = 50  # pixels; fewer do not determine a quantile
LEAST_SIGMA = 1e-5  # mm/mm, least deviation: float32 rounds slopes to less
LEAST_FACTOR = 0.3  # smallest factor of solved slopes; errors that have no curl stay
# Pixels in contact of presses that the model has not seen: |gradient| as read, mm/mm; the error of its components; its
# standard deviation by the step of the forward response, or 1; the squared residual of the color change after the step.
HELD_OUT = np.dtype([("slope", "f8"), ("error", "f8", 2), ("stated", "f8"), ("residual", "f4")])
# Pixels of gel at rest: slopes without their bias, which are all error, and variance from the image's noise.
AT_REST = np.dtype([("error", "f8", 2), ("noise", "f4")])


@dataclass(frozen=True)
class SlopeSigma:
    """Standard deviation of a slope component: that of its step, times a factor that grows with the slope.

    Without a step, its deviation counts as 1 mm/mm. 68 % of the errors on held-out presses are within the stated deviations:
    they are fitted to that fraction, because a few bad pixels would dominate the variance.
    """

    # Of gel at rest: the root of `rest^2 + rest_per_noise^2 noise`, with the variance of the place by `noise_at_rest`. The
    # first part is the model's and alike everywhere, the second is the camera's.
    rest: float
    per_step: float  # in contact: `per_step step sqrt(1 + (per_slope |gradient|)^2)`, with the step's own
    full_confidence_sigma: float  # that 95 % of the pixels in contact stay under; confidence is 1 up to it
    correlation_px: float  # over this distance the correlated part falls to exp(-1/2) (a Gaussian)
    per_slope: float = 0.0
    # Of the solved depth's slopes over that of the slopes as read; a surface cannot follow errors that have curl.
    solved_factor: float = 1.0
    # Deviation of depth far from contacts over the one that the slopes there make; see `gelform.depth.sigma`.
    depth_factor: float = 10.0
    shown: tuple[float, float] = (0.4, 0.6)  # mm/mm, quantiles 0.4 and 0.8 of the slopes of presses
    correlated_share: float = 1.0  # fraction of the variance that is correlated; the rest is white
    # Relative error that slopes of one size share around a press, RMS over sizes and presses, beyond what errors of single
    # slopes explain; depth is off in proportion.
    gain_sigma: float = 0.0
    # The same for gel at rest, where the color change's blur correlates the noise over a pixel or two. The errors'
    # correlation falls to exp(-1/2) over the first; the second, 0-1, is the share that is correlated over `correlation_px`.
    # None: as in a contact, in calibrations without it.
    rest_correlation_px: float = 0.0
    rest_correlated_share: float | None = None
    rest_per_noise: float = 0.0

    def __post_init__(self) -> None:
        for name, low, high in (
            ("rest", 1e-9, 1e3), ("rest_per_noise", 0, 1e3), ("per_step", 1e-9, 1e3), ("per_slope", 0, 1e4),
            ("solved_factor", 1e-3, 1e3), ("depth_factor", 1e-3, 1e4), ("full_confidence_sigma", 1e-9, 1e3),
            ("correlation_px", 1e-6, 1e4), ("correlated_share", 0, 1), ("gain_sigma", 0, 10),
            ("rest_correlation_px", 0, 1e4),
        ):  # fmt: skip
            check_within(getattr(self, name), name, low, high)
        if self.rest_correlated_share is not None:
            check_within(self.rest_correlated_share, "rest_correlated_share", 0, 1)
        shown = check_values(self.shown, "shown")
        if not (shown.shape == (2,) and 0 <= shown[0] <= shown[1]):
            raise ValueError("Expected shown as two slopes >= 0 that grow, got others.")

    @classmethod
    def fit(cls, pixels: Array, rest: Array, correlation_px: float, correlated_share: float) -> SlopeSigma:
        """Fit the law, so that 68 % of the held-out errors of slopes of any size lie within one sigma.

        `pixels` in contact have the columns of `HELD_OUT`, those of `rest` the columns of `AT_REST`.
        """
        slopes, stated = pixels["slope"], pixels["stated"]
        constant, growing = _law(pixels["error"] / stated[:, None], slopes**2)
        per_step = max(constant**0.5, LEAST_SIGMA)
        law = np.sqrt(constant + growing * slopes**2) * stated
        at_rest, per_noise = per_step * float(np.median(stated)), 0.0
        if rest.size:
            at_rest, per_noise = (part**0.5 for part in _law(rest["error"], rest["noise"]))
        # Beyond the first quantile a model of other units is doubted, beyond the second every model. With 0.5 the faces of a
        # cube's edge escape the doubt of a model whose own presses are deep, with 0.3 balls are doubted too; from 0.75 on,
        # balls of the own unit were doubted in every second frame.
        low, high = np.quantile(slopes, (0.4, 0.8))
        return cls(
            rest=max(at_rest, LEAST_SIGMA),
            per_step=per_step,
            per_slope=growing**0.5 / per_step,
            shown=(float(low), float(high)),
            full_confidence_sigma=max(float(np.quantile(law, 0.95)), LEAST_SIGMA),
            correlation_px=float(correlation_px),
            correlated_share=float(correlated_share),
            rest_per_noise=per_noise,
        )

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> SlopeSigma:
        """Make it from `dataclasses.asdict`."""
        kept = {name: value for name, value in values.items() if value is not None}
        return cls(**{**kept, "shown": tuple(kept["shown"])})

    def with_solved(self, errors: Array, stated: Array) -> SlopeSigma:
        """With the factor that leaves 68 % of held-out errors (N, 2) of solved slopes within one sigma.

        `stated` (N,) are the deviations of the slopes as read at the same pixels. Too few pixels change nothing.
        """
        if len(stated) < MIN_IN_BIN:
            return self
        factor = float(np.quantile(np.abs(errors) / stated[:, None], ONE_SIGMA))
        return replace(self, solved_factor=max(factor, LEAST_FACTOR))

    @property
    def correlation(self) -> dict[str, Any]:
        """The correlation of the errors, as arguments of `PreparedContact`."""
        names = ("correlation_px", "correlated_share", "rest_correlation_px", "rest_correlated_share")
        return {name: getattr(self, name) for name in names}


def _law(errors: Array, variable: Array) -> tuple[float, float]:
    """Constant part of the squared deviations of errors (N, 2), and the one that grows with a variable (N,) >= 0.

    It is fitted to ten bins of equal counts by nonnegative least squares, each relative to itself.
    """
    order = np.array_split(np.argsort(variable, kind="stable"), 10)
    bins = [part for part in order if len(part) >= MIN_IN_BIN] or [np.arange(len(variable))]
    squares = np.array([max(np.quantile(np.abs(errors[part]), ONE_SIGMA), 1e-9) ** 2 for part in bins])
    means = np.array([np.mean(variable[part], dtype=np.float64) for part in bins])
    unit = max(float(means.mean()), 1e-30)
    design = np.stack([1 / squares, means / unit / squares], axis=1)
    parts, _ = scipy.optimize.nnls(design, np.ones(len(squares)))
    return float(parts[0]), float(parts[1] / unit)


def outside_of_gel(background: Array) -> Mask | None:
    """Pixels (H, W) of a background image without light, except regions as small as dust; None if there are none."""
    unlit = (np.asarray(background).max(axis=-1) <= DARK).astype(np.uint8)
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(unlit, connectivity=8)
    large = boxes[:, cv2.CC_STAT_AREA] >= 25
    large[0] = False
    return large[labels] if count > 1 and large.any() else None


def either(one: Mask | None, other: Mask | None) -> Mask | None:
    """Union of two masks (H, W); a mask may be None, which means no pixel."""
    return one if other is None else other if one is None else one | other


JPEG_BLOCK_PX = 8
# Standard deviation of a normal distribution over the mean |a - b| of two of its values: sqrt(pi)/2.
SIGMA_OF_JUMP = sqrt(pi) / 2
_column_jumps = Kernel(
    "column_jumps", "u8[h,w,3] image, u8[h,w,3] rest, out i32[n] work, out f32[8] medians, i32 step"
)


def excess_noise(pixels: Image, rest: Image, usual_levels: float) -> float:
    """Noise of an image (H, W, 3) beyond the usual, gray levels: of single pixels, and of JPEG's blocks.

    Blocks of 8x8 pixels are rounded separately and jump at their borders. Such columns come every 8 pixels, at an offset
    that depends on the crop. The excess of their jumps over those of other columns is twice the blocks' variance.
    Pixels with an infinite usual deviation from the background image do not count.
    """
    width = pixels.shape[1]
    if (width - 1) // JPEG_BLOCK_PX < 4:  # the medians over fewer blocks are noise
        return 0.0
    medians = np.empty(JPEG_BLOCK_PX, dtype=np.float32)
    _column_jumps(pixels, rest, np.empty(4 * width, dtype=np.int32), medians, step=4)
    by_place = sorted(medians.tolist())
    usual, most = (by_place[JPEG_BLOCK_PX // 2 - 1] + by_place[JPEG_BLOCK_PX // 2]) / 2, by_place[-1]
    single = SIGMA_OF_JUMP * usual
    blocks = SIGMA_OF_JUMP * sqrt(max(most**2 - usual**2, 0.0)) if most > 1.15 * usual else 0.0
    # Up to 1.5 times the calibrated images' noise is usual, because presses are no flat fields.
    added = sqrt(max(single**2 - (1.5 * usual_levels) ** 2, 0.0) + blocks**2)
    return added if added > 1 else 0.0  # one step of the camera; less has no effect


DARK_TO, SATURATED_FROM = 2, 254  # gray levels: up to the first and from the second a channel is clipped

_clipped_channels = Kernel(
    "clipped_channels",
    "u8[h,w,3] image, bool[3] low, bool[3] high, out u8[h,w,3] clipped, i32 dark_to, i32 saturated_from",
)


class Clipped(NamedTuple):
    """The clipped parts of a frame that were not clipped in the images of the calibration."""

    # (H, W, 3) uint8, 1 where a channel is clipped or a clipped one blurred into it; None: nowhere
    channels: NDArray[np.uint8] | None
    unseen: Mask | None  # (H, W) bool, pixels with too few channels left for two slopes; None: none


class ClippedChannels:
    """Finds clipped channels in frames of one calibration. It is immutable; threads can share it.

    `learnt` (2, 3) is whether red, green, blue was clipped at the lower and the upper end in the calibration's own presses,
    so that the model learnt it; None: nowhere. A slope can be read without `spare` channels: 1 with a forward response's
    step, else 0. Pixels without light at rest, where dark is no fault, are `outside` (H, W); None: none.
    """

    def __init__(self, blur_px: float, learnt: Mask | None, spare: int, outside: Mask | None = None) -> None:
        usual = np.ones((2, 3), dtype=bool) if learnt is None else ~np.asarray(learnt, dtype=bool)
        self._counts = [np.ascontiguousarray(row) for row in usual]
        self._spare, self._outside, self._disc = spare, outside, bloom_disc(blur_px)

    def __call__(self, pixels: Image, hidden: Mask | None) -> Clipped:
        """The clipped channels of an image (H, W, 3), without those of hidden pixels (H, W)."""
        channels = np.empty_like(pixels)
        low, high = self._counts
        if not _clipped_channels(pixels, low, high, channels, dark_to=DARK_TO, saturated_from=SATURATED_FROM):
            return Clipped(None, None)
        for nothing in (hidden, self._outside):
            if nothing is not None:
                channels[nothing] = 0
        marked = channels.reshape(len(channels), -1)
        x, y, width, height = cv2.boundingRect(marked)
        if not width:
            return Clipped(None, None)
        reach = len(self._disc) // 2
        box = (
            slice(max(y - reach, 0), y + height + reach),
            slice(max(x // 3 - reach, 0), (x + width) // 3 + 1 + reach),
        )
        channels[box] = cv2.dilate(np.ascontiguousarray(channels[box]), self._disc)
        number = cv2.transform(channels, np.ones((1, 3), np.float32))
        return Clipped(channels, np.asarray(number > self._spare, dtype=np.bool_))


def bloom_disc(blur_px: float) -> NDArray[np.uint8]:
    """Structuring element: the reach of a clipped pixel in a color change of that blur, and a pixel that blooms."""
    size = 2 * (int(np.ceil(2 * blur_px)) + 1) + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)), dtype=np.uint8)


def ends_shown(images: Array) -> Numbers:
    """Share (2, 3) of pixels (N, 3) whose red, green, blue is at the lower and at the upper end."""
    levels = np.asarray(images)
    return np.stack([np.mean(levels <= DARK_TO, axis=0), np.mean(levels >= SATURATED_FROM, axis=0)])
