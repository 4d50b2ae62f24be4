"""What two contacts cannot show: the directions of motion that leave their surface as it is, such as turns of a ball.

A direction is seen if the change of slopes that it predicts from one frame correlates with the one from the other: shape
does, noise does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gelform.motion.rigid import Array, about_other_center, inverse_of, moved
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


def blind_directions(first: TouchedSurface, second: TouchedSurface, at: Equations) -> tuple[Blind, ...]:
    """The directions that the equations at the best pose of two contacts cannot tell."""
    scale = first.scale
    directions = scale[:, None] * np.linalg.eigh(scale[:, None] * at.information * scale)[1]
    alike = _correlations(first, second, at, directions)
    chosen = alike < LEAST_CORRELATION
    return _in_words(directions[:, chosen].T, alike[chosen], at.center, scale)


def blind_depth(first: TouchedSurface, second: TouchedSurface) -> tuple[Blind, ...]:
    """Shifts along z, if a contact fills the view: no gel at rest shows where depth 0 is."""
    if max(first.share, second.share) <= FILLED:
        return ()
    direction = np.array([0, 0, 1.0, 0, 0, 0])
    return (Blind(direction, 0.0, "shifts along z: the contact fills the view, nothing is at rest"),)


def seen_directions(blind: Sequence[Blind], scale: Array) -> Array:
    """The other directions, as orthonormal columns (6, k) in units of `scale`."""
    hidden = np.array([one.direction / scale for one in blind]).reshape(-1, 6)
    values, vectors = np.linalg.eigh(hidden.T @ hidden)
    return np.asarray(vectors[:, values < 1e-6 * max(1.0, values[-1])], dtype=np.float64)


def has_moved(surface: TouchedSurface, pose: Array) -> bool:
    """Whether a surface moved far enough on the sensor that what belongs to a place there is not taken for its shape."""
    change = (pose[:3, :3] - np.eye(3))[:2]
    shift = moved(pose, surface.middle)[:2] - surface.middle[:2]
    squares = np.square(shift) + np.diag(change @ surface.spread @ change.T)
    return float(np.sqrt(np.sum(squares / np.square(surface.pitch)))) > MOVED_PX


def _correlations(first: TouchedSurface, second: TouchedSurface, at: Equations, directions: Array) -> Array:
    """Correlation, for each direction (column), of the changes that both frames' own slopes predict."""
    turn, own = at.pose[:3, :3], first.own
    inner = at.shared & first.inside & second.holds(moved(at.pose, first.points))
    weight = (at.weight * inner[:, None]).reshape(-1, 1)
    ours = own.jacobian.copy()
    for k in (0, 1):  # slopes turn as the object
        ours[:, k] = np.float32(turn[k, 0]) * own.jacobian[:, 0] + np.float32(turn[k, 1]) * own.jacobian[:, 1]
    theirs, ours = at.jacobian.reshape(-1, 6), ours.reshape(-1, 6)
    # The same steps, of the first frame and about the center of its equations.
    back = np.kron(np.eye(2), turn.T) @ directions
    back = about_other_center(own.center - moved(inverse_of(at.pose), at.center)) @ back
    products = [
        np.einsum("ik,ij,jk->k", left, ((weight * one).T @ other).astype(np.float64), right)
        for left, one, other, right in (
            (directions, theirs, ours, back), (directions, theirs, theirs, directions), (back, ours, ours, back)
        )
    ]  # fmt: skip
    return np.asarray(products[0] / np.sqrt(np.maximum(products[1] * products[2], 1e-30)), dtype=np.float64)


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
    lever = np.concatenate(
        [about_other_center(x)[:3, 3:] @ d[3:, None] for d in directions for x in np.eye(3)], axis=1
    )
    matrix = lever.reshape(3, len(directions), 3).transpose(1, 0, 2).reshape(-1, 3)
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
