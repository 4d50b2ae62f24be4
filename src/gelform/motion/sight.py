"""What two contacts cannot show: the directions of motion that leave their surface as it is, such as turns of a ball.

A direction is seen if the change of slopes that it predicts from one frame correlates with the one from the other: shape
does, noise does not. A calibration's own error looks like shape too, so turns of a ball are blind up to that error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gelform.foundations.information import determined_by
from gelform.motion.rigid import Array, about_other_center, moved
from gelform.motion.surface import MOVED_PX, Equations, TouchedSurface

LEAST_CORRELATION = 0.71  # of the predicted changes; blind directions lie below, 97 % of the others above
MOST_SHAPE = 0.5  # of what turns about a ball's center change; other objects have .6 or more, balls by a starter .5 at most
FILLED = 0.9  # share of the frame; beyond it no gel at rest is left that depth could be measured from
SHIFTS = 0.3  # of a shift, beside which a smaller turn is not named
NEARLY_AXIS = 0.95  # cosine of the angle to an axis that is named


@dataclass(frozen=True, eq=False)
class Blind:
    """A direction of motion that cannot be seen.

    Attributes
    ----------
    direction : (6,) a shift, mm, and a turn, rad, about the contact's middle
    correlation : value of the test: that of the changes of slope which both frames predict, below 0.71; of a ball, the
        share of what its turns change that is shape, below 0.5
    words : what moves so, such as "turns about the ball's center at (0.1, -0.4, -2.6) mm"
    """

    direction: Array
    correlation: float
    words: str


def blind_directions(first: TouchedSurface, at: Equations) -> tuple[tuple[Blind, ...], Array]:
    """The directions that the equations at the best pose of two contacts cannot tell, and the others (6, k).

    The others do not turn about the axes of blind turns, and do not shift along blind shifts.
    """
    scale = first.scale
    _, directions, undetermined = determined_by(at.information, scale)
    alike = np.where(undetermined, 0.0, _correlations(first, at, directions))
    chosen = alike < LEAST_CORRELATION
    if chosen.any() and (ball := _ball(first, at)) is not None:
        pivot, shape = ball
        turns = np.concatenate([about_other_center(-pivot)[:3, 3:], np.eye(3)]).T
        center = f"turns about the ball's center at {_place(at.center + pivot)}"
        return tuple(Blind(turn, shape, center) for turn in turns), np.eye(6)[:, :3]
    unseen = directions[:, chosen].T
    turning = _sizes(unseen[:, 3:] / scale[3:]) > SHIFTS * _sizes(unseen[:, :3])
    # A small turn beside a shift is noise: times a prior of millimeters, it would make turns uncertain that are seen.
    shifts = np.linalg.eigh(at.information[:3, :3])[1].T
    unseen[~turning] = np.pad(shifts[: np.count_nonzero(~turning)], ((0, 0), (0, 3)))
    held = np.where(turning[:, None], unseen * (0, 0, 0, 1, 1, 1), unseen / scale**2) * scale
    others = np.linalg.svd(held)[2][len(held) :]
    words = [_in_words(one, turns_too, at.center) for one, turns_too in zip(unseen, turning)]
    return tuple(map(Blind, unseen, alike[chosen].tolist(), words)), scale[:, None] * others.T


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


def _correlations(first: TouchedSurface, at: Equations, directions: Array) -> Array:
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


def _ball(first: TouchedSurface, at: Equations) -> tuple[Array, float] | None:
    """The center, from that of the equations, of a ball that is all that both frames show, and its share of shape.

    Turns about a ball's center change the slopes at a place by moving them, and by turning them, to the same amount. What is
    left in both frames is shape, or the error of slopes that the calibration carries: more than that error is no ball.
    """
    weight = at.weight[:, :2] * (first.own.inside & at.inside)[:, None]
    of_point = weight.mean(axis=1, dtype=np.float64)
    if not (total := of_point.sum()):
        return None
    normal = np.concatenate([-first.slopes, np.ones_like(first.slopes[:, :1])], axis=1)
    normal = (normal / _sizes(normal)[:, None]) @ at.pose[:3, :3].T
    point = moved(at.pose, first.points) - at.center
    # A ball of radius r: point = pivot + r normal.
    middle, upward = of_point @ point / total, of_point @ normal / total
    apart = of_point @ np.square(normal - upward).sum(axis=1)
    radius = of_point @ ((point - middle) * (normal - upward)).sum(axis=1) / max(apart, 1e-12 * total)
    pivot = middle - radius * upward
    turns = np.concatenate([about_other_center(-pivot)[:3, 3:], np.eye(3)])
    x, y = first.slopes.T.astype(np.float64)
    turned = np.stack([[x * y, -(1 + x**2), -y], [1 + y**2, -x * y, x]]).transpose(2, 0, 1).reshape(-1, 3)
    both = [one.jacobian[:, :2].reshape(-1, 6) @ turns for one in (at, first.own)]
    each = weight.reshape(-1, 1)
    shape, change = ((each * (both[0] + own)).T @ (both[1] + own) for own in (np.zeros_like(turned), turned))
    change += (each * turned).T @ turned
    change += np.eye(3) * (1e-9 * np.trace(change) + 1e-30)
    left = float(np.linalg.eigvals(np.linalg.solve(change + change.T, shape + shape.T)).real.max())
    carried = 2 * np.count_nonzero(weight) / max(float(np.sum(weight * np.square(first.slopes))), 1e-30)
    return (pivot, left) if left < min(MOST_SHAPE, carried) else None


def _in_words(direction: Array, turns_too: bool, center: Array) -> str:
    """What moves in a blind direction (6,)."""
    shift, turn = direction[:3], direction[3:]
    if not turns_too:
        return f"shifts along {_axis(shift)}"
    return f"turns about {_axis(turn)} through {_place(center + np.cross(turn, shift) / (turn @ turn))}"


def _sizes(vectors: Array) -> Array:
    return np.asarray(np.linalg.norm(vectors, axis=-1))


def _place(point: Array) -> str:
    return f"({', '.join(f'{value:.1f}' for value in point)}) mm"


def _axis(direction: Array) -> str:
    """The name of the nearest axis, or the direction itself."""
    unit = direction / np.linalg.norm(direction)
    nearest = int(np.abs(unit).argmax())
    if abs(unit[nearest]) > NEARLY_AXIS:
        return "xyz"[nearest]
    return f"({', '.join(f'{value:.2f}' for value in unit * np.sign(unit[nearest]))})"
