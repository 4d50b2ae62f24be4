"""What two contacts cannot show: the directions of motion that leave their surface as it is, such as turns of a ball.

A direction is seen if the change of slopes that it predicts from one frame correlates with the one from the other: shape
does, noise does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gelform.motion.rigid import Array, about_other_center, moved
from gelform.motion.surface import MOVED_PX, Equations, TouchedSurface

LEAST_CORRELATION = 0.71  # of the predicted changes; blind directions lie below, 97 % of the others above
FILLED = 0.9  # share of the frame; beyond it no gel at rest is left that depth could be measured from
CENTERED = 0.3  # share of the motion that turns leave at the point they turn about
SHIFTS = 0.3  # of a shift, beside which a smaller turn is not named
NEARLY_AXIS = 0.95  # cosine of the angle to an axis that is named


@dataclass(frozen=True, eq=False)
class Blind:
    """A direction of motion that cannot be seen.

    Attributes
    ----------
    direction : (6,) a shift, mm, and a turn, rad, about the contact's middle
    correlation : value of the test: that of the changes of slope which both frames predict; below 0.71
    words : what moves so, such as "turns about the ball's center at (0.1, -0.4, -2.6) mm"
    """

    direction: Array
    correlation: float
    words: str


def blind_directions(
    first: TouchedSurface, second: TouchedSurface, at: Equations
) -> tuple[tuple[Blind, ...], Array]:
    """The directions that the equations at the best pose of two contacts cannot tell, and the others (6, k)."""
    scale = first.scale
    directions = scale[:, None] * np.linalg.eigh(scale[:, None] * at.information * scale)[1]
    alike = _correlations(first, second, at, directions)
    chosen = alike < LEAST_CORRELATION
    return _in_words(directions[:, chosen].T, alike[chosen], at.center, scale), directions[:, ~chosen]


def blind_depth(first: TouchedSurface, second: TouchedSurface) -> tuple[Blind, ...]:
    """Shifts along z, if a contact fills the view: no gel at rest shows where depth 0 is."""
    if max(first.share, second.share) <= FILLED:
        return ()
    direction = np.array([0, 0, 1.0, 0, 0, 0])
    return (Blind(direction, 0.0, "shifts along z: the contact fills the view, nothing is at rest"),)


def has_moved(surface: TouchedSurface, pose: Array) -> bool:
    """Whether a surface moved far enough on the sensor that what belongs to a place there is not taken for its shape."""
    shifts_px = (moved(pose, surface.points) - surface.points)[:, :2] / surface.pitch
    return float(np.linalg.norm(shifts_px)) > MOVED_PX * np.sqrt(len(shifts_px))


def _correlations(first: TouchedSurface, second: TouchedSurface, at: Equations, directions: Array) -> Array:
    """Correlation, for each direction (column), of the changes that both frames' own slopes predict."""
    turn = at.pose[:3, :3]
    inner = first.inside & second.holds(moved(at.pose, first.points))
    weight = (at.weight * inner[:, None]).reshape(-1, 1)
    # The same steps of the first frame, whose slopes turn as the object.
    slopes_turn = np.eye(3)
    slopes_turn[:2, :2] = turn[:2, :2]
    back = np.kron(slopes_turn.T, np.kron(np.eye(2), turn.T) @ directions).astype(np.float32)
    theirs = at.jacobian.reshape(-1, 6) @ directions.astype(np.float32)
    ours = (first.own.jacobian.reshape(-1, 18) @ back).reshape(-1, directions.shape[1])
    both, *alone = (
        np.diag((weight * one).T @ other) for one, other in ((theirs, ours), (theirs, theirs), (ours, ours))
    )
    return np.asarray(both / np.sqrt(np.maximum(alone[0] * alone[1], 1e-30)), dtype=np.float64)


def _in_words(directions: Array, alike: Array, center: Array, scale: Array) -> tuple[Blind, ...]:
    """Blind directions (k, 6) with what moves so."""
    turns = np.linalg.norm(directions[:, 3:] / scale[3:], axis=1) > SHIFTS * np.linalg.norm(
        directions[:, :3], axis=1
    )
    pivot, left = _pivot(directions[turns], scale) if turns.any() else (np.zeros(3), 1.0)
    is_ball = np.count_nonzero(turns) >= 3 and left < CENTERED
    found = []
    for direction, value, turning in zip(directions, alike, turns):
        if turning and is_ball:
            words = f"turns about the ball's center at {_place(center + pivot)}"
        elif turning:
            through = center + np.cross(direction[3:], direction[:3]) / float(direction[3:] @ direction[3:])
            words = f"turns about {_axis(direction[3:])} through {_place(through)}"
        else:
            words = f"shifts along {_axis(direction[:3])}"
        found.append(Blind(direction, float(value), words))
    return tuple(found)


def _pivot(directions: Array, scale: Array) -> tuple[Array, float]:
    """The point, from the center, that moves least in all directions (k, 6), and the share of the motion left there."""
    matrix = np.concatenate([-about_other_center(turn)[:3, 3:] for turn in directions[:, 3:]])  # turn x pivot
    shifts = directions[:, :3].ravel()
    pivot = np.linalg.lstsq(matrix, -shifts, rcond=None)[0]
    left = np.linalg.norm(matrix @ pivot + shifts) / np.linalg.norm(directions / scale)
    return pivot, float(left)


def _place(point: Array) -> str:
    return f"({', '.join(f'{value:.1f}' for value in point)}) mm"


def _axis(direction: Array) -> str:
    """The name of the nearest axis, or the direction itself."""
    unit = direction / np.linalg.norm(direction)
    nearest = int(np.abs(unit).argmax())
    if abs(unit[nearest]) > NEARLY_AXIS:
        return "xyz"[nearest]
    return f"({', '.join(f'{value:.2f}' for value in unit * np.sign(unit[nearest]))})"
