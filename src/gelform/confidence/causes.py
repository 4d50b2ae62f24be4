"""What makes a slope uncertain beyond what its step and place say: one row for each cause."""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.background.change import ChangeSettings, gain_from_background
from gelform.confidence.clipped import SATURATED_FROM, ClippedChannels
from gelform.confidence.solved import reach_px


class Cause(NamedTuple):
    """One cause of doubt.

    Attributes
    ----------
    sentence : what is said of the pixels that it is named for; "" where it is never named
    named_from : standard deviation, mm/mm, that it has to add to a slope to be named
    """

    sentence: str
    named_from: float


LEAVES_NOTHING = 0.35  # mm/mm: about the slope of a ball's rim
SIX_SIGMA = 7.0  # mm/mm, what a residual of 6 sigma adds: rims of real presses leave up to 5
CAUSES = {
    "saturated": Cause("at the camera's upper end. Lower exposure, gain or the lights.", LEAVES_NOTHING),
    "dark": Cause("at the camera's lower end. Is a light off, or the exposure too short?", LEAVES_NOTHING),
    "shadow": Cause("darker than any slope makes it: a cast shadow.", SIX_SIGMA),
    "specular": Cause("brighter than any slope makes it: a mirrored light.", SIX_SIGMA),
    "off_gamut": Cause(
        "of colours that no slope gives: dust, a scratch, another gel, or slopes that no training press has shown.",
        SIX_SIGMA,
    ),
    "inconsistent": Cause("torn, or another moment's: data of the frame were lost.", LEAVES_NOTHING),
    "marker": Cause("hidden by markers.", LEAVES_NOTHING),
    "outside": Cause("not lit, or not gel.", LEAVES_NOTHING),
    "wall": Cause("", LEAVES_NOTHING),  # an object's edge is no fault
    "compression": Cause(
        "noisier than the calibrated images. Raise the JPEG quality, or lower the camera's gain.", 0.0
    ),
}


# Squared residual, in units of its covariance on held-out presses, from which nothing is left of a slope (3 sigma).
OUTLIER = 9.0
UNKNOWN = 1.0  # mm/mm, what such a slope is off by
# |Mean| of a color change's channels over their RMS, from which all are darker (a shadow) or all brighter (a mirror).
ALIKE = 0.5
# Slopes that differ by more from those `reach_px` away than a small ball's do are blurred, and off by so much of the rest.
BEND_FROM, BEND = 0.1, 1.75
UNSEEN = 1000.0  # of the clean sigma, for what says nothing: a weight of 1e-6, which solvers take for none
LEAST_CONFIDENCE = (
    0.01  # of a slope of which the image says something: solvers fill what has less from around
)
UNLIT_TO = 8  # grey levels of the untouched image's brightest channel
LEAST_OUTSIDE_PX = 25  # connected: less is dust
LOST_BLOCK_PX, LOST_DARK_TO, LOST_SATURATED_FROM = (
    16,
    16,
    240,
)  # mean of a block that was lost: dark, saturated or torn

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
    ) -> None:
        self._rest, self._clean, self._per_change = as_levels(rest), clean, slope_per_change
        self._levels = np.inf if levels is None else float(np.sqrt(np.mean(np.square(levels))))
        self._gain = np.ascontiguousarray(gain_from_background(rest, change).mean(axis=-1))
        self._outside = outside_of_gel(rest)
        self._bend = BEND if walls else 0.0, BEND_FROM, UNKNOWN, LEAST_CONFIDENCE, reach_px(change.blur_px)
        self._disc = ClippedChannels(change.blur_px, None, 0).disc

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

        Confidence is min(1, (clean / sigma)^2): the only rule, whatever the cause; but 0.01 at least where the image says
        something of the slope.

        Parameters
        ----------
        gradients : (H, W, 2)
        sigma : (H, W)
        unseen : (H, W) bool, pixels that show no gel, or of which too few channels say something; None: nowhere
        image : (H, W, 3), 0-255, as it came: its noise counts
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
            UNSEEN * self._clean, self._clean, self._per_change * added, *self._bend,
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

        Parameters
        ----------
        maps : from the call
        sigma : (H, W), before it was raised
        image : (H, W, 3), 0-255, as it came
        clipped : (H, W, 3), channels that say nothing
        markers, lost : (H, W) bool, pixels that markers hide, and parts that were lost
        color_change : (H, W, 3), which says what kind outliers are
        """
        nothing, unseen = np.zeros(sigma.shape, np.float32), np.float32(UNSEEN * self._clean)
        found = dict.fromkeys(
            ("saturated", "dark", "shadow", "specular", "off_gamut", "inconsistent"), nothing
        )
        for name, where in (("marker", markers), ("outside", self._outside)):
            found[name] = nothing if where is None else np.where(where, unseen, nothing)
        pixels = as_levels(image)
        if clipped is not None:
            says_nothing = clipped.sum(axis=-1) > 1
            cost = np.where(says_nothing, unseen, sigma) * clipped.any(axis=-1)
            bright = cv2.dilate((pixels >= SATURATED_FROM).any(axis=-1).view(np.uint8), self._disc) > 0
            found["saturated"] = np.where(bright, cost, nothing)
            found["dark"] = np.where(bright, nothing, cost)
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
        common = color_change.mean(axis=-1) / np.maximum(
            np.sqrt(np.mean(np.square(color_change), axis=-1)), 1e-12
        )
        darker, brighter = common < -ALIKE, common > ALIKE
        kinds = ("shadow", darker), ("specular", brighter), ("off_gamut", ~darker & ~brighter)
        found |= {name: np.where(where, maps["outlier"], nothing) for name, where in kinds}
        return {**found, "wall": maps["wall"], "compression": maps["compression"]}


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


def as_levels(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Whole grey levels of an image (H, W, 3), 0-255, in C order."""
    if image.dtype != np.uint8:
        image = np.rint(image).astype(np.uint8)
    return np.ascontiguousarray(image)


def either(one: NDArray[np.bool_] | None, other: NDArray[np.bool_] | None) -> NDArray[np.bool_] | None:
    """Where one of two masks (H, W) is, each of which may be None: nowhere."""
    return one if other is None else other if one is None else one | other


BLOCK_PX = 8  # of JPEG
LEAST_BLOCKS = 4  # across a frame
EVERY = 4  # rows are looked at
USUALLY = 1.5  # times the calibrated images' noise is usual: presses are no flat fields
LEAST_LEVELS = 1.0  # less is as good as none
FROM_JUMP = 0.8862  # sigma of a normal distribution over the mean of |a - b| of two of its values
EXCESS = 1.15  # times the usual jump, that jumps between blocks have to be
_column_jumps = Kernel(
    "column_jumps", "u8[h,w,3] image, u8[h,w,3] rest, out i32[n] work, out f32[8] medians, i32 step"
)


def added_levels(pixels: NDArray[np.uint8], rest: NDArray[np.uint8], usual_levels: float) -> float:
    """Noise of an image (H, W, 3) beyond the usual, grey levels: of single pixels, and of JPEG's blocks.

    Blocks of 8x8 pixels that were rounded apart from each other jump where they meet: such columns come every 8 pixels,
    at a place that depends on the crop. Their jumps' excess over the other columns' is twice the blocks' variance.

    Parameters
    ----------
    pixels, rest : (H, W, 3), the image and the untouched one
    usual_levels : standard deviation of a pixel of the calibrated images against the untouched one; more than that
        is counted, and nothing where it is infinite
    """
    width = pixels.shape[1]
    if (width - 1) // BLOCK_PX < LEAST_BLOCKS:
        return 0.0
    medians = np.empty(BLOCK_PX, dtype=np.float32)
    _column_jumps(pixels, rest, np.empty(4 * width, dtype=np.int32), medians, EVERY)
    by_place = sorted(medians.tolist())
    usual, most = (by_place[BLOCK_PX // 2 - 1] + by_place[BLOCK_PX // 2]) / 2, by_place[-1]
    single = FROM_JUMP * usual
    blocks = FROM_JUMP * sqrt(max(most**2 - usual**2, 0.0)) if most > EXCESS * usual else 0.0
    added = sqrt(max(single**2 - (USUALLY * usual_levels) ** 2, 0.0) + blocks**2)
    return added if added > LEAST_LEVELS else 0.0
