"""The standard deviation of a frame's depth: from its slopes at rest, its contact, its negative depths and common errors.

Errors of single slopes average out; what moves depth is shared by many of them. Far from a contact, the solved slopes
themselves are such errors, because the gel is flat there. A contact causes more of them: lobes that fall off beside it. A
squared slope error at a distance r moves depth by K(r) = |grad G|^2, with the influence G = K0(r/L) / (2 pi) of a membrane
of the length L. Depth cannot be negative, so what negative depths have beyond that is one more error of the frame.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from gelform._native import Kernel
from gelform.arrays import Array, Floats, Map, Mask, Slopes
from gelform.depth.coarse import Coarse, coarse_of
from gelform.depth.contact import runs_work
from gelform.depth.solvers.dct import CosineFilter
from gelform.errors import ConvergenceError, Finding
from gelform.foundations.filters import SIGMA_OF_MEDIAN, bessel_k
from gelform.foundations.pool import once

# Parts of the image's height: the influence's length L, and the standard deviation of the window for negative depths. Depth
# off contact is covered alike with half and twice of either, on twelve real sets.
LENGTH, WINDOW = 1 / 8, 1 / 12
PULL = 0.5  # share of what negative depths have beyond the variance; half of all errors are positive
LEAST_FREE = 0.05  # share of pixels around a cell that may be negative; fewer do not tell an error
# mm/mm, deviation of a steep slope from which on depth may be missing: nearly none on balls of the own unit, whose depth is
# right, but on faces that another unit's model reads.
DOUBTED = 0.28

_depth_errors = Kernel(
    "depth_errors",
    "f32[h,w,2] slopes, f32[h,w] depth, bool[h,w] at_rest, bool[h,w] known, f32[h,w] read, f32[h,w] steep, "
    "i32[row_ends] rows, i32[column_ends] columns, out f32[n] work, out f32[maps,r,c] cells, out f32[2] own, f32 full, "
    "f32 spill, f32 rest_share, f32 spill_of_contact, f32 gain, f32 doubted, f32 least, f32 per_median",
)
_over_rest = Kernel("over_rest", "out f32[r,c] map, f32[r,c] at_rest, out f32[n] work, f32 share")
_depth_variances = Kernel(
    "depth_variances",
    "out f32[r,c] common, f32[r,c] at_rest, f32[4,r,c] filtered, f32[r,c] border, out f32[n] work, f32 share, "
    "out f32[7,r,c] variances, f32 of_frame, f32 usual, f32 pull, f32 least_free, f32 least",
)
MAPS = 10  # that `depth_errors` sums; the same as in native/depth/errors.c


class DepthSigma:
    """Standard deviations of depth for the frames of one calibration. It is immutable; threads can share it."""

    def __init__(
        self,
        shape: tuple[int, int],
        mm_per_px: float,
        *,
        full_confidence_sigma: float,  # of a slope of confidence 1, mm/mm
        factor: float,  # k of the calibration: `depth_factor` of its `SlopeSigma`
        gain_sigma: float,  # relative error that slopes share
    ) -> None:
        self.coarse = coarse = coarse_of(shape)
        self._mm_per_px = np.float32(mm_per_px)
        self._rows, self._columns = (
            np.rint(np.linspace(0, size, cells + 1)).astype(np.int32)
            for size, cells in zip(shape, coarse.shape)
        )
        # `spill` is the share of a slope that is an error elsewhere than at rest; on real Minis, beside contacts. For
        # contacts, whose own noise is judged at their place, another one counts, and `rest_share` of the variance at rest.
        self.numbers = {
            "full": full_confidence_sigma, "spill": 0.3, "rest_share": 0.2, "spill_of_contact": 0.6,
            "gain": gain_sigma, "doubted": DOUBTED, "least": LEAST_FREE, "per_median": SIGMA_OF_MEDIAN**2 / 2,
        }  # fmt: skip
        self._beside_border = _beside_border(coarse, shape)
        spread = _spread(coarse, shape) * np.float32((factor * mm_per_px) ** 2)
        self._filter = CosineFilter(np.stack([spread, spread, *[_window(coarse, shape)] * 2]))

    def __call__(
        self,
        slopes: Slopes,  # (H, W, 2), of the depth
        depth: Map,  # (H, W), mm
        at_rest: Mask,  # (H, W), pixels at rest
        known: Mask,  # (H, W), pixels whose depth was not filled in
        read: Map,  # (H, W), deviation of the slopes as read
        steep: Map,  # (H, W), the one of steep slopes
    ) -> DepthErrors:
        """The errors of a depth; ConvergenceError: float32 cannot hold them."""
        cells, own_of_frame = np.empty((MAPS, *self.coarse.shape), np.float32), np.empty(2, np.float32)
        work = np.empty(max(MAPS * depth.shape[1], 2 * cells[0].size), dtype=np.float32)
        beyond_float = _depth_errors(
            slopes, depth, at_rest, known, read, steep, self._rows, self._columns, work, cells, own_of_frame,
            **self.numbers,
        )  # fmt: skip
        if beyond_float:
            raise ConvergenceError(
                "Expected a finite standard deviation of depth, got infinity or NaN. Slopes, their deviation or "
                "mm_per_px differ by more than float32 holds: check the calibration's scales."
            )
        of_frame, usual = own_of_frame.tolist()
        return DepthErrors(
            self.coarse, cells[4:], self._filter(cells[:4]), self._beside_border, of_frame, usual, self._mm_per_px,
            self.numbers["gain"],
        )  # fmt: skip


Purpose = Literal["stated", "contact", "outline", "valley"]
# The maps of `depth_variances`.
VARIANCES = "valley", "own", "single", "stated", "contact", "outline", "deepest"


@dataclass(frozen=True, eq=False)
class DepthErrors:
    """The errors of one frame's depth on the coarser grid (r, c)."""

    coarse: Coarse
    # (6, r, c), the depth, what steep faces add to slopes that are off in proportion (p, q), slopes of steep faces that
    # may be missing (p, q), and the share of pixels at rest
    means: Map = field(repr=False)
    filtered: Map = field(repr=False)  # (4, r, c), what squared errors and negative depths make around
    border: Map = field(repr=False)  # factor of the first two beside a border
    own_of_frame: float  # twice the mean square of negative depths in the whole frame, mm^2
    usual_of_frame: float  # the same by the median of negative depths, which a valley does not move
    mm_per_px: np.float32
    gain_sigma: float

    @once
    def _on_grid(self) -> tuple[Map, Map]:
        """`common_mm`, and the variances (7, r, c) that `depth_variances` makes with it, mm^2."""
        common = np.float32(self.gain_sigma) * self.means[0]
        if self.is_steep:
            common += self._integrated(self.means[1:3])
        variances = np.empty((len(VARIANCES), *common.shape), dtype=np.float32)
        _depth_variances(
            common, self.means[5], self.filtered, self.border, *_at_rest(common), variances, self.own_of_frame,
            self.usual_of_frame, PULL, LEAST_FREE, 1e-14,  # mm^2; the filter rounds
        )  # fmt: skip
        return common, variances

    @property
    def common_mm(self) -> Map:
        """Depth that all slopes in proportion and steep ones may be off by together, one standard deviation; 0 at rest.

        It is 0 in the largest part at rest, whatever faces beside it are. A part behind walls, as the top of a punch, is as
        wrong as they are.
        """
        return self._on_grid[0]

    @once
    def steep_mm(self) -> Map:
        """The same of steep slopes alone."""
        if not self.is_steep:
            return np.zeros_like(self.spread)
        depth = self._integrated(self.means[3:5])
        _over_rest(depth, self.means[5], *_at_rest(depth))
        return depth

    @once
    def is_steep(self) -> bool:
        """Whether slopes of steep faces may be missing."""
        return bool(self.means[3:5].any())

    @property
    def spread(self) -> Map:
        """Variance (r, c) by the slopes, mm^2."""
        return self._variance("valley")

    @property
    def own(self) -> Map:
        """Twice the mean square (r, c) of negative depths around, mm^2."""
        return self._variance("own")

    @property
    def coarse_variance(self) -> Map:
        """Variance (r, c) by both, without what is common."""
        return self._variance("single")

    @property
    def of_contacts(self) -> Map:
        """Those (3, r, c) of "contact", "outline", and the deepest contact, whose reaction valleys beside it may be."""
        return self._on_grid[1][VARIANCES.index("contact") :]

    def _variance(self, name: str) -> Map:
        return self._on_grid[1][VARIANCES.index(name)]

    def sigma(self, most_mm: float, purpose: Purpose = "stated", lost: Mask | None = None) -> Map:
        """Standard deviation (H, W) of the depth, mm, `most_mm` at most and at lost pixels (H, W), for a purpose.

        All but the first leave out what all depths have in common, which makes no contact less certain.

        - stated: what a result states
        - contact: whether something touches: by the negative depths of the whole frame, because a hill that another light
          makes may lie far from the valleys that it makes
        - outline: where a contact ends: by negative depths alone, those around each pixel too
        - valley: whether a valley is a touch in the background: by the slopes alone, as if negative depths were no error
        """
        return self.coarse.root_at_pixels(self._variance(purpose), most_mm, lost)

    def _integrated(self, slopes: Map) -> Map:
        """Depth, mm, of slopes (2, r, c)."""
        return self.coarse.depth_px(np.ascontiguousarray(np.moveaxis(slopes, 0, -1))) * self.mm_per_px


def _at_rest(depth: Map) -> tuple[Floats, float]:
    """Work for a depth over rest, and the share of a cell's pixels above which it is at rest."""
    return np.empty(runs_work(depth.shape) + 2 * depth.size + -(-depth.size // 4), dtype=np.float32), 0.5


def squared_factor(square: Map, own: Map, per_unit: Floats) -> Map:
    """Squares of the factor at which `DepthErrors.coarse_variance` is a squared error, mm^2; 0 where `own` alone exceeds it.

    `per_unit` is the variance by the slopes and a factor of 1, `own` that of negative depths.
    """
    of_slopes = np.where(square > own, square, (square - np.float32(PULL) * own) / np.float32(1 - PULL))
    return np.asarray(np.maximum(of_slopes, 0) / per_unit, dtype=np.float32)


def steep_finding(depth_mm: Map, contact: Mask, steep: Map, errors: DepthErrors) -> tuple[Finding, ...]:
    """A finding if what steep faces may miss of an object's height exceeds three standard deviations of the rest.

    `steep` (H, W) is the deviation of steep slopes, in the depth (H, W) and its contact (H, W).
    """
    if not errors.is_steep:
        return ()
    at, deepest = errors.coarse.at_pixel, divmod(int(np.argmax(depth_mm)), depth_mm.shape[1])
    rest = at(errors.coarse_variance, deepest) + (errors.gain_sigma * float(depth_mm[deepest])) ** 2
    if at(errors.common_mm, deepest) ** 2 <= 9 * rest:  # steep faces are a part of that
        return ()
    missing_mm = at(errors.steep_mm, deepest)
    if missing_mm**2 <= 9 * rest:
        return ()
    doubted = contact & (steep > np.float32(DOUBTED))
    share = float(doubted.mean()) / max(float(contact.mean()), 1e-9)
    message = (
        f"{100 * share:.0f} % of the contact are faces steeper than the presses have shown. If they are read too small, "
        f"{missing_mm:.2f} mm (one standard deviation) of the height above them are missing. "
        "Press balls deeper on this unit to calibrate it."
    )
    return (Finding("steep", message, missing_mm),)


def contradicted_slopes(read: Slopes, solved: Slopes, depth: Map, contact: Mask) -> tuple[Finding, ...]:
    """A finding if slopes (H, W, 2) of unknown deviation are no surface's: for models whose errors no press has shown.

    The slopes in the contact are off those of the solved depth (H, W) by more than half their size, or a valley is deeper
    than half the height.
    """
    if not contact.any():
        return ()
    off, size = (float(np.sqrt(np.mean(np.square(one[contact])))) for one in (read - solved, solved))
    valley, height = -float(depth.min()), float(depth.max())
    if 2 * max(off / size, valley / height) <= 1:
        return ()
    message = (
        "The slopes contradict each other, or what they should give: in the contact they are off those of any surface by "
        f"{100 * off / size:.0f} %, and the deepest valley has {100 * max(valley, 0) / height:.0f} % of the height. "
        "The imported model does not fit this sensor. Check its range, its signs and the background, or press a ball to "
        "calibrate."
    )
    return (Finding("slopes_contradict", message, max(off / size, valley / height)),)


def _spread(coarse: Coarse, shape: tuple[int, int]) -> Map:
    """Gains of the grid's cosine modes for the mirrored kernel |grad G|^2, averaged over cells, for slopes^2 -> px^2."""
    length, (x_px, y_px) = shape[0] * LENGTH, coarse.pitch_px
    points = (np.arange(8) + 0.5) / 8 - 0.5  # along a cell's side
    y, x = np.arange(coarse.shape[0]) * y_px, np.arange(coarse.shape[1]) * x_px
    least_px = 0.6  # the kernel is cut below: a pixel's own slopes do not move it further
    # K1 is smooth in a logarithmic table, and falls to nothing within 15 lengths.
    table = np.geomspace(least_px / length, 15.0, 400)
    squares = np.square(bessel_k(1, table) / (2 * np.pi * length))
    kernel = np.zeros(coarse.shape)
    for below in points * y_px:
        for right in points * x_px:
            distance = np.maximum(np.hypot(y[:, None] + below, x + right), least_px) / length
            kernel += np.exp(np.interp(np.log(distance), np.log(table), np.log(squares)))
    return _mode_gains(kernel * x_px * y_px / points.size**2)


def _beside_border(coarse: Coarse, shape: tuple[int, int]) -> Map:
    """How much more an error moves depth beside a free border: its mirror image moves it the same way.

    At the border both are one, so the variance of their sum is twice the sum of their variances; it falls off over half L.
    """
    rows, columns = (
        1 + np.exp(-np.minimum(at, at[::-1]) * pitch * 2 / (shape[0] * LENGTH))
        for at, pitch in (
            (np.arange(n) + 0.5, pitch) for n, pitch in zip(coarse.shape, coarse.pitch_px[::-1])
        )
    )
    return np.outer(rows, columns).astype(np.float32)


def _window(coarse: Coarse, shape: tuple[int, int]) -> Map:
    """Gains of the grid's cosine modes for a mirrored Gaussian window."""
    steps = (np.arange(n) * pitch for n, pitch in zip(coarse.shape, coarse.pitch_px[::-1]))
    gains = _mode_gains(np.outer(*(np.exp(-np.square(px / (shape[0] * WINDOW)) / 2) for px in steps)))
    return gains / gains[0, 0]


def _mode_gains(kernel: Array) -> Floats:
    """Gains of cosine modes for the convolution with an even kernel, given from its center on."""
    tables = []
    for n in kernel.shape:
        places = np.arange(n)
        tables.append(np.cos(np.pi * np.outer(places, places) / n) * np.where(places == 0, 1, 2))
    half = np.einsum("kn,nm->km", tables[0], kernel)  # no matrix product: its bits depend on the processor
    return np.asarray(np.einsum("km,lm->kl", half, tables[1]), dtype=np.float32)
