"""The standard deviation of each slope of a frame: a budget of named variances that add up, and its explanation as maps.

The rows are the law of the step (or of rest), what a frame brings (light, compression, walls, outliers, unseen pixels), and
what no residual shows: steep slopes and the spread between units. A color saturates, so slopes beyond those that trained a
model are read as about the steepest of those. The model of another unit reads a steep face as a usual slope if this unit's
colors change less. Both are stated, but they are no reason to fill steep slopes from gentle ones: the solver's weights say
"no slope here", and nothing else.

A frame itself shows that the slopes of a ball are read right, from its top to where the gel leaves it. A model that reads
steep slopes too small bends what is straight: the first two components of a ball's normals are linear in the place. The
gentle part around the top tells the ball, and how far the readings follow it tells which slopes are right.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.arrays import Array, Image, Map, Mask, Numbers, Slopes
from gelform.errors import Finding
from gelform.foundations.checks import HIGHEST_SLOPE, check_slopes
from gelform.foundations.filters import MIN_UNTOUCHED, lattice_step
from gelform.foundations.pool import once
from gelform.image.background import PreparedBackground
from gelform.image.health import BELOW, BLOCK_PX, LIT
from gelform.slopes.color_models.seam import PreparedColorModel
from gelform.slopes.gradients import STEEPEST_GEL
from gelform.slopes.sigma import SATURATED_FROM, SlopeSigma, bloom_disc

USUAL_LEVELS = 2.0  # gray levels, a pixel's noise if the calibration does not know that of its images
# Squared residual over its covariance on held-out presses from which no slope is left: three sigma.
OUTLIER = 9.0
LEAST_WEIGHT = 1e-6  # of a pixel without information, which solvers treat as none
# mm/mm: slopes that differ by more from those 1.6 blurs away are blurred; a small ball's slopes differ by less. Then the
# error of blurred slopes over the excess of that difference.
DIFFERENCE_FROM, ERROR_OF_DIFFERENCE = 0.1, 1.75
# Deviation of a slope over its excess over the shown ones. Measured on three sensors: calibrations trained below slopes of
# 0.4 and 0.5 have 91 to 98 % of the steeper pixels within two sigma.
PER_EXCESS = 1.75
# mm/mm, slope of a face of 54 degrees; two sigma of a slope that another unit's model read reach it. The faces of a cube's
# edge, which stand at some 45 degrees, are read at 0.2-0.7.
STEEPEST_FACE = 1.4

_slopes_at_rest = Kernel(
    "slopes_at_rest",
    "f32[h,w,3] change, bool[h,w]? hidden, bool[h,w]? given, out f32[h,w,2] gradients, out bool[h,w] at_rest, "
    "out i32[1] refused, out f32[n] work, f32 square, f32 highest, f64 share, i64 coarse, i64 step",
)
_slope_weights = Kernel(
    "slope_weights",
    "f32[...]? residual, f32[...]? of_model, bool[...]? unseen, out f32[...] weight, f32 outlier, f32 unknown, f32 full, "
    "f32 least",
)
_slope_budget = Kernel(
    "slope_budget",
    "f32[h,w,2] gradients, bool[h,w] at_rest, f32[h,w] rest, f32[h,w]? of_step, f32[h,w]? of_model, f32[h,w]? residual, "
    "bool[h,w]? unseen, f32[h,w] gain, f32[h,w]? light, out f32[h,w] read, out f32[h,w] solved, out f32[h,w] steep, "
    "out f32[h,w] whole, out f32[h,w] confidence, out f32[parts,h,w]? rows, f32[count] numbers",
)
_slope_budget_names = Kernel("slope_budget_names", "out u8[n] text")


@cache
def names_in_budget() -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The names of the kernel's numbers and of its rows, in its order; the first row is the law."""
    text = np.zeros(_slope_budget_names(np.zeros(0, dtype=np.uint8)), dtype=np.uint8)
    _slope_budget_names(text)
    names = bytes(text).decode().split()
    law = names.index("law")
    return tuple(names[:law]), tuple(names[law:])


@dataclass(frozen=True, eq=False)
class ReadSlopes:
    """The slopes of a frame without the bias that the pixels at rest show, and what their uncertainty follows from."""

    gradients: Slopes  # (H, W, 2), mm/mm
    at_rest: Mask  # (H, W) bool, pixels at rest
    unseen: Mask | None = None  # (H, W) bool, pixels without gel, or with too few usable channels; None: none
    variance: Map | None = None  # (H, W), of the forward response's step, or None
    residual: Map | None = None  # (H, W), squared, over its covariance
    model_sigma: Map | None = None  # (H, W), a color model's own deviation, or None
    outlier: float = OUTLIER  # squared residual from which no slope is left
    coarse_px: Map | None = None  # (rows, columns), coarser depth, px, that the step was made with

    def weights(self, full_confidence_sigma: float) -> Map:
        """The solver's weight (H, W) of each slope: full^2 / (full^2 + outlier^2), 1e-6 where nothing was seen."""
        weight = np.empty(self.at_rest.shape, dtype=np.float32)
        _slope_weights(
            self.residual, self.model_sigma, self.unseen, weight, outlier=self.outlier, unknown=STEEPEST_GEL,
            full=full_confidence_sigma, least=LEAST_WEIGHT,
        )  # fmt: skip
        return weight


@dataclass(frozen=True, eq=False)
class Budget:
    """Standard deviations (H, W) of the slopes of a frame, mm/mm, equal for both components."""

    read: Map  # of the slopes as they were read, without what no residual shows
    solved: Map  # of the solved depth's slopes, with the spread between units
    steep: Map  # what steep slopes may be read too small
    whole: Map  # of the solved depth's slopes, all rows included
    confidence: Map  # min(1, full_confidence_sigma^2 / (all rows of the slopes as read))
    # What the law and each row add, in squares, to `whole` and to what confidence follows from; none if not asked for.
    rows: Mapping[str, Map] = field(default_factory=dict)

    @property
    def gradients_sigma(self) -> Map:
        """`whole` of both components (H, W, 2); read-only."""
        return for_both(self.whole)


class PreparedBudget:
    """Budgets for one calibration and background. It is immutable; threads can share it."""

    def __init__(
        self,
        sigma: SlopeSigma,
        noise: Map,  # (H, W), variance of a slope at rest from the image's noise alone, by `noise_at_rest`
        untouched: PreparedBackground,
        *,
        walls: bool = True,  # whether bending slopes are blurred; False for imported models of unknown blur
        slope_per_change: float = 1.0,  # slope for a color change of 1, mm/mm
        spread: float = 0.0,  # relative standard deviation of slopes between units, of a starter
        carried: float = 0.0,  # share of the model that comes from other units, 0-1
    ) -> None:
        self.full_confidence_sigma = sigma.full_confidence_sigma
        self.rest_variance = np.float32(sigma.rest**2) + np.float32(sigma.rest_per_noise**2) * noise
        gain = untouched.gain.mean(axis=-1) * np.float32(slope_per_change)
        self._gain = np.ascontiguousarray(gain, dtype=np.float32)
        doubted, shown = sigma.shown
        reach = max(1, round(1.6 * untouched.settings.blur_px))
        self._numbers = {
            "per_step": sigma.per_step**2, "per_size": (sigma.per_step * sigma.per_slope) ** 2,
            "solved_factor": sigma.solved_factor, "unknown": STEEPEST_GEL,
            "unseen_sigma": unseen_sigma(sigma.full_confidence_sigma), "full": sigma.full_confidence_sigma,
            "per_bend": ERROR_OF_DIFFERENCE if walls else 0.0, "bend_from": DIFFERENCE_FROM,
            "spread": spread, "shown": shown, "per_excess": PER_EXCESS, "doubted": doubted,
            "steepest": STEEPEST_FACE, "carried": carried / 2, "reach": reach, **NO_BALL._asdict(),
        }  # fmt: skip

    def __call__(
        self,
        slopes: ReadSlopes,
        noise_levels: float = 0.0,  # its noise beyond the usual, gray levels, from `excess_noise`
        light: Map | None = None,  # (H, W), deviation of slopes from what is unsure of the frame's light
        *,
        depth: Map | None = None,  # (H, W), solved
        rows: bool = False,  # whether to keep each row
    ) -> Budget:
        """The budget of a frame.

        Within a ball around the depth's deepest pixel, the slopes that the ball shows are not doubted for being read by
        another unit's model.
        """
        numbers = self._numbers | {"outlier": slopes.outlier, "noise": noise_levels}
        if numbers["carried"] and depth is not None:
            row, column = divmod(int(np.argmax(depth)), depth.shape[1])
            ball = slopes_of_ball(slopes.gradients, (row, column), numbers["doubted"])
            numbers |= {} if ball is None else ball._asdict()
        of_numbers, of_rows = names_in_budget()
        shape = slopes.at_rest.shape
        read, solved, steep, whole, confidence = (np.empty(shape, np.float32) for _ in range(5))
        parts = np.empty((len(of_rows), *shape), np.float32) if rows else None
        _slope_budget(
            slopes.gradients, slopes.at_rest, self.rest_variance, slopes.variance, slopes.model_sigma, slopes.residual,
            slopes.unseen, self._gain, light, read, solved, steep, whole, confidence, parts,
            np.array([numbers[name] for name in of_numbers], dtype=np.float32),
        )  # fmt: skip
        return Budget(
            read, solved, steep, whole, confidence, {} if parts is None else dict(zip(of_rows, parts))
        )


EXPOSURE_STEP_PX = 8  # px, lattice step for the common change


def without_bias(
    color_change: Map,
    gradients: Slopes,
    threshold: float,
    hidden: Mask | None = None,
    given: Mask | None = None,
) -> tuple[Mask, tuple[Finding, ...]]:
    """The pixels (H, W) at rest, and a finding if they are few; their bias leaves the gradients (H, W, 2) in place.

    A pixel of the color change (H, W, 3) is at rest if it differs by less than the threshold from most, because an exposure
    step changes all alike, unless a marker hides it (H, W). If these are too few, the pixels that changed least are `given`.
    The bias is their median slope, because colors that drifted everywhere are no slope. Medians are over a lattice of some
    5000 pixels.

    ValueError: as `check_slopes` of the gradients.
    """
    height, width = gradients.shape[:2]
    step = lattice_step(height * width) if given is None else 1
    samples, coarse = (-(-height // one) * -(-width // one) for one in (step, EXPOSURE_STEP_PX))
    at_rest, refused = np.empty((height, width), dtype=bool), np.empty(1, dtype=np.int32)
    count = _slopes_at_rest(
        color_change, hidden, given, gradients, at_rest, refused, np.empty(2 * max(samples, coarse), dtype=np.float32),
        square=threshold**2, highest=HIGHEST_SLOPE, share=MIN_UNTOUCHED, coarse=EXPOSURE_STEP_PX, step=step,
    )  # fmt: skip
    if refused[0]:
        check_slopes(gradients)
    fraction = count / samples
    if given is not None or fraction >= MIN_UNTOUCHED:
        return at_rest, ()
    size = np.linalg.norm(color_change, axis=-1)
    least = size <= np.quantile(size, MIN_UNTOUCHED)
    message = (
        f"Only {100 * fraction:.1f} % of the pixels are at rest. Depth is relative to the least changed ones."
    )
    given, _ = without_bias(color_change, gradients, threshold, given=least)
    return given, (Finding("few_untouched", message, fraction),)


def noise_at_rest(
    model: PreparedColorModel, background: PreparedBackground, levels: Sequence[float] | None
) -> Map:
    """Variance (H, W) of the slopes at rest, if the image's noise were their only error.

    It is larger where light is weak, or where a slope changes the colors little. Noise makes a channel brighter, and the
    color model's derivative says by how much the slopes change; it is one difference for each channel. The noise counts as
    alike over the color change's blur, so only the ratio of two places is meant. `levels` are the standard deviation of a
    pixel's red, green and blue, gray levels; None if unknown.
    """
    rest = model.gradients_from_color(np.zeros_like(background.background))[0].copy()
    variance = np.zeros(rest.shape[:2], dtype=np.float32)
    for channel, level in enumerate(levels or (USUAL_LEVELS,) * 3):
        brighter = background.background.copy()
        brighter[..., channel] += np.float32(level)
        off = model.gradients_from_color(background.change(brighter))[0] - rest
        variance += off[..., 0] ** 2 + off[..., 1] ** 2
    # Light and model are smooth.
    return np.asarray(cv2.GaussianBlur(variance / 2, (0, 0), 8.0, borderType=cv2.BORDER_REPLICATE))


def unseen_sigma(full_confidence_sigma: float) -> float:
    """Standard deviation of a slope that nothing shows, mm/mm: its confidence is the least weight."""
    return full_confidence_sigma / LEAST_WEIGHT**0.5


def for_both(sigma: Array) -> Array:
    """One map (H, W) for both components (H, W, 2), read-only: as `np.broadcast_to`, in a tenth of its time."""
    both: Array = np.ndarray((*sigma.shape, 2), sigma.dtype, sigma, 0, (*sigma.strides, 0))
    both.flags.writeable = False
    return both


# Radii of the followed part; beyond, gel that hangs from the ball is gentle, or of something else.
GEL_RADII = 2.0
FOLLOWED = 0.85  # of the ball's slope that a ring reads; the same share is usual at the edge of contacts of the own unit


class ShownBall(NamedTuple):
    """Center and radius, px, of the disc that a ball and its gel fill, and the slope up to which the ball is followed."""

    ball_x: float
    ball_y: float
    ball_radius: float
    of_ball: float


NO_BALL = ShownBall(0.0, 0.0, 0.0, 0.0)


def slopes_of_ball(gradients: Slopes, top: tuple[int, int], gentle: float) -> ShownBall | None:
    """How far gradients (H, W, 2) follow a ball around its top (row, column); None where they show none.

    `gentle` is the slope up to which they are trusted.
    """
    reach = int(min(gradients.shape[:2]) / 3)  # half the side of the square around the top that is looked at
    # Every second pixel: a ring has enough of them.
    rows, columns = (slice(max(at - reach, 0), at + reach + 1, 2) for at in top)
    gradients = gradients[rows, columns]
    y, x = (
        2 * np.arange(n, dtype=np.float32) - (at - part.start)
        for n, at, part in zip(gradients.shape, top, (rows, columns))
    )
    squares = np.einsum("...i,...i", gradients, gradients)
    ring = np.hypot(y[:, None], x).astype(np.intp)
    steep = np.flatnonzero(_mean(np.sqrt(squares), ring) >= gentle)
    if not steep.size or steep[0] < 4:  # px; less says nothing of the gentle part's shape
        return None
    inner = ring < steep[0]
    normals = -gradients / np.sqrt(1 + squares)[..., None]
    place = 2.0 * np.argwhere(inner)[:, ::-1] - np.array([top[1] - columns.start, top[0] - rows.start])
    turned = normals[inner]
    away, off = place - place.mean(axis=0), turned - turned.mean(axis=0)
    per_px = float(np.sum(away * off) / np.sum(np.square(away)))
    # RMS of a ball's normals off the fit over their own: .26 at most on presses of four sensors, from .6 on a cube's edge.
    if per_px <= 0 or np.sum(np.square(off - per_px * away)) > 0.35**2 * np.sum(np.square(off)):
        return None
    center = place.mean(axis=0) - turned.mean(axis=0) / per_px
    v, u = y[:, None] - center[1], x - center[0]
    from_center = np.hypot(v, u)
    ring = from_center.astype(np.intp)
    outward = (normals[..., 0] * u + normals[..., 1] * v) / np.maximum(from_center, 1)
    share = _mean(outward, ring) / np.maximum(_mean(from_center, ring) * per_px, 1e-6)
    begin, end = steep[0] // 2, int(FOLLOWED / per_px)  # farther out a ball's slope grows without bound
    lost = np.flatnonzero(share[begin:end] < FOLLOWED)
    radius = float(begin + lost[0] if lost.size else min(end, len(share)))
    sine = per_px * radius
    slope = float(sine / np.sqrt(1 - sine**2))
    x_px, y_px = float(top[1] + center[0]), float(top[0] + center[1])
    return ShownBall(x_px, y_px, GEL_RADII * radius, max(slope, gentle))


def _mean(values: Map, ring: NDArray[np.intp]) -> Numbers:
    """The mean of each ring."""
    rings = ring.ravel()
    return np.asarray(np.bincount(rings, values.ravel()) / np.maximum(np.bincount(rings), 1))


@dataclass(frozen=True, eq=False)
class ExplainedFrame:
    """A frame's budget with its rows, and what its image showed where slopes are uncertain, in maps (H, W) or None."""

    budget: Budget
    full_confidence_sigma: float
    pixels: Image  # (H, W, 3) uint8, the raw image
    color_change: Map  # (H, W, 3)
    clipped: NDArray[np.uint8] | None  # (H, W, 3) uint8, the unusable channels
    markers: Mask | None  # hidden by markers
    lost: Mask | None  # lost by the camera
    outside: Mask | None  # without light at rest
    blur_px: float  # of the color change

    def hidden(self, where: Mask | bool | None) -> Map:
        """The deviation of slopes that nothing shows, at those pixels."""
        nothing, unseen = (
            np.zeros_like(self.budget.read),
            np.float32(unseen_sigma(self.full_confidence_sigma)),
        )
        return nothing if where is None else np.where(where, unseen, nothing)

    def outliers(self, where: Callable[[Map], Mask]) -> Map:
        """That of colors that no slope gives, by what the channels of their color change have in common, -1 to 1."""
        size = np.sqrt(np.mean(np.square(self.color_change), axis=-1))
        common = self.color_change.mean(axis=-1) / np.maximum(size, 1e-12)
        outliers = self.budget.rows["outlier"]
        return np.where(where(common), outliers, np.zeros_like(outliers))

    def lost_parts(self, *, bright: bool = False, dark: bool = False) -> Mask | bool | None:
        """The lost pixels that were bright, dark, or neither."""
        if self.lost is None:
            return None
        level = cv2.blur(self.pixels, (BLOCK_PX, BLOCK_PX))
        above = level.max(axis=-1) >= BELOW
        below = ~above & (level.min(axis=-1) <= LIT)
        return self.lost & (above if bright else below if dark else ~above & ~below)

    def at_end(self, *, upper: bool) -> Map:
        """What clipped channels and lost parts at one end of the camera cost."""
        found = self.hidden(self.lost_parts(bright=upper, dark=not upper))
        if self.clipped is None:
            return found
        rows = self.budget.rows
        cost = np.where(
            self.clipped.sum(axis=-1) > 1, self.hidden(True), np.hypot(rows["law"], rows["unseen"])
        )
        ends = (self.pixels >= SATURATED_FROM).any(axis=-1).view(np.uint8)
        bright = cv2.dilate(ends, bloom_disc(self.blur_px)) > 0
        return np.where(self.clipped.any(axis=-1) & (bright == upper), cost, found)


class Cause(NamedTuple):
    """One cause of low confidence: its text and color in the command line, the plots and the live page."""

    sentence: str  # sentence about the pixels that it is named for; "" if it is never named
    named_from: float  # mm/mm, smallest standard deviation that it has to add to a slope to be named
    color: str  # in pictures, "#rrggbb"
    of: Callable[[ExplainedFrame], Map] | None = None  # what it adds; None: the budget's row of its name


BLIND = 0.35  # mm/mm, standard deviation that leaves no information; about the slope of a ball's rim
SIX_SIGMA = 7.0  # mm/mm, standard deviation that a residual of 6 sigma adds; rims of real presses reach 5
# The colors are those of Okabe and Ito, distinct for every kind of color blindness; the last is not theirs.
CAUSES: dict[str, Cause] = {
    "saturated": Cause(
        "at the camera's upper end. Lower exposure, gain or the lights.", BLIND, "#e69f00",
        lambda frame: frame.at_end(upper=True),
    ),
    "dark": Cause(
        "at the camera's lower end. Is a light off, or the exposure too short?", BLIND, "#0072b2",
        lambda frame: frame.at_end(upper=False),
    ),
    "shadow": Cause(
        "darker than the slopes of the presses: a cast shadow, or a face steeper than they have shown.", SIX_SIGMA,
        "#56b4e9", lambda frame: frame.outliers(lambda common: common < -0.5),
    ),
    "specular": Cause(
        "brighter than the slopes of the presses: a mirrored light, or a face steeper than they have shown.", SIX_SIGMA,
        "#f0e442", lambda frame: frame.outliers(lambda common: common > 0.5),
    ),
    "off_gamut": Cause(
        "of colors that no slope gives: dust, a scratch, another gel, or slopes outside the training zone.", SIX_SIGMA,
        "#cc79a7", lambda frame: frame.outliers(lambda common: abs(common) <= 0.5),
    ),
    # Of a slope 0.23 beyond those that presses have shown.
    "steep": Cause("steeper than the presses have shown: at least about this slope.", 0.4, "#882255"),
    "inconsistent": Cause(
        "torn or from another moment: data of the frame were lost.", BLIND, "#d55e00",
        lambda frame: frame.hidden(frame.lost_parts()),
    ),
    "marker": Cause("hidden by markers.", BLIND, "#999999", lambda frame: frame.hidden(frame.markers)),
    "outside": Cause("not lit, or not gel.", BLIND, "#009e73", lambda frame: frame.hidden(frame.outside)),
    "wall": Cause("", BLIND, "#000000"),  # an object's edge is no fault
    "light": Cause("", BLIND, "#ffd8a8"),  # findings of the light name it
    "unit": Cause("", BLIND, "#7f7f00"),  # the finding of a starter names it
    "compression": Cause(
        "noisier than the calibrated images. Raise the JPEG quality, or lower the camera's gain.", 0.0, "#b08968"
    ),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Explanation:
    """The reasons for each pixel's confidence, in maps (H, W) of mm/mm."""

    maps: Mapping[str, Map]  # by cause: the deviation that it adds, in squares, to that of the slopes
    law: Map  # the rest, by the step and the size of the slope on held-out presses
    gradients_sigma: Map  # of the slopes as they were read; the larger of both components
    confidence: Map  # 0-1: min(1, (full_confidence_sigma / gradients_sigma)^2)
    full_confidence_sigma: float  # up to which confidence is 1, mm/mm

    @once
    def shares(self) -> dict[str, float]:
        """Share of the variance of each cause and of the law (`"law"`), averaged over the pixels; the shares add up to 1."""
        squares = {name: np.square(one) for name, one in (("law", self.law), *self.maps.items())}
        total = np.maximum(sum(squares.values()), np.float32(1e-12))
        found = {name: float(np.mean(square / total)) for name, square in squares.items()}
        return {name: fraction / sum(found.values()) for name, fraction in found.items()}

    @once
    def findings(self) -> tuple[Finding, ...]:
        """The important faults, each with the fraction of the frame where it alone leaves no information on a slope."""
        return tuple(
            Finding(name, f"{100 * fraction:.1f} % of the frame is {CAUSES[name].sentence}", fraction)
            for name, one in self.maps.items()
            if CAUSES[name].sentence and (fraction := _named_fraction(one > CAUSES[name].named_from)) > 0
        )

    @once
    def dominant(self) -> NDArray[np.uint8]:
        """The largest part of each pixel's variance (H, W): 0 for the law, k for the k-th of `maps`."""
        stack = np.stack([self.law, *self.maps.values()])
        return np.asarray(stack.argmax(axis=0), dtype=np.uint8)

    def to_dict(self) -> dict[str, Any]:
        """Its figures, as values that JSON can hold."""
        return {
            "full_confidence_sigma": self.full_confidence_sigma,
            "median_sigma": float(np.median(self.gradients_sigma)),
            "mean_confidence": float(self.confidence.mean()),
            "trusted_share": float((self.confidence >= 0.5).mean()),
            "variance_shares": self.shares,
            "findings": [asdict(finding) for finding in self.findings],
        }


def explanation_of(frame: ExplainedFrame) -> Explanation:
    """What each of `CAUSES` adds to the deviations of a frame's slopes.

    Pixels that show nothing are named for what hides them, and outliers for what their color looks like.
    """
    rows = frame.budget.rows
    found = {name: rows[name] if one.of is None else one.of(frame) for name, one in CAUSES.items()}
    total = sum(np.square(one) for one in rows.values())
    law = np.sqrt(np.maximum(total - sum(np.square(one) for one in found.values()), 0))
    return Explanation(found, law, np.sqrt(total), frame.budget.confidence, frame.full_confidence_sigma)


def _named_fraction(mask: Mask) -> float:
    """Share of the pixels in regions of a mask (H, W) that are large enough to be named; noise makes smaller ones."""
    _, _, boxes, _ = cv2.connectedComponentsWithStats(mask.view(np.uint8), connectivity=8)
    areas = boxes[1:, cv2.CC_STAT_AREA]
    return float(areas[areas >= 12].sum()) / mask.size
