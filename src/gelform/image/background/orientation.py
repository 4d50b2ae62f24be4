"""How an image lies compared with the background image (mirrored, turned, BGR), and the part that is touched.

Sixteen readings of the image compete: eight orientations, each with both orders of the channels. In the right one the image
is the background times a smooth light, but for what touches the gel. In a wrong one the lamps shine from elsewhere, and no
light near the usual one explains it. So each reading is scored by its evidence (Bishop, Pattern Recognition and Machine
Learning, 2006, section 3.4): a light is fitted, a polynomial with a prior, and blocks that it does not explain count as
touched.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.foundations.filters import CHANGE_OFFSET
from gelform.image.background.light import (
    ALIKE,
    LIGHT_SIGMAS,
    MARGIN,
    REST_SIGMA,
    TOUCHED_SIGMA,
    block_means,
    gain_from_blocks,
)
from gelform.image.frame import BRIGHT, DARK

# Fraction of the brightness by which all but a quarter of an image differs, if it lies otherwise: 0.048 or more on six
# sensors. Frames that lie as the background differ by up to 0.036.
UNLIKE = 0.036
TOUCHED_CHANGE = (
    0.06  # of a block's logarithm, root mean square of the channels; light that drifted leaves less
)
ROUNDS = 6  # of the fit, each with the touched blocks of the last

# The view's flip and turn that do what the transpose and a flip do.
VIEW_OF_TRANSPOSED = {
    "none": ("y", "right"),
    "x": ("none", "right"),
    "y": ("none", "left"),
    "xy": ("x", "right"),
}


class Orientation(NamedTuple):
    """A reading of an image.

    Attributes
    ----------
    flip : "none", "x" (left and right exchanged), "y" (top and bottom), "xy"
    transposed : whether rows and columns are exchanged, before the flip is undone
    reversed : whether red and blue are exchanged
    """

    flip: str
    transposed: bool
    reversed: bool

    @property
    def is_upright(self) -> bool:
        """Whether nothing is exchanged."""
        return self == UPRIGHT

    @property
    def named(self) -> str:
        """What is exchanged, in words: "BGR", "mirrored left to right", "turned by 90 degrees and BGR"."""
        words = []
        if self.transposed:
            turned = {"x": "turned by 90 degrees counter-clockwise", "y": "turned by 90 degrees clockwise"}
            words.append(turned.get(self.flip, "turned by 90 degrees and mirrored"))
        elif self.flip != "none":
            flipped = {"x": "mirrored left to right", "y": "mirrored top to bottom"}
            words.append(flipped.get(self.flip, "turned by 180 degrees"))
        return " and ".join([*words, *(["BGR"] if self.reversed else [])])

    @property
    def remedy(self) -> str:
        """What undoes it: the view's flip and turn, and the exchange of red and blue."""
        flip, turn = VIEW_OF_TRANSPOSED[self.flip] if self.transposed else (self.flip, "none")
        words = [f'{name} "{value}"' for name, value in (("flip", flip), ("turn", turn)) if value != "none"]
        parts = [f"the view's {' and '.join(words)}"] if words else []
        if self.reversed:
            parts.append("red and blue exchanged (--bgr)")
        return ", and ".join(parts)

    def undone(self, image: NDArray[Any]) -> NDArray[Any]:
        """The image (H, W, 3) as it should be."""
        upright = image.transpose(1, 0, 2) if self.transposed else image
        upright = upright[:: -1 if "y" in self.flip else 1, :: -1 if "x" in self.flip else 1]
        return np.ascontiguousarray(upright[..., ::-1] if self.reversed else upright)


READINGS = tuple(
    Orientation(flip, transposed, reversed_)
    for transposed in (False, True)
    for flip in ("none", "x", "y", "xy")
    for reversed_ in (False, True)
)
UPRIGHT = READINGS[0]


def orientation_from_image(image: NDArray[Any], background: NDArray[Any]) -> Orientation | None:
    """How an image (H, W, 3) or (W, H, 3), 0-255, lies compared with a background image (H, W, 3).

    Returns
    -------
    Orientation
        None if it cannot be told: the lights are alike from all sides, or the image is of another sensor.
    """
    return orientation_from_blocks(block_means(image), block_means(background))


def orientation_if_doubtful(image: NDArray[Any], background: NDArray[Any]) -> Orientation | None:
    """`orientation_from_image` of an image of which not even a quarter is as in the background image; else None.

    It is the cheap question first: no image of six sensors that lies otherwise agrees by so much.
    """
    blocks, untouched = block_means(image), block_means(background)
    if gain_from_blocks(blocks, untouched).least_change <= UNLIKE:
        return None
    return orientation_from_blocks(blocks, untouched)


def orientation_from_blocks(image: NDArray[np.float32], untouched: NDArray[np.float32]) -> Orientation | None:
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
    evidence = _evidence(change, lit, _terms(shape))
    order = np.argsort(evidence)[::-1]
    first = evidence[order[0]]
    others = max(evidence[order[1]], _touched_all_over(change, lit))
    return fitting[order[0]] if first - others > MARGIN else None


class Touched(NamedTuple):
    """The largest connected region of an image that no light explains.

    Attributes
    ----------
    share : of the image, 0-1
    center : x and y over width and height, 0-1
    """

    share: float
    center: tuple[float, float]


def largest_touch(image: NDArray[np.float32], untouched: NDArray[np.float32]) -> Touched:
    """The largest touched region of an image compared with a background image, both from `block_means`, of one size."""
    shape = untouched.shape[:2]
    change, lit = _log_change(image[None], untouched)
    terms = _terms(shape)
    light, _ = _fitted_light(change, lit, terms)
    size = np.sqrt(np.mean((change[0] - terms[0] @ light[0]) ** 2, axis=-1))
    touched = ((size > TOUCHED_CHANGE) & lit[0]).reshape(shape).view(np.uint8)
    _, _, regions, centers = cv2.connectedComponentsWithStats(touched, connectivity=4)
    areas = regions[1:, cv2.CC_STAT_AREA]
    if not len(areas):
        return Touched(0.0, (0.5, 0.5))
    x, y = (centers[1 + areas.argmax()] + 0.5) / shape[::-1]
    return Touched(float(areas.max() / size.size), (float(x), float(y)))


def _log_change(
    images: NDArray[np.float32], untouched: NDArray[np.float32]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Log ratios (n, N, 3) of images (n, h, w, 3) to the background (h, w, 3), and the blocks (n, N) lit in both."""
    read, background = images.reshape(len(images), -1, 3), untouched.reshape(1, -1, 3)
    lit = np.all((background > DARK) & (background < BRIGHT) & (read > DARK) & (read < BRIGHT), axis=-1)
    return np.log((read + CHANGE_OFFSET) / (background + CHANGE_OFFSET)).astype(np.float64), lit


def _terms(shape: tuple[int, int]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Monomials (N, 10) of the place in blocks (h, w), and the weights (10,) of their prior."""
    y, x = (np.linspace(-1, 1, n) for n in shape)
    across, down = (part.ravel() for part in np.meshgrid(x, y))
    powers = [(i, j) for i in range(len(LIGHT_SIGMAS)) for j in range(len(LIGHT_SIGMAS) - i)]
    terms = np.stack([across**i * down**j for i, j in powers], axis=1)
    return terms, np.array([LIGHT_SIGMAS[i + j] ** -2 for i, j in powers])


def _evidence(
    change: NDArray[np.float64],
    lit: NDArray[np.bool_],
    of_place: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> NDArray[np.float64]:
    """Evidence (readings,) of the log changes (readings, N, 3) of lit blocks (readings, N), in nats."""
    terms, prior = of_place
    share = ALIKE / np.maximum(lit.sum(axis=1), 1)
    light, normal = _fitted_light(change, lit, of_place)
    explained = np.where(lit, np.logaddexp(*_log_likelihoods(change - terms @ light)), 0).sum(axis=1) * share
    apart = (prior[None, :, None] * light**2).sum(axis=(1, 2)) / 2
    narrowed = np.linalg.slogdet(normal)[1] - np.log(prior).sum()
    return np.asarray(explained - apart - 1.5 * narrowed)


def _fitted_light(
    change: NDArray[np.float64],
    lit: NDArray[np.bool_],
    of_place: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Coefficients (readings, 10, 3) of the light that explains most blocks, and their inverse covariance."""
    terms, prior = of_place
    share = ALIKE / np.maximum(lit.sum(axis=1), 1)
    products = (terms[:, :, None] * terms[:, None, :]).reshape(len(terms), -1)
    light = np.zeros((len(change), terms.shape[1], 3))
    light[:, 0] = [np.median(one[chosen], axis=0) if chosen.any() else 0 for one, chosen in zip(change, lit)]
    for _ in range(ROUNDS):
        sides = _log_likelihoods(change - terms @ light)
        weight = lit * np.exp(sides[0] - np.logaddexp(*sides)) * share[:, None] / REST_SIGMA**2
        normal = (weight @ products).reshape(len(change), *2 * (terms.shape[1],)) + np.diag(prior)
        # definite by the prior
        light = np.linalg.solve(normal, terms.T @ (weight[..., None] * change))
    return light, normal


def _log_likelihoods(residual: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Of blocks at rest and of touched ones, each half of all, from their residuals (..., 3)."""
    square = (residual**2).sum(axis=-1)
    return [-square / (2 * sigma**2) - 3 * np.log(sigma) for sigma in (REST_SIGMA, TOUCHED_SIGMA)]


def _touched_all_over(change: NDArray[np.float64], lit: NDArray[np.bool_]) -> float:
    """Evidence of an image that no reading explains at all."""
    return float(ALIKE * _log_likelihoods(change[lit])[1].mean())
