"""What makes a slope uncertain beyond what its step and place say: one row for each cause, and what each adds."""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.background.change import ChangeSettings, gain_from_background
from gelform.confidence.solved import reach_px
from gelform.frames import as_levels


class Cause(NamedTuple):
    """One cause of doubt: all that the command line, the plots and the live page say of it.

    Attributes
    ----------
    sentence : what is said of the pixels that it is named for; "" where it is never named
    named_from : standard deviation, mm/mm, that it has to add to a slope to be named
    color : in pictures, "#rrggbb"
    """

    sentence: str
    named_from: float
    color: str


LEAVES_NOTHING = 0.35  # mm/mm, about the slope of a ball's rim
SIX_SIGMA = 7.0  # mm/mm, what a residual of 6 sigma adds: rims of real presses leave up to 5
# The colours are those of Okabe and Ito, told apart with every kind of colour blindness; the last is not theirs.
CAUSES = {
    "saturated": Cause(
        "at the camera's upper end. Lower exposure, gain or the lights.", LEAVES_NOTHING, "#e69f00"
    ),
    "dark": Cause(
        "at the camera's lower end. Is a light off, or the exposure too short?", LEAVES_NOTHING, "#0072b2"
    ),
    "shadow": Cause("darker than any slope makes it: a cast shadow.", SIX_SIGMA, "#56b4e9"),
    "specular": Cause("brighter than any slope makes it: a mirrored light.", SIX_SIGMA, "#f0e442"),
    "off_gamut": Cause(
        "of colors that no slope gives: dust, a scratch, another gel, or slopes outside the training zone.",
        SIX_SIGMA,
        "#cc79a7",
    ),
    "inconsistent": Cause(
        "torn or from another moment: data of the frame were lost.", LEAVES_NOTHING, "#d55e00"
    ),
    "marker": Cause("hidden by markers.", LEAVES_NOTHING, "#999999"),
    "outside": Cause("not lit, or not gel.", LEAVES_NOTHING, "#009e73"),
    "wall": Cause("", LEAVES_NOTHING, "#000000"),  # an object's edge is no fault
    "compression": Cause(
        "noisier than the calibrated images. Raise the JPEG quality, or lower the camera's gain.",
        0.0,
        "#b08968",
    ),
}

# Squared residual, in units of its covariance on held-out presses, from which nothing is left of a slope: three sigma.
OUTLIER = 9.0
UNKNOWN = 1.0  # mm/mm, what such a slope is off by: the steepest that a gel shows
# |Mean| of a color change's channels over their RMS, from which all are darker (a shadow) or all brighter (a mirror).
ALIKE = 0.5
# mm/mm, by which slopes differ from those `reach_px` away more than a small ball's do: such slopes are blurred. And their
# error over what they differ by more.
DIFFERENCE_FROM, ERROR_OF_DIFFERENCE = 0.1, 1.75
UNSEEN = 1000.0  # clean sigmas, of what says nothing: a weight of 1e-6, which solvers take for none
# Of a wall at least: with less than 0.001 it is filled from its neighbours, and the object is gone.
WALL_CONFIDENCE = 0.01
UNLIT_TO = 8  # grey levels of the untouched image's brightest channel, as of a block that is dark
LEAST_OUTSIDE_PX = 25  # connected pixels: a region of fewer is dust
# Mean grey level of a block that was lost, up to or from which it is dark or saturated, and torn between.
LOST_BLOCK_PX, LOST_DARK_TO, LOST_SATURATED_FROM = 16, 16, 240

_raise_sigma = Kernel(
    "raise_sigma",
    "f32[h,w,2] gradients, f32[h,w]? residual, f32[h,w]? of_step, bool[h,w]? unseen_at, f32[h,w] gain, out f32[h,w] sigma, "
    "out f32[h,w] confidence, out f32[h,w]? walls, out f32[h,w]? outliers, f32 outlier, f32 unseen, "
    "f32 clean, f32 added, f32 per_bend, f32 bend_from, f32 unknown, f32 least, i32 reach",
)


class PreparedCauses:
    """All causes of one calibration and background; immutable, shared by threads.

    Parameters
    ----------
    rest : (H, W, 3), 0-255, the untouched image in use
    change : how images become color changes
    clean : standard deviation of a slope of confidence 1, mm/mm
    levels : standard deviation of the calibrated images' pixels, grey levels, of each channel; None where not known
    slope_per_change : slope that a color change of 1 is worth, mm/mm
    walls : whether slopes that bend sharply are doubted; not those of imported color models, whose blur is unknown
    outside : (H, W) bool, where no light comes at rest, as `outside_of_gel` gives it; None: nowhere
    """

    def __init__(
        self,
        rest: NDArray[np.float32],
        change: ChangeSettings,
        *,
        clean: float,
        levels: Any | None,
        slope_per_change: float = 1.0,
        walls: bool = True,
        outside: NDArray[np.bool_] | None = None,
    ) -> None:
        self._rest, self._clean, self._per_change = as_levels(rest), clean, slope_per_change
        self._levels = np.inf if levels is None else float(np.sqrt(np.mean(np.square(levels))))
        self._gain = np.ascontiguousarray(gain_from_background(rest, change).mean(axis=-1))
        self._outside, self._disc = outside, bloom_disc(change.blur_px)
        error = ERROR_OF_DIFFERENCE if walls else 0.0
        self._rules = error, DIFFERENCE_FROM, UNKNOWN, WALL_CONFIDENCE, reach_px(change.blur_px)

    def __call__(
        self,
        gradients: NDArray[np.float32],
        sigma: NDArray[np.float32],
        unseen: NDArray[np.bool_] | None,
        image: NDArray[Any],
        step: tuple[NDArray[Any], NDArray[Any]] | None = None,
        maps: dict[str, NDArray[np.float32]] | None = None,
    ) -> NDArray[np.float32]:
        """Raise the sigma (H, W) of a frame's slopes in place; the confidence (H, W) that follows.

        Confidence is min(1, (clean / sigma)^2): the only rule, whatever the cause; but of a wall 0.01 is left.

        Parameters
        ----------
        gradients : (H, W, 2)
        sigma : (H, W)
        unseen : (H, W) bool, pixels that show no gel, or of which too few channels say something; None: nowhere
        image : (H, W, 3), 0-255, the raw image: its noise counts
        step : residual and variance (H, W) of the forward response's step, the residual's unit that of held-out presses
        maps : gets what walls, outliers and compression add, by name, where it is given
        """
        added = added_levels(as_levels(image), self._rest, self._levels)
        unseen_at = either(unseen, self._outside)
        confidence = np.empty_like(sigma)
        walls = outliers = None
        if maps is not None:
            walls, outliers = maps["wall"], maps["outlier"] = np.empty_like(sigma), np.empty_like(sigma)
            maps["compression"] = np.float32(self._per_change * added) * self._gain
        _raise_sigma(
            gradients, *(step or (None, None)), unseen_at, self._gain, sigma, confidence, walls, outliers, OUTLIER,
            UNSEEN * self._clean, self._clean, self._per_change * added, *self._rules,
        )  # fmt: skip
        return confidence

    def maps_of(
        self,
        maps: dict[str, NDArray[np.float32]],
        sigma: NDArray[np.float32],
        image: NDArray[Any],
        *,
        clipped: NDArray[np.uint8] | None,
        markers: NDArray[np.bool_] | None,
        lost: NDArray[np.bool_] | None,
        color_change: NDArray[np.float32],
    ) -> dict[str, NDArray[np.float32]]:
        """What each cause of `CAUSES` adds (H, W), in squares, to the sigma of slopes, mm/mm.

        Of the maps from the call, the sigma (H, W) before it was raised and the raw image; of channels that say nothing,
        pixels
        that markers hide, parts that were lost, and the color change (H, W, 3), which says what kind outliers are.
        """
        nothing, unseen = np.zeros(sigma.shape, np.float32), np.float32(UNSEEN * self._clean)
        found = {name: maps.get(name, nothing) for name in CAUSES}
        for name, where in (("marker", markers), ("outside", self._outside)):
            if where is not None:
                found[name] = np.where(where, unseen, nothing)
        pixels = as_levels(image)
        if clipped is not None:
            cost = np.where(clipped.sum(axis=-1) > 1, unseen, sigma) * clipped.any(axis=-1)
            bright = cv2.dilate((pixels >= SATURATED_FROM).any(axis=-1).view(np.uint8), self._disc) > 0
            found["saturated"], found["dark"] = (
                np.where(bright, cost, nothing),
                np.where(bright, nothing, cost),
            )
        if lost is not None:
            level = cv2.blur(pixels, (LOST_BLOCK_PX, LOST_BLOCK_PX))
            bright = lost & (level.max(axis=-1) >= LOST_SATURATED_FROM)
            dark = lost & ~bright & (level.min(axis=-1) <= LOST_DARK_TO)
            for name, where in (
                ("saturated", bright),
                ("dark", dark),
                ("inconsistent", lost & ~bright & ~dark),
            ):
                found[name] = np.where(where, unseen, found[name])
        size = np.sqrt(np.mean(np.square(color_change), axis=-1))
        common = color_change.mean(axis=-1) / np.maximum(size, 1e-12)
        darker, brighter = common < -ALIKE, common > ALIKE
        for name, where in (("shadow", darker), ("specular", brighter), ("off_gamut", ~darker & ~brighter)):
            found[name] = np.where(where, maps["outlier"], nothing)
        return found


class AllAlike:
    """Where results state no deviation of the slopes: each has a confidence of 1, as solvers without weights count it."""

    def __call__(self, gradients: NDArray[np.float32], *frame: Any) -> NDArray[np.float32]:
        """Confidence (H, W), of the arguments of `PreparedCauses`; the sigma stays as it is."""
        return np.ones(gradients.shape[:2], dtype=np.float32)


def outside_of_gel(background: NDArray[Any]) -> NDArray[np.bool_] | None:
    """Pixels (H, W) of an untouched image that no light reaches, in regions that are not dust; None: there are none."""
    unlit = (np.asarray(background).max(axis=-1) <= UNLIT_TO).astype(np.uint8)
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(unlit, connectivity=8)
    large = boxes[:, cv2.CC_STAT_AREA] >= LEAST_OUTSIDE_PX
    large[0] = False
    return large[labels] if count > 1 and large.any() else None


def either(one: NDArray[np.bool_] | None, other: NDArray[np.bool_] | None) -> NDArray[np.bool_] | None:
    """Where one of two masks (H, W) is, each of which may be None: nowhere."""
    return one if other is None else other if one is None else one | other


JPEG_BLOCK_PX = 8
LEAST_BLOCKS = 4  # across a frame: the medians over fewer columns are noise
EVERY_ROW = 4  # of how many rows one is looked at
USUAL_NOISE = 1.5  # times the calibrated images' noise is still usual: presses are no flat fields
LEAST_LEVELS = 1.0  # grey level, a step of the camera: less noise is as good as none
# sqrt(pi)/2: sigma of a normal distribution over the mean |a - b| of two of its values.
SIGMA_OF_JUMP = 0.8862
# Times the usual jump, that jumps between blocks have to be.
JUMP_EXCESS = 1.15
_column_jumps = Kernel(
    "column_jumps", "u8[h,w,3] image, u8[h,w,3] rest, out i32[n] work, out f32[8] medians, i32 step"
)


def added_levels(pixels: NDArray[np.uint8], rest: NDArray[np.uint8], usual_levels: float) -> float:
    """Noise of an image (H, W, 3) beyond the usual, grey levels: of single pixels, and of JPEG's blocks.

    Blocks of 8x8 pixels that were rounded apart from each other jump where they meet: such columns come every 8 pixels,
    at a place that depends on the crop. Their jumps' excess over the other columns' is twice the blocks' variance.
    Nothing
    counts where the usual deviation of a pixel from the untouched image is infinite.
    """
    width = pixels.shape[1]
    if (width - 1) // JPEG_BLOCK_PX < LEAST_BLOCKS:
        return 0.0
    medians = np.empty(JPEG_BLOCK_PX, dtype=np.float32)
    _column_jumps(pixels, rest, np.empty(4 * width, dtype=np.int32), medians, EVERY_ROW)
    by_place = sorted(medians.tolist())
    usual, most = (by_place[JPEG_BLOCK_PX // 2 - 1] + by_place[JPEG_BLOCK_PX // 2]) / 2, by_place[-1]
    single = SIGMA_OF_JUMP * usual
    blocks = SIGMA_OF_JUMP * sqrt(max(most**2 - usual**2, 0.0)) if most > JUMP_EXCESS * usual else 0.0
    added = sqrt(max(single**2 - (USUAL_NOISE * usual_levels) ** 2, 0.0) + blocks**2)
    return added if added > LEAST_LEVELS else 0.0


DARK_TO, SATURATED_FROM = 2, 254  # grey levels from which a channel counts as clipped
BLOOMS_PX = 1  # further than the color change's blur reaches

_clipped_channels = Kernel(
    "clipped_channels",
    "u8[h,w,3] image, bool[3] low, bool[3] high, out u8[h,w,3] clipped, i32 dark_to, i32 saturated_from",
)


class Clipped(NamedTuple):
    """What of a frame is at an end of the camera's range, and was not so in the images that the calibration was made from.

    Attributes
    ----------
    channels : (H, W, 3) uint8, 1 where a channel is clipped or a clipped one blurred into it; None: nowhere
    unseen : (H, W) bool, where too few channels are left for two slopes; None: nowhere
    """

    channels: NDArray[np.uint8] | None
    unseen: NDArray[np.bool_] | None


class ClippedChannels:
    """Finds clipped channels in frames of one calibration; immutable, shared by threads.

    Parameters
    ----------
    blur_px : of the color change
    learnt : (2, 3) bool, red, green, blue at the lower and the upper end in the calibration's own presses: what was learnt
        holds there; None: nowhere
    spare : channels that a slope can be read without: 1 where there is a forward response's step, else 0
    outside : (H, W) bool, where no light comes at rest: dark there is no fault; None: nowhere
    """

    def __init__(
        self,
        blur_px: float,
        learnt: NDArray[np.bool_] | None,
        spare: int,
        outside: NDArray[np.bool_] | None = None,
    ) -> None:
        usual = np.ones((2, 3), dtype=bool) if learnt is None else ~np.asarray(learnt, dtype=bool)
        self._counts, self._spare = [np.ascontiguousarray(row) for row in usual], spare
        self._outside = outside
        self._disc = bloom_disc(blur_px)

    def __call__(self, pixels: NDArray[np.uint8], hidden: NDArray[np.bool_] | None) -> Clipped:
        """The clipped channels of an image (H, W, 3), but for those of hidden pixels (H, W), which reach nowhere."""
        channels = np.empty_like(pixels)
        if not _clipped_channels(pixels, *self._counts, channels, DARK_TO, SATURATED_FROM):
            return Clipped(None, None)
        for nothing in (hidden, self._outside):
            if nothing is not None:
                channels[nothing] = 0
        if not channels.any():
            return Clipped(None, None)
        channels = np.asarray(cv2.dilate(channels, self._disc), dtype=np.uint8)
        unseen = channels.sum(axis=-1, dtype=np.uint8) > self._spare
        return Clipped(channels, unseen)


def bloom_disc(blur_px: float) -> NDArray[np.uint8]:
    """Structuring element of how far a clipped pixel reaches in a color change of that blur."""
    size = 2 * (int(np.ceil(2 * blur_px)) + BLOOMS_PX) + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)), dtype=np.uint8)


def ends_shown(images: NDArray[Any]) -> NDArray[np.float64]:
    """Share (2, 3) of pixels (N, 3) whose red, green, blue is at the lower and at the upper end."""
    levels = np.asarray(images)
    return np.stack([np.mean(levels <= DARK_TO, axis=0), np.mean(levels >= SATURATED_FROM, axis=0)])
