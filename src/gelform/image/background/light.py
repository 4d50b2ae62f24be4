"""The light of a frame relative to the background's: a gain, and where the frame shows it, a tilt and the room's light.

The exposure is a gain of each channel (`exposure.py`). A lamp that has moved makes the light tilt over the image, and a lit
room adds to all pixels alike. Four lights compete: the gain alone, with room light, tilted, and both. Each is fitted to the
blocks by Gauss-Newton, as I = exp(L(x, y)) B + r, with a prior and with touched blocks as outliers. The one with the most
evidence is chosen (Bishop, Pattern Recognition and Machine Learning, 2006, section 3.4), and the gain alone unless another
beats it clearly. A richer light (cubic) would take the gel's sinking around a contact for light.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.foundations.filters import CHANGE_OFFSET
from gelform.image.background.exposure import Exposure, exposure_from_blocks
from gelform.image.background.orientation import (
    ALIKE,
    LIGHT_SIGMAS,
    MARGIN,
    REST_SIGMA,
    TOUCHED_SIGMA,
)
from gelform.image.frame import BRIGHT, DARK

EVERY = 2  # one of so many rows and columns of blocks is used; neighbors share their errors
ROOM_SIGMA = 20.0  # gray levels, standard deviation of a room's light
# Gray levels, the fit's starts; without the nearest one's room light, most blocks agree on a gain.
ROOMS = (-20.0, 0.0, 10.0, 20.0, 40.0)
WIDENED = np.array([8.0, 4, 2, 1, 1, 1, 1, 1])  # of the deviation at rest in each round of the fit
LEAST_REST = 0.004  # a block's logarithm at rest never agrees better
STAYS = np.ones(2)  # rounds of the screen, which only learns the deviation at rest
SCREEN = 8.0  # nats that a tilt and room light have to promise before they are fitted
LEAST_OF_ROOM = (
    0.2  # of the channel that a room lights most; on a GelSlim, a shadow in red alone looks like room light
)
# Standard deviations of the prior that a tilt or room light may have: a mirrored image of four sensors needs 2.4 or more.
MOST = 2.0
PRIOR = np.array([LIGHT_SIGMAS[0], LIGHT_SIGMAS[1], LIGHT_SIGMAS[1], ROOM_SIGMA]) ** -2.0

_fit_light = Kernel(
    "fit_light",
    "f32[h,w,3] image, f32[h,w,3] untouched, f64[4] prior, f64[rounds] widened, out f64[3,4] values, out f64[3,4,4] normal, "
    "out f64[3,4] side, out f64[n] square, out f64[1] rest, out f64[m] work, f64 sigma, f64 least, f64 wide, f64 alike, "
    "f64 offset, f32 dark, f32 bright, i32 learns, i32 moves",
)


@dataclass(frozen=True)
class FrameLight:
    """The light of a frame relative to the background's.

    Attributes
    ----------
    exposure : of the frame without `room` and `tilt`
    values : (3, 4), as those of `lit`, but with the exposure in the place of the logarithm in the middle, which is 0
    covariance : (3, 4, 4), of each channel's values; None: only a gain was fitted
    """

    exposure: Exposure
    values: NDArray[np.float64] = field(default_factory=lambda: np.zeros((3, 4)))
    covariance: NDArray[np.float64] | None = None

    @property
    def is_plain(self) -> bool:
        """Whether the frame differs by a gain at most."""
        return self.covariance is None

    @property
    def whole(self) -> NDArray[np.float64]:
        """The values with the exposure's gain, as those of `lit`; without it if the gain is unknown."""
        gain = self.exposure.gain
        return self.values if gain is None else np.c_[np.log(gain), self.values[:, 1:]]

    @property
    def tilt(self) -> NDArray[np.float64]:
        """Logarithm (3, 2) by which red, green and blue grow from the middle to the right and to the lower border."""
        return self.values[:, 1:3]

    @property
    def room(self) -> NDArray[np.float64]:
        """Gray levels (3,) that the room's light adds to red, green and blue."""
        return self.values[:, 3]

    def undone(self, levels: NDArray[np.float32] | NDArray[np.uint8]) -> NDArray[np.float32]:
        """An image or its blocks (H, W, 3) without tilt and room light; the gain stays."""
        return np.asarray(levels, dtype=np.float32) if self.is_plain else without_light(levels, self.values)

    def change_sigma(self, untouched: NDArray[np.float32]) -> NDArray[np.float32] | None:
        """Standard deviation (h, w) of the color change from an unsure tilt and room light, over background blocks.

        It is the root mean square of the channels; None if only a gain was fitted.
        """
        if self.covariance is None:
            return None
        per_level = 1 / (untouched.reshape(-1, 3).T[:, None] + CHANGE_OFFSET)
        places = np.broadcast_to(_places(untouched.shape[:2]), (3, 3, per_level.shape[-1]))
        terms = np.concatenate([places, per_level], axis=1)
        square = np.einsum("cin,cij,cjn->n", terms, self.covariance, terms) / 3
        return np.sqrt(square).reshape(untouched.shape[:2]).astype(np.float32)


class _Fit(NamedTuple):
    """A fitted light: values (3, 4), free terms (4,), normal matrices (3, 4, 4), evidence, and sigma of blocks at rest.

    PRIOR makes the matrices definite; a term that is not free has 1 on the diagonal alone.
    """

    values: NDArray[np.float64]
    free: NDArray[np.bool_]
    normal: NDArray[np.float64]
    evidence: float
    rest_sigma: float

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Of the values, (3, 4, 4)."""
        return np.asarray(np.linalg.inv(self.normal) * np.outer(self.free, self.free), dtype=np.float64)

    @property
    def has_room(self) -> bool:
        """Whether the light that is added can be a room's: it reaches all channels, with one sign."""
        room = self.values[:, 3] * np.sign(self.values[:, 3].sum())
        return bool(room.min() > LEAST_OF_ROOM * room.max())


GAIN, WITH_ROOM, TILTED, BOTH = (
    np.array([True, tilted, tilted, room]) for tilted in (False, True) for room in (False, True)
)
ALL_BUT_GAIN = np.array([False, True, True, True])


def light_from_blocks(
    blocks: NDArray[np.float32], untouched: NDArray[np.float32], usual: FrameLight | None = None
) -> FrameLight:
    """The light of an image relative to a background image, both from `block_means`.

    Parameters
    ----------
    usual : of the moments before: it stays, but for the exposure, if it fits better than a gain and no light clearly better
    """
    few, rest = (np.ascontiguousarray(one[::EVERY, ::EVERY]) for one in (blocks, untouched))
    exposure, seen = exposure_from_blocks(blocks, untouched), _Seen(few, rest)
    if usual is not None and not usual.is_plain:
        again = replace(usual, exposure=exposure_from_blocks(usual.undone(blocks), untouched))
        if again.exposure.is_known and seen.promised(again) <= SCREEN:
            sigma, likelihood = seen.rest_sigma, seen.likelihood()
            seen.promised(FrameLight(exposure), sigma)
            if likelihood > seen.likelihood():
                return again
    if exposure.gain is None or (exposure.is_known and seen.promised(FrameLight(exposure)) <= SCREEN):
        return FrameLight(exposure)
    room, at_room = max(
        ((room, exposure_from_blocks(few - np.float32(room), rest)) for room in ROOMS),
        key=lambda one: one[1].share,
    )
    plain, lit = FrameLight(exposure).whole, FrameLight(at_room).whole
    lit[:, 3] = room
    sigma = seen.fit(BOTH, lit, None).rest_sigma
    gain = seen.fit(GAIN, plain, sigma)
    fits = [seen.fit(*one, sigma) for one in ((TILTED, plain), (WITH_ROOM, lit), (BOTH, lit))]
    best = max(fits[:1] + [one for one in fits[1:] if one.has_room], key=lambda one: one.evidence)
    likely = (np.abs(best.values[:, 1:]) <= MOST * PRIOR[1:] ** -0.5).all()
    if best.evidence - gain.evidence <= MARGIN or not likely:
        return FrameLight(exposure)
    light = FrameLight(exposure, np.where(ALL_BUT_GAIN, best.values, 0), best.covariance)
    alike = exposure_from_blocks(light.undone(blocks), untouched)
    return replace(light, exposure=alike) if alike.is_known else FrameLight(exposure)


def light_at_rest(
    blocks: NDArray[np.float32], untouched: NDArray[np.float32], start: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The light (3, 4) of an untouched gel's blocks (h, w, 3), fitted from one near it; blocks of 0 do not count.

    All terms are fitted: where nothing touches, a term too many costs nothing.
    """
    light = start.copy()
    _Seen(blocks, untouched).move(light)
    return light


def lit(levels: NDArray[np.float32], light: NDArray[np.float64]) -> NDArray[np.float32]:
    """An image or its blocks (H, W, 3) in another light.

    Parameters
    ----------
    light : (3, 4), of each channel: the logarithm by which it is brighter in the middle, what is added to this to the right
        border and to the lower border, and the gray levels that a room's light adds
    """
    return np.asarray(
        levels * _factor(levels.shape, light) + light[:, 3].astype(np.float32), dtype=np.float32
    )


def without_light(levels: NDArray[Any], light: NDArray[np.float64]) -> NDArray[np.float32]:
    """The image or the blocks (H, W, 3) that `lit` makes of: its inverse, but 0 for what is darker than the room's light."""
    left = np.maximum(levels - light[:, 3].astype(np.float32), np.float32(0))
    return np.asarray(left / _factor(levels.shape, light), dtype=np.float32)


def _factor(shape: tuple[int, ...], light: NDArray[np.float64]) -> NDArray[np.float32]:
    """What a light multiplies pixels or blocks by, (H, W, 3)."""
    y, x = map(_centers, shape[:2])
    columns = np.exp(light[:, 0] + x[:, None] * light[:, 1]).astype(np.float32)
    return np.asarray(columns * np.exp(y[:, None, None] * light[:, 2]).astype(np.float32))


class _Seen:
    """The blocks (h, w, 3) of an image and of a background image."""

    def __init__(self, blocks: NDArray[np.float32], untouched: NDArray[np.float32]) -> None:
        self._both, (height, width) = (blocks, untouched), blocks.shape[:2]
        self._square, self._rest = np.empty(height * width), np.empty(1)
        self._work = np.empty(3 * (height + width))

    @property
    def rest_sigma(self) -> float:
        """Standard deviation of a block's logarithm at rest, in the last light."""
        return float(self._rest[0])

    def likelihood(self) -> float:
        """Logarithm of the likelihood of the last light, in nats."""
        square = self._square[self._square >= 0]
        rest, touched = (-square / (2 * one**2) - 3 * np.log(one) for one in (self.rest_sigma, TOUCHED_SIGMA))
        return float(ALIKE * np.logaddexp(rest, touched).mean())

    def promised(self, light: FrameLight, sigma: float | None = None) -> float:
        """Nats by which another tilt and room light would fit better than this light: a score test (Rao, 1948)."""
        normal, side = self._fitted(light.whole, BOTH, STAYS, sigma)
        gained = [
            float((side[:, :n] * np.linalg.solve(normal[:, :n, :n], side[:, :n, None])[..., 0]).sum())
            for n in (4, 1)
        ]
        return (gained[0] - gained[1]) / 2

    def move(self, light: NDArray[np.float64]) -> None:
        """Move a light (3, 4) to the one that fits best."""
        self._fitted(light, BOTH, WIDENED, None)

    def fit(self, free: NDArray[np.bool_], start: NDArray[np.float64], sigma: float | None) -> _Fit:
        """The light with these terms (4,) from a start (3, 4); it learns the sigma of the blocks at rest if it is None."""
        values = np.where(free, start, 0.0)
        normal, _ = self._fitted(values, free, WIDENED, sigma)
        evidence = (
            self.likelihood()
            - (PRIOR * values**2).sum() / 2
            - np.linalg.slogdet(normal)[1].sum() / 2
            + 1.5 * np.log(PRIOR[free]).sum()
        )
        return _Fit(values, free, normal, float(evidence), self.rest_sigma)

    def _fitted(
        self,
        values: NDArray[np.float64],
        free: NDArray[np.bool_],
        widened: NDArray[np.float64],
        sigma: float | None,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Normal matrices (3, 4, 4) and right sides (3, 4) at the light, which moves in place from `values` (3, 4)."""
        normal, side = np.empty((3, 4, 4)), np.empty((3, 4))
        _fit_light(
            *self._both, PRIOR * free, widened, values, normal, side, self._square, self._rest, self._work,
            sigma=sigma or REST_SIGMA, least=LEAST_REST, wide=TOUCHED_SIGMA, alike=ALIKE, offset=CHANGE_OFFSET, dark=DARK,
            bright=BRIGHT, learns=sigma is None, moves=widened is not STAYS,
        )  # fmt: skip
        return normal, side


def _places(shape: tuple[int, int]) -> NDArray[np.float64]:
    """1, x and y (3, h w) of blocks (h, w), from -1 to 1."""
    y, x = map(_centers, shape)
    return np.stack([np.ones(len(x) * len(y)), np.tile(x, len(y)), np.repeat(y, len(x))])


def _centers(count: int) -> NDArray[np.float64]:
    """The middles of `count` equal parts of -1 to 1."""
    return (2 * np.arange(count) + 1) / count - 1
