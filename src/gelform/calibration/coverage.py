"""How many presses each part of a calibration needs, where they have been, and the next places to press.

Needs count accepted presses (`circles.locate`), and frames of one press once, except where a row says something else.
docs/press-folder.md has the same rows, with the reasons. A color model states the needs of its own settings (`variants`).

The lights are near, so a color means another slope at another place; a calibration knows only the places that were
pressed. The image is divided into tiles, the slopes into eight directions. A press shows a direction in a tile if enough
of its contact there has it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from gelform.arrays import Array, Mask, Numbers
from gelform.calibration.presses.press_set import NAMED, Circle
from gelform.errors import counted
from gelform.image.view import scale_of
from gelform.result.metrics import followed_radius
from gelform.slopes.color_models.polynomial import DEGREES


class Need(NamedTuple):
    """A number of presses that is enough for something."""

    presses: int

    def met(self, presses: int) -> bool:
        """Whether a number of presses is enough."""
        return presses >= self.presses


FEW = Need(5)  # where more add little to a median or to a start


class _Needed(NamedTuple):
    """What the presses are needed for, in the order of their numbers; those marked (images) count images."""

    model: Need = Need(2)  # moving circles with a color model
    places: Need = Need(3)  # a calibration, from presses at different places
    interval: Need = Need(3)  # the interval of a figure; a bin of the gain curve
    spread: Need = Need(3)  # the note that all presses lie in one part of the image
    median: Need = FEW  # the check for a contact in the background (images)
    guided: Need = FEW  # a guided calibration on the live page (images)
    started: Need = FEW  # advised with a start: the starter of a make, or another unit's calibration
    whole: Need = Need(6)  # moving circles without the presses that the border cuts
    learning_curve: Need = Need(8)  # a learning curve
    learning_law: Need = Need(10)  # a point of the curve that counts for its fitted law
    judged_gain: Need = Need(10)  # a bin of the gain curve that counts for the verdict
    fair: Need = Need(10)  # the verdict fair
    edge: Need = Need(12)  # measuring the contact edge
    size: Need = edge  # reading one ball size by the presses of another
    # advised without a start: no advice to add presses, the verdict good, the guide's message that you can fit well (images)
    advised: Need = Need(20)
    settings: Need = Need(30)  # a learning curve of the chosen settings alone


NEEDED = _Needed()

SAMPLED = 24  # presses that stand for all in a median
FOLDS = 5  # groups of presses, each held out in turn: the other four fifths train

# Position degrees of the polynomial that moves uncertain circles, from a number of presses on.
REFINING = ((0, DEGREES[0][0]), *((least, degrees) for degrees, least in DEGREES[1:3]))

DIRECTIONS = 8  # directions of slopes, 45 degrees each
COARSE = (3, 4)  # tiles (rows, columns) in notes


@dataclass(frozen=True)
class PressPlace:
    """A place to press at: its name ("top left"), and (x, y) in px of the image."""

    name: str
    x_px: float
    y_px: float

    def __str__(self) -> str:
        return f"{self.name} ({self.x_px:.0f}, {self.y_px:.0f})"


@dataclass(frozen=True)
class Coverage:
    """The coverage of the image by presses."""

    shape: tuple[int, int]  # (H, W) of the images
    circles: tuple[Circle, ...]  # (x, y, contact radius) in px of the presses that count
    # (rows, columns, 8) int, number of presses that show a direction in a tile; direction 0 rises to the right (dz/dx > 0),
    # the next ones turn clockwise by 45 degrees
    counts: Array

    @property
    def fraction(self) -> float:
        """Fraction of tiles times directions that at least one press shows, 0-1."""
        return float(np.mean(self.counts > 0))

    @property
    def contact_radius_px(self) -> float:
        """Radius of a usual contact: the median, or an eighth of the shorter side without any."""
        return float(np.median([r for _, _, r in self.circles])) if self.circles else min(self.shape) / 8


def coverage_from_circles(
    circles: Sequence[Circle], shape: tuple[int, int], *, tiles: tuple[int, int] = COARSE
) -> Coverage:
    """Coverage of an image (H, W), on tiles (rows, columns), by contact circles (x, y, radius), px."""
    counts = np.zeros((*tiles, DIRECTIONS), dtype=np.int_)
    for circle in circles:
        counts += shown_by(circle, shape, tiles)
    return Coverage(shape, tuple(circles), counts)


def press_coverage(
    circles: Sequence[Circle], ball_radii_px: Sequence[float], shape: tuple[int, int]
) -> Coverage:
    """The coverage for users, from visible contact circles and the balls that made them.

    The guide and the report share it, with square tiles and the same part of the contact, so that they state one figure.
    """
    followed = [(x, y, followed_radius(r, ball)) for (x, y, r), ball in zip(circles, ball_radii_px)]
    return coverage_from_circles(followed, shape, tiles=square_tiles(shape))


def square_tiles(shape: tuple[int, int], longer: int = 8) -> tuple[int, int]:
    """Rows and columns of tiles that are about square; the image's longer side has a given number of them."""
    height, width = shape
    if width >= height:
        return max(2, round(longer * height / width)), longer
    return longer, max(2, round(longer * width / height))


def tile_of(x_px: ArrayLike, y_px: ArrayLike, shape: tuple[int, int], tiles: tuple[int, int]) -> Array:
    """Flat index of the tile that each pixel of an image (H, W) lies in."""
    row = np.clip((np.asarray(y_px) + 0.5) * tiles[0] / shape[0], 0, tiles[0] - 1).astype(np.intp)
    column = np.clip((np.asarray(x_px) + 0.5) * tiles[1] / shape[1], 0, tiles[1] - 1).astype(np.intp)
    return row * tiles[1] + column


def direction_of(gradients: Array) -> Array:
    """Direction 0-7 of slopes (N, 2): 0 rises to the right, 2 downwards (image rows run down)."""
    turn = np.arctan2(gradients[:, 1], gradients[:, 0]) / (2 * np.pi / DIRECTIONS)
    direction: Array = np.round(turn).astype(np.intp) % DIRECTIONS
    return direction


def shown_by(circle: Circle, shape: tuple[int, int], tiles: tuple[int, int]) -> Mask:
    """The directions (rows, columns, 8) that a press shows in each tile, on at least 0.07 % of the image's pixels."""
    step = 2 * max(1, int(scale_of(shape)))  # px between the counted pixels
    y, x = (axis.ravel() for axis in np.mgrid[: shape[0] : step, : shape[1] : step])
    rho = np.hypot(x - circle[0], y - circle[1]) / circle[2]
    inside = (rho > 0.25) & (rho < 0.8)  # of the contact; nearer to its center a ball is level
    x, y = x[inside], y[inside]
    upwards = np.stack([circle[0] - x, circle[1] - y], axis=1)  # a ball is highest in the middle
    index = tile_of(x, y, shape, tiles) * DIRECTIONS + direction_of(upwards)
    pixels = step**2 * np.bincount(index, minlength=tiles[0] * tiles[1] * DIRECTIONS)
    shown: Mask = pixels >= max(step**2, 0.0007 * shape[0] * shape[1])
    return shown.reshape(*tiles, DIRECTIONS)


def press_next(
    coverage: Coverage, count: int = NAMED, square_error: Numbers | None = None
) -> tuple[PressPlace, ...]:
    """The next places to press at, each the one that helps most after those before it.

    Each try is a contact of the usual size. If mean square errors (rows, columns, 8) are known, it gains
    `error^2 / (1 + n) - error^2 / (2 + n)` for each direction that it shows in a tile and n presses have shown. Otherwise
    the directions that no press has shown count. Among equal places, the one farthest from all presses comes first.
    """
    shape, radius, counts = coverage.shape, coverage.contact_radius_px, coverage.counts.astype(np.float64)
    # Tries half a contact radius inside the image, two for each tile along either side.
    ys, xs = (
        np.linspace(radius / 2, n - 1 - radius / 2, 2 * tiles).tolist()
        for n, tiles in zip(shape, square_tiles(shape))
    )
    points = [(x, y) for y in ys for x in xs]
    tiles = counts.shape[0], counts.shape[1]
    shown = np.array([shown_by((*point, radius), shape, tiles) for point in points])
    pressed = [(x, y) for x, y, _ in coverage.circles]
    places: list[PressPlace] = []
    for _ in range(count):
        gain = counts == 0 if square_error is None else square_error / ((1 + counts) * (2 + counts))
        helped = (shown * gain).sum(axis=(1, 2, 3))
        if helped.max() == 0:
            break
        best = np.flatnonzero(helped >= (1 - 1e-9) * helped.max()).tolist()
        apart = [
            min((np.hypot(points[k][0] - x, points[k][1] - y) for x, y in pressed), default=0) for k in best
        ]
        k = best[int(np.argmax(apart))]
        places.append(PressPlace(name_of_place(*points[k], shape), *points[k]))
        pressed.append(points[k])
        counts += shown[k]
    return tuple(places)


def presses_to_cover(coverage: Coverage, fraction: float) -> int:
    """The number of presses at the next places (`press_next`) that show a fraction of tiles times directions."""
    shape, counts = coverage.shape, coverage.counts.copy()
    places = press_next(coverage, counts.size) if coverage.fraction < fraction else ()
    for number, place in enumerate(places):
        if np.mean(counts > 0) >= fraction:
            return number
        counts += shown_by((place.x_px, place.y_px, coverage.contact_radius_px), shape, counts.shape[:2])
    return len(places)


def name_of_place(x_px: float, y_px: float, shape: tuple[int, int]) -> str:
    """ "top left", "top", ... "middle" ... "bottom right": the ninth of the image that a point lies in."""
    row = min(2, max(0, int(3 * y_px / shape[0])))
    col = min(2, max(0, int(3 * x_px / shape[1])))
    if row == 1 and col == 1:
        return "middle"
    return " ".join(word for word in (("top", "", "bottom")[row], ("left", "", "right")[col]) if word)


def coverage_notes(
    circles: Sequence[Circle], shape: tuple[int, int], *, started: bool = False
) -> tuple[str, ...]:
    """Notes on missing presses: too few, for a fit with a start or without, or all in one part; () if nothing is missing."""
    coverage = coverage_from_circles(circles, shape)
    part = one_part(circles, shape)
    if part is not None:
        return (
            f"All {len(circles)} presses lie in the {part} of the image. Elsewhere the same colors mean other "
            f"slopes, so depth there is a guess. Press all over the gel{_at('next', press_next(coverage))}.",
        )
    advised = (NEEDED.started if started else NEEDED.advised).presses
    missing = advised - len(circles)
    if missing > 0:
        places = press_next(coverage, min(missing, NAMED))
        where = _at("first", places) or ", all over the gel"
        return (
            f"Take {counted(missing, 'more press')}{where}. Presses that fit so far: {len(circles)}; "
            f"{advised} are advised.",
        )
    if coverage.fraction < 0.5:
        where = _at("first", press_next(coverage)) or ", with larger contacts"
        return (
            f"The presses show {100 * coverage.fraction:.0f} % of the places and slope directions. Press more{where}.",
        )
    return ()


def one_part(circles: Sequence[Circle], shape: tuple[int, int]) -> str | None:
    """The part of the image that holds the centers of all contacts; None if there is none, or the contacts extend beyond.

    Top, bottom, left and right are halves, the middle is a third. The contacts must leave a third of the image free along
    at least one side.
    """
    if not NEEDED.spread.met(len(circles)):
        return None
    x, y, radius = np.array(circles).T
    thirds = []
    for centers, n in ((x, shape[1]), (y, shape[0])):
        extent = min(n, (centers + radius).max()) - max(0, (centers - radius).min())
        thirds.append(None if extent > 2 / 3 * n else _holding(centers / n))
    if thirds == [None, None]:
        return None
    place = [n * (0.5 if third is None else (third + 0.5) / 3) for third, n in zip(thirds, shape[::-1])]
    name = name_of_place(place[0], place[1], shape)
    if name == "middle" and None in thirds:
        return "middle row" if thirds[0] is None else "middle column"
    return name


def _holding(centers: Numbers) -> int | None:
    """1 where all centers, as fractions of a side, lie in its middle third, 0 or 2 in its first or last half; else None."""
    low, high = float(centers.min()), float(centers.max())
    if low >= 1 / 3 and high <= 2 / 3:
        return 1
    return 0 if high <= 0.5 else 2 if low >= 0.5 else None


def _at(word: str, places: Sequence[PressPlace]) -> str:
    """The places to press at, as the rest of a sentence; "" without places."""
    listed = ", ".join(str(place) for place in places)
    return f", {word} at {listed} (x, y in px of the image)" if places else ""
