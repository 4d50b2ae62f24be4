"""The light of a frame relative to the background's: a gain, and where the frame shows it, a tilt and the room's light.

Exposure and white balance multiply each channel by a gain. A lamp that has moved makes the light tilt over the image, and a
lit room adds to all pixels alike. Four lights compete: the gain alone, with a tilt, with room light, and with both. Each is
fitted to about 300 blocks by Gauss-Newton, as I = exp(L(x, y)) B + r, with a prior and with touched blocks as outliers. The
one with the most evidence is chosen (Bishop, Pattern Recognition and Machine Learning, 2006, section 3.4), and the gain
alone unless another beats it clearly. A richer light (cubic) would take the gel's sinking around a contact for light.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import cv2
import numpy as np

from gelform._native import Kernel
from gelform.arrays import Array, Image, Map, Mask, Numbers
from gelform.foundations.filters import CHANGE_OFFSET
from gelform.foundations.pool import once
from gelform.image.view import BRIGHT, DARK

EVERY = 2  # one of so many rows and columns of blocks is used; neighbors share their errors
# Standard deviation of a light's logarithm by degree, from the same unit's exposure, white balance and lamps, and from
# those of other units of a make.
LIGHT_SIGMAS = (0.15, 0.08, 0.05, 0.04)
REST_SIGMA = 0.0165  # of a block's logarithm at rest, beyond the light; the largest of four sensors
LEAST_REST = 0.004  # a block's logarithm at rest never agrees better
TOUCHED_SIGMA = 0.6  # of that of a touched block; half of the blocks may be touched
ALIKE = 31  # independent blocks that an image's are worth, because neighbors share their errors
# Of the deviation at rest in each round of the fit; a light that starts near its end needs the last four.
WIDENED = np.array([8.0, 3, 1, 1, 1, 1])
# Nats that a tilt and room light promise before they are fitted, and by which a light beats the gain, a reading all others,
# and a sensor of another light. Of six sensors, 71 of 71 frames win by 13 or more; of other units none wins by as much in a
# wrong reading.
MARGIN = 10.0
# Of the prior of gain, tilt to the right and down (logarithms), and room light (gray levels).
PRIOR = np.array([LIGHT_SIGMAS[0], LIGHT_SIGMAS[1], LIGHT_SIGMAS[1], 20.0]) ** -2.0
GAIN, WITH_ROOM, TILTED, BOTH = (
    np.array([True, tilted, tilted, room]) for tilted in (False, True) for room in (False, True)
)

_means_of_bytes = Kernel(
    "means_of_bytes", "u8[h,w,3] image, i64 step, out u16[n] work, out f32[bh,bw,3] means"
)
_gain_of_blocks = Kernel(
    "gain_of_blocks",
    "u8[h,w,3]? image, out f32[bh,bw,3] blocks, f32[bh,bw,3] untouched, f64[4] prior, bool[4] is_free, f64[rounds] widened, "
    "out f32[8,n] lit, out f64[3,4] values, out f64[3,4,4] normal, out f32[n] farthest, out f64[5] figures, "
    "out f64[4] beside, out f32[m] work, i64 step, f32 dark, f32 bright, f64 sigma, f64 least, f64 most, f64 wide, "
    "f64 alike, f32 offset",
)
_fit_light = Kernel(
    "fit_light",
    "f32[8,n] lit, i64 count, f64[4] prior, bool[4] is_free, f64[rounds] widened, out f64[3,4] values, "
    "out f64[3,4,4] normal, out f32[n] farthest, out f64[5] figures, out f32[m] work, f64 sigma, f64 least, f64 most, "
    "f64 wide, f64 alike, f32 offset",
)
_correlation = Kernel(
    "least_changed_correlation",
    "f32[n,3] seen, f32[n,3] untouched, f32[3] scale, out f32[m] work, out f64[1] correlation",
)


def block_means(image: Array) -> Map:
    """Means over about 1200 square blocks, (h, w, 3) float32: each averages out the noise and is smaller than a contact."""
    means, pixels = block_means_later(image)
    if pixels is not None:
        width = pixels.shape[1]
        _means_of_bytes(pixels, width // means.shape[1], np.empty(3 * width, dtype=np.uint16), means)
    return means


def block_means_later(image: Array) -> tuple[Map, Image | None]:
    """An unset array (h, w, 3) for `block_means`, and the pixels (H, W, 3) for a kernel to average; or the means."""
    height, width = image.shape[:2]
    step = max(1.0, (height * width / 1200) ** 0.5)
    size = (max(1, round(width / step)), max(1, round(height / step)))
    block = width // size[0]  # OpenCV rounds halves up for 2x2 pixels, to even for more
    if image.dtype == np.uint8 and (height, width) == (block * size[1], block * size[0]) and 2 < block <= 256:
        return np.empty((size[1], size[0], 3), dtype=np.float32), np.ascontiguousarray(image)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.float32), None


@dataclass(frozen=True)
class FrameLight:
    """The light of a frame relative to the background's."""

    values: Numbers = field(default_factory=lambda: np.zeros((3, 4)))  # (3, 4), as those of `lit`
    fit: _Fit | None = (
        None  # that its covariance follows from; None: nothing is known but the prior of the gain
    )
    is_known: bool = False  # whether the gain's standard deviation in this tilt and room light is 1 % or less
    # of the image that is at rest in this light, 0-1; 0 if each block is dark or saturated in one of the images
    share: float = 0.0
    # of the quarter of the image that changed least, after this light; 0.01 is one per cent of its brightness: it is
    # noise and small drift for a frame of this sensor, whatever touches it; it is more for another sensor
    least_change: float = np.inf
    # least_pattern, middle_pattern: that of the quarter and of the half that changed least, after a gain alone
    least_pattern: float = np.inf
    middle_pattern: float = np.inf
    # with the background over the half of the blocks that changed least, without this light, channels together; 0 if only
    # the image is featureless, NaN if the background is
    correlation: float = np.nan

    @property
    def covariance(self) -> Numbers:
        """Of each channel's values, (3, 4, 4); 0 for a tilt and room light that were not fitted."""
        return np.tile(np.diag(GAIN / PRIOR), (3, 1, 1)) if self.fit is None else self.fit.covariance

    @once
    def is_plain(self) -> bool:
        """Whether the frame differs by a gain at most."""
        return not np.count_nonzero(self.values[:, 1:])

    @once
    def gain(self) -> Numbers:
        """Brightness (3,) in the middle over the background's, without the room's light."""
        return np.asarray(np.exp(self.values[:, 0]))

    @property
    def tilt(self) -> Numbers:
        """Logarithm (3, 2) by which red, green and blue grow from the middle to the right and to the lower border."""
        return self.values[:, 1:3]

    @property
    def room(self) -> Numbers:
        """Gray levels (3,) that the room's light adds to red, green and blue."""
        return self.values[:, 3]

    def change_sigma(self, untouched: Map) -> Map:
        """Standard deviation (h, w) of the color change from an unsure light, over background blocks (h, w, 3).

        It is the root mean square of the channels.
        """
        y, x = (place.ravel() for place in np.meshgrid(*map(_centers, untouched.shape[:2]), indexing="ij"))
        per_level = 1 / (untouched.reshape(-1, 3).T + CHANGE_OFFSET)
        terms = np.stack(np.broadcast_arrays(1.0, x, y, per_level), axis=1)
        square = ((self.covariance @ terms) * terms).sum(axis=(0, 1)) / 3
        return np.sqrt(square).reshape(untouched.shape[:2]).astype(np.float32)


class _Fit(NamedTuple):
    """A fitted light, and what the kernel says of it; PRIOR makes its normal matrices definite."""

    values: Numbers  # (3, 4)
    free: Mask  # (4,), terms; one that is not free has 1 on the matrices' diagonal alone
    normal: Numbers  # (3, 4, 4)
    far: Map  # (n,), the blocks' changes beyond it, as fractions, of the channel that changed most
    rest_sigma: float
    at_rest: float
    likelihood: float
    evidence: float
    promised: float  # nats by which a tilt and room light would fit better

    @property
    def covariance(self) -> Numbers:
        """Of the values, (3, 4, 4)."""
        both = np.outer(self.free, self.free)
        return np.asarray(np.linalg.inv(np.where(both, self.normal, np.eye(4))) * both, dtype=np.float64)

    @property
    def has_room(self) -> bool:
        """Whether the light that is added can be a room's: it reaches all channels, with one sign.

        Each has over 0.2 of the most that one has; on a GelSlim, a shadow in red alone looks like room light.
        """
        room = self.values[:, 3] * np.sign(self.values[:, 3].sum())
        return bool(room.min() > 0.2 * room.max())

    @property
    def is_likely(self) -> bool:
        """Whether tilt and room light are within 2 sigma of the prior; mirrored images of four sensors need 2.4 or more."""
        return bool((np.abs(self.values[:, 1:]) <= 2.0 * PRIOR[1:] ** -0.5).all())


class _LitBlocks:
    """The blocks (h, w, 3) of an image that are neither dark nor saturated in it and in a background image.

    They come with the light as a gain alone, and with the likeness in it. `pixels`: their means go to the blocks first.
    """

    def __init__(self, blocks: Map, untouched: Map, every: int = EVERY, pixels: Image | None = None) -> None:
        height, width = (-(-size // every) for size in blocks.shape[:2])
        self.total, size = height * width, height * width + 1
        row = 0 if pixels is None else 3 * pixels.shape[1]
        work_size = max(14 * size, 2 * (blocks.size // 3), -(-row // 2))
        self._lit, self._work = np.empty((8, size), np.float32), np.empty(work_size, np.float32)
        self._blocks = blocks, untouched
        values, beside, (normal, far, figures) = np.empty((3, 4)), np.empty(4), self._unset()
        self.count = _gain_of_blocks(
            pixels, blocks, untouched, PRIOR, GAIN, WIDENED, self._lit, values, normal, far, figures, beside, self._work,
            step=every, dark=DARK, bright=BRIGHT, sigma=REST_SIGMA, least=LEAST_REST, most=REST_SIGMA, wide=TOUCHED_SIGMA,
            alike=ALIKE, offset=CHANGE_OFFSET,
        )  # fmt: skip
        self.gain = _Fit(values, GAIN, normal, far[: self.count], *figures.tolist())
        self._beside = beside.tolist()

    def _unset(self) -> tuple[Numbers, Map, Numbers]:
        """The arrays of a fit: its normal matrices, the blocks' changes, and figures."""
        return np.empty((3, 4, 4)), np.empty(self._lit.shape[1], np.float32), np.empty(5)

    def fit(
        self,
        free: Mask,
        start: Numbers,
        sigma: float | None = None,
        widened: Numbers = WIDENED,
        most: float = np.inf,
    ) -> _Fit:
        """The light with these terms (4,) from a start (3, 4).

        It learns the sigma of the blocks at rest, up to `most`, if it is None.
        """
        values, (normal, far, figures) = start.copy(), self._unset()
        _fit_light(
            self._lit, self.count, PRIOR, free, widened, values, normal, far, figures, self._work, sigma=sigma or REST_SIGMA,
            least=LEAST_REST, most=0.0 if sigma else most, wide=TOUCHED_SIGMA, alike=ALIKE, offset=CHANGE_OFFSET,
        )  # fmt: skip
        return _Fit(values, free, normal, far[: self.count], *figures.tolist())

    def light(self, fit: _Fit | None = None) -> FrameLight:
        """The light of a fit, by default the gain alone."""
        quarter, half, information, correlation = self._beside
        if not self.count:
            return FrameLight(correlation=correlation)
        least = quarter
        if fit is not None:
            least, information = (
                float(np.partition(fit.far, at := self.count // 4)[at]),
                fit.normal[:, 0, 0].min(),
            )
            correlation = self._correlation(fit.values)
        fit = fit or self.gain
        # With a deviation of the gain's logarithm above 0.01, less than a tenth of the image agrees.
        is_known = bool(information >= 0.01**-2)
        return FrameLight(
            fit.values, fit, is_known, fit.at_rest / self.total, least, quarter, half, correlation
        )

    def _correlation(self, light: Numbers) -> float:
        """The correlation of `FrameLight` in a light (3, 4)."""
        blocks, untouched = self._blocks
        found, seen = np.empty(1), without_light(blocks, light)
        ones = np.ones(3, dtype=np.float32)
        _correlation(seen.reshape(-1, 3), untouched.reshape(-1, 3), ones, self._work, found)
        return float(found[0])


def gain_from_blocks(blocks: Map, untouched: Map) -> FrameLight:
    """The light of an image as a gain alone, both from `block_means`."""
    return _LitBlocks(blocks, untouched).light()


def light_from_blocks(
    blocks: Map, untouched: Map, usual: FrameLight | None = None, pixels: Image | None = None
) -> FrameLight:
    """The light of an image relative to a background image, both from `block_means`; of the blocks at rest.

    A large contact does not bias the gain, but can leave too few blocks at rest to measure it. Then `is_known` is False,
    and the covariance says how little is known. `usual` is the light of the moments before: it stays, but for the gain,
    if it fits better than a gain and no light clearly better. Blocks and `pixels` may be those of `block_means_later`.
    """
    lit_blocks = _LitBlocks(blocks, untouched, pixels=pixels)
    gain = lit_blocks.gain
    if not lit_blocks.count:
        return lit_blocks.light()
    if usual is not None and not usual.is_plain:
        again = lit_blocks.fit(GAIN, usual.values, most=REST_SIGMA)
        alone = lit_blocks.fit(GAIN, gain.values, again.rest_sigma, WIDENED[2:])
        if again.promised <= MARGIN and again.likelihood > alone.likelihood:
            return replace(lit_blocks.light(again), fit=usual.fit)
    if gain.promised <= MARGIN:
        return lit_blocks.light()
    both = lit_blocks.fit(BOTH, gain.values)
    alone, *others = (
        lit_blocks.fit(free, np.where(free, start.values, 0), both.rest_sigma, WIDENED[2:])
        for free, start in ((GAIN, gain), (TILTED, both), (WITH_ROOM, both), (BOTH, both))
    )
    best = max((one for one in others if one.has_room or not one.free[3]), key=lambda one: one.evidence)
    is_better = best.evidence - alone.evidence > MARGIN and best.is_likely
    return lit_blocks.light(best if is_better else None)


def light_at_rest(blocks: Map, untouched: Map, start: Numbers) -> Numbers:
    """The light (3, 4) of an untouched gel's blocks (h, w, 3), fitted from one near it; blocks of 0 do not count.

    All terms are fitted: where nothing touches, a term too many costs nothing.
    """
    return _LitBlocks(blocks, untouched, every=1).fit(BOTH, start).values


def lit(levels: Map, light: Numbers) -> Map:
    """An image or its blocks (H, W, 3) in another light (3, 4).

    A light is, of each channel: the logarithm by which it is brighter in the middle, what is added to this to the right
    border and to the lower border, and the gray levels that a room's light adds.
    """
    return np.asarray(
        levels * _factor(levels.shape, light) + light[:, 3].astype(np.float32), dtype=np.float32
    )


def without_light(levels: Array, light: Numbers) -> Map:
    """The image or the blocks (H, W, 3) that `lit` makes of: its inverse, but 0 for what is darker than the room's light."""
    left = np.maximum(levels - light[:, 3].astype(np.float32), np.float32(0))
    return np.asarray(left / _factor(levels.shape, light), dtype=np.float32)


def scale_of_light(shape: tuple[int, ...], light: Numbers) -> Map:
    """What undoes a light of an image (H, W, 3): factors of its columns (3 W,).

    After them come, unless the light is a gain, factors of its rows (3 H,), and gray levels (3,) to subtract before.
    """
    if not np.count_nonzero(light[:, 1:]):
        columns = np.empty((shape[1], 3), dtype=np.float32)
        columns[:] = np.exp(-light[:, 0])
        return columns.ravel()
    y, x = map(_centers, shape[:2])
    columns, rows = np.exp(-light[:, 0] - x[:, None] * light[:, 1]), np.exp(-y[:, None] * light[:, 2])
    return np.concatenate([columns, rows, light[None, :, 3]]).ravel().astype(np.float32)


def _factor(shape: tuple[int, ...], light: Numbers) -> Map:
    """What a light multiplies pixels or blocks by, (H, W, 3)."""
    y, x = map(_centers, shape[:2])
    columns = np.exp(light[:, 0] + x[:, None] * light[:, 1]).astype(np.float32)
    return np.asarray(columns * np.exp(y[:, None, None] * light[:, 2]).astype(np.float32))


def _centers(count: int) -> Numbers:
    """The middles of `count` equal parts of -1 to 1."""
    return (2 * np.arange(count) + 1) / count - 1
