"""Where presses of a ball tell colours from slopes, in which directions, and where one is missing.

The lights are near, so a colour means another slope at another place: a calibration knows what was pressed there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

CELLS = (3, 4)
SECTORS = 8
ZONE = 0.8
FLAT = 0.3
MIN_SHARE = 0.004
ADVISED_PRESSES = 20
NAMED_PLACES = 5
CANDIDATES = (12, 16)
CORNER_SHARE = 0.55

Circle = tuple[float, float, float]


@dataclass(frozen=True)
class Place:
    """A place in the image to press at: its name ("top left"), and (x, y) in px."""

    name: str
    x_px: float
    y_px: float

    def __str__(self) -> str:
        return f"{self.name} ({self.x_px:.0f}, {self.y_px:.0f})"


@dataclass(frozen=True)
class Coverage:
    """How presses cover the frame.

    Attributes
    ----------
    shape : (H, W) of the images
    circles : (x, y, contact radius) in px of the presses that count
    directions : (rows, cols, 8) int, in how many presses a cell of the frame shows slopes of a direction; sector 0
        rises to the right (dz/dx > 0), the next ones turn clockwise by 45 degrees
    """

    shape: tuple[int, int]
    circles: tuple[Circle, ...]
    directions: NDArray[np.int_]

    @property
    def presses(self) -> NDArray[np.int_]:
        """(rows, cols) in how many presses each cell shows the direction that it shows most often."""
        counts: NDArray[np.int_] = self.directions.max(axis=2)
        return counts

    @property
    def share(self) -> float:
        """Share of cells times directions that at least one press shows, 0-1."""
        return float(np.mean(self.directions > 0))

    def to_dict(self) -> dict[str, object]:
        """The coverage as JSON can hold it."""
        return {
            "share": self.share,
            "directions": self.directions.tolist(),
            "press_here_next": [
                {"name": place.name, "x_px": place.x_px, "y_px": place.y_px} for place in press_next(self)
            ],
        }


def coverage_from_circles(
    circles: Sequence[Circle], shape: tuple[int, int], *, cells: tuple[int, int] = CELLS
) -> Coverage:
    """Coverage of a frame by the contact circles of ball presses.

    Parameters
    ----------
    circles : (x, y, contact radius) in px, of the presses that fit
    shape : (H, W) of the images
    cells : rows and columns of the grid
    """
    directions = np.zeros((*cells, SECTORS), dtype=np.int_)
    for circle in circles:
        directions += _shown(circle, shape, cells)
    return Coverage(shape, tuple(circles), directions)


def press_next(coverage: Coverage, count: int = NAMED_PLACES) -> tuple[Place, ...]:
    """Up to so many places to press at next, the one that adds most first; none where nothing is missing.

    Each adds, by a contact of the usual size, the cells and directions that no press shows yet; of those that add
    alike the one farthest from all presses.
    """
    height, width = coverage.shape
    radius = (
        float(np.median([r for _, _, r in coverage.circles])) if coverage.circles else min(height, width) / 8
    )
    known = coverage.directions > 0
    there = [(x, y) for x, y, _ in coverage.circles]
    rows, cols = CANDIDATES
    points = [((j + 0.5) * width / cols, (i + 0.5) * height / rows) for i in range(rows) for j in range(cols)]
    shown = [_shown((x, y, radius), coverage.shape, known.shape[:2]) > 0 for x, y in points]
    places: list[Place] = []
    while len(places) < count and not known.all():
        gains = [np.count_nonzero(new & ~known) for new in shown]
        if max(gains) == 0:
            break
        best = [k for k, gain in enumerate(gains) if gain == max(gains)]
        k = max(best, key=lambda k: min((np.hypot(*np.subtract(points[k], at)) for at in there), default=0.0))
        places.append(Place(name_of_place(*points[k], coverage.shape), *points[k]))
        there.append(points[k])
        known = known | shown[k]
    return tuple(places)


def name_of_place(x_px: float, y_px: float, shape: tuple[int, int]) -> str:
    """ "top left", "top", ... "middle" ... "bottom right": the ninth of the image that a point lies in."""
    row = min(2, max(0, int(3 * y_px / shape[0])))
    col = min(2, max(0, int(3 * x_px / shape[1])))
    if row == 1 and col == 1:
        return "middle"
    return " ".join(word for word in (("top", "", "bottom")[row], ("left", "", "right")[col]) if word)


def coverage_notes(circles: Sequence[Circle], shape: tuple[int, int]) -> tuple[str, ...]:
    """What a user should know of where presses are missing: too few, all in one part; () where nothing is.

    Parameters
    ----------
    circles, shape : as in `coverage_from_circles`
    """
    coverage = coverage_from_circles(circles, shape)
    notes = []
    part = one_part(circles, shape)
    if part is not None:
        notes.append(
            f"All {len(circles)} presses lie in the {part} of the image. Elsewhere colours mean other slopes, and depth "
            f"there is a guess. Press all over the gel, next at {_listed(press_next(coverage))}."
        )
    missing = ADVISED_PRESSES - len(circles)
    if missing > 0 and part is None:
        places = press_next(coverage, min(missing, NAMED_PLACES))
        where = f", first at {_listed(places)}" if places else ", all over the gel"
        notes.append(
            f"{missing} more presses are advised ({len(circles)} of {ADVISED_PRESSES} fit){where} "
            "(x, y in px of the image)."
        )
    elif missing <= 0 and part is None and coverage.share < 0.5:
        notes.append(
            f"The presses show {100 * coverage.share:.0f} % of the places and slope directions. "
            f"Press next at {_listed(press_next(coverage))} (x, y in px of the image)."
        )
    return tuple(notes)


def one_part(circles: Sequence[Circle], shape: tuple[int, int]) -> str | None:
    """The part of the image that holds all presses, where they span about half of it or less; else None."""
    if len(circles) < 3:
        return None
    x, y = np.array([circle[:2] for circle in circles]).T
    spans_x, spans_y = np.ptp(x) > CORNER_SHARE * shape[1], np.ptp(y) > CORNER_SHARE * shape[0]
    if spans_x and spans_y:
        return None
    middle_x, middle_y = (x.min() + x.max()) / 2, (y.min() + y.max()) / 2
    name = name_of_place(
        shape[1] / 2 if spans_x else float(middle_x), shape[0] / 2 if spans_y else float(middle_y), shape
    )
    if name == "middle" and (spans_x or spans_y):
        return "middle row" if spans_x else "middle column"
    return name


def _listed(places: Sequence[Place]) -> str:
    return ", ".join(str(place) for place in places)


def _shown(circle: Circle, shape: tuple[int, int], cells: tuple[int, ...]) -> NDArray[np.int_]:
    """(rows, cols, 8) 1 where a press shows slopes of a direction in enough pixels of a cell, else 0."""
    x, y, radius = circle
    height, width = shape
    rows, cols = (axis.ravel() for axis in np.mgrid[:height:2, :width:2])
    dx, dy = cols - x, rows - y
    rho = np.hypot(dx, dy) / radius
    inside = (rho > FLAT) & (rho < ZONE)
    rows, cols, dx, dy = (axis[inside] for axis in (rows, cols, dx, dy))
    # a ball is highest in the middle: the gradient points there
    sector = np.floor(np.arctan2(-dy, -dx) / (2 * np.pi / SECTORS) + 0.5).astype(int) % SECTORS
    cell = (rows * cells[0] // height) * cells[1] + cols * cells[1] // width
    counts = np.bincount(cell * SECTORS + sector, minlength=cells[0] * cells[1] * SECTORS)
    enough = MIN_SHARE * height * width / (cells[0] * cells[1]) / 4  # every fourth pixel was looked at
    return (counts.reshape(cells[0], cells[1], SECTORS) >= max(1, enough)).astype(np.int_)
