"""What two contacts cannot show: the directions of motion that leave their surface as it is, such as turns of a ball.

A direction is seen if the change of slopes that it predicts from one frame correlates with the one from the other: shape
does, noise does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gelform.foundations.information import determined_by
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
    _, directions, undetermined = determined_by(at.information, scale)
    alike = np.where(undetermined, 0.0, _correlations(first, second, at, directions))
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
    """Correlation, for each direction (column), of the changes that both frames' own slopes predict.

    The axes of the slopes stay those of the sensor: a turn of ten degrees changes the correlation by 0.02.
    """
    weight = (at.weight * (first.own.inside & at.inside)[:, None]).reshape(-1, 1)
    turn_back = at.pose[:3, :3].T  # the same steps of the first frame
    back = np.concatenate([turn_back @ directions[:3], turn_back @ directions[3:]])
    theirs, ours = (
        one.jacobian.reshape(-1, 6) @ steps.astype(np.float32)
        for one, steps in ((at, directions), (first.own, back))
    )
    both, *alone = (
        np.diag((weight * one).T @ other) for one, other in ((theirs, ours), (theirs, theirs), (ours, ours))
    )
    return np.asarray(both / np.sqrt(np.maximum(alone[0] * alone[1], 1e-30)), dtype=np.float64)


def _in_words(directions: Array, alike: Array, center: Array, scale: Array) -> tuple[Blind, ...]:
    """Blind directions (k, 6) with what moves so."""
    shifts, turns = (
        np.linalg.norm(directions[:, :3], axis=1),
        np.linalg.norm(directions[:, 3:] / scale[3:], axis=1),
    )
    turning = turns > SHIFTS * shifts
    pivot = _ball_center(directions[turning], scale) if np.count_nonzero(turning) >= 3 else None
    found = []
    for direction, value, turns_too in zip(directions, alike, turning):
        shift, turn = direction[:3], direction[3:]
        if not turns_too:
            words = f"shifts along {_axis(shift)}"
        elif pivot is not None:
            words = f"turns about the ball's center at {_place(center + pivot)}"
        else:
            words = (
                f"turns about {_axis(turn)} through {_place(center + np.cross(turn, shift) / (turn @ turn))}"
            )
        found.append(Blind(direction, float(value), words))
    return tuple(found)


def _ball_center(directions: Array, scale: Array) -> Array | None:
    """The point, from the center, that stays where it is in all directions (k, 6); None if there is none."""
    matrix = np.concatenate([-about_other_center(turn)[:3, 3:] for turn in directions[:, 3:]])  # turn x point
    shifts = directions[:, :3].ravel()
    point = np.linalg.lstsq(matrix, -shifts, rcond=None)[0]
    left = np.linalg.norm(matrix @ point + shifts) / np.linalg.norm(directions / scale)
    return point if left < CENTERED else None


def _place(point: Array) -> str:
    return f"({', '.join(f'{value:.1f}' for value in point)}) mm"


def _axis(direction: Array) -> str:
    """The name of the nearest axis, or the direction itself."""
    unit = direction / np.linalg.norm(direction)
    nearest = int(np.abs(unit).argmax())
    if abs(unit[nearest]) > NEARLY_AXIS:
        return "xyz"[nearest]
    return f"({', '.join(f'{value:.2f}' for value in unit * np.sign(unit[nearest]))})"
