"""Where an object moved between two contacts: its pose, the pose's covariance, and what the contacts cannot show.

The touched surface of one frame is moved rigidly onto that of the other, so that its slopes and its depth agree
(Gauss-Newton, weighted by both frames' standard deviations, Huber's loss). docs/motion-derivation.md has the formulas.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gelform.foundations.checks import check_numbers, check_within
from gelform.foundations.information import determined_by
from gelform.motion.covariance import BLOCK_PX, pose_covariance
from gelform.motion.rigid import Array, checked_pose, moved, pose_of_step, step_of_pose, turn_deg
from gelform.motion.sight import Blind, blind_depth, blind_directions, has_moved
from gelform.motion.surface import Equations, TouchedSurface
from gelform.result import Reconstruction

FOUND, LOST, UNSURE = "found", "lost", "cannot tell yet"
LEAST_SHARE, LEAST_PX = 0.25, 300  # of the contact, and pixels, that both frames touch
# Mm and degrees: farther from the start there are other minima; farther turned, every method drifts by .1-.3 mm, 2-5 deg.
MOST_FROM_START_MM, MOST_TURN_DEG = 0.5, 10.0
# Mm and rad: the range of the method, and what is known where nothing is seen and no prior given.
REACH = (MOST_FROM_START_MM, float(np.radians(MOST_TURN_DEG)))
NO_PRIOR = (10.0, float(np.radians(MOST_TURN_DEG)))
# Mm and rad: beyond, the squares of a prior and of what was seen have no common precision.
PRIORS = (1e-6, 1e6)
PLACE_ERROR = 0.006  # error of a ball's place over its displacement, the largest of three Minis (two GelSlims .010, .015)
MOST_MISFIT = 1.0  # of the surfaces after the motion, in their stated errors; .84 at most on real contacts
UNKNOWN_MM = 1e3  # mm, standard deviation of what is not known at all
# Share of the covariance by the stated sigmas alone that remains where residuals are 0 or come from one block, which
# measures none; where it is measured, on textures and balls, it is 1 to 60 times that of the stated sigmas.
LUCK = 1e-3
MOST_STEPS = 30
LONGEST_MM, LONGEST_RAD = 0.5, 0.15  # of a step
LAST_MM, LAST_RAD = 2e-3, 5e-4  # a smaller step is the last


@dataclass(frozen=True, eq=False)
class Motion:
    """Where an object moved from one contact to another.

    Attributes
    ----------
    pose : (4, 4), moves a point (x, y, z) of the first frame to where it is in the second, mm. x to the right, y down, z
        toward the camera, from the image's middle on the gel at rest; None if the state is "lost"
    covariance : (6, 6), of a small shift (mm) and turn (rad) about `center_mm` after the pose; None if lost. In blind
        directions it is the prior's
    center_mm : (3,), where the middle of the first contact is in the second frame
    blind : directions that these contacts cannot show; there the pose is that of the start
    shared : share of the first contact that the second touches too, 0-1
    state : "found"; "cannot tell yet" (the object has hardly moved: what is blind is not known); "lost"
    why : why nothing was found, in words; "" otherwise
    """

    pose: Array | None
    covariance: Array | None
    center_mm: Array | None
    blind: tuple[Blind, ...]
    shared: float
    state: str
    why: str = ""


def motion_between(
    a: Reconstruction,
    b: Reconstruction,
    *,
    start: ArrayLike | None = None,
    prior: Sequence[float] | None = None,
    place_error: float | None = None,
) -> Motion:
    """Where the object that touched in result `a` is in result `b`, of the same sensor and later.

    Parameters
    ----------
    a, b : results (H, W) of one calibration, with a scale
    start : (4, 4), about where it moved, within 0.5 mm. By default where it was, and if that is lost, where the middle of
        the touched pixels is
    prior : (mm, rad), standard deviations of the start's shift and turn. The result is the best of both; blind directions
        take the prior alone. By default nothing is known: 10 mm and 10 degrees
    place_error : error of a place over the displacement, a calibration's `settings.place_error`; None: that of a Mini

    Returns
    -------
    Motion
        With the state "lost" and the reason, but no pose, if the frames are of different sensors or not in order, nothing
        or too little touches in both, or the object moved farther from the start, or turned more, than the method finds.

    Raises
    ------
    ValueError, TypeError, GelformError
        No results, no rigid start, a prior beyond 1e-6 to 1e6; a result without a scale, or beyond 1e6 mm.
    """
    first, second = TouchedSurface(a), TouchedSurface(b)
    if why := not_comparable(a, b):
        return lost(why)
    begin = np.eye(4) if start is None else checked_pose(start, "start")
    known = checked_prior(prior), checked_place_error(place_error)
    motion = motion_of(first, second, begin, *known)
    if motion.state == LOST and start is None and min(first.count, second.count) >= LEAST_PX:
        begin[:2, 3] = second.centroid - first.centroid
        motion = motion_of(first, second, begin, *known)
    return motion


def checked_prior(prior: Sequence[float] | None) -> tuple[float, float]:
    """Standard deviations of a start, mm and rad; by default those that leave nothing known."""
    if prior is None:
        return NO_PRIOR
    shift, turn = check_numbers(prior, "prior", 2)
    return check_within(shift, "prior's mm", *PRIORS), check_within(turn, "prior's rad", *PRIORS)


def checked_place_error(share: float | None) -> float:
    """The error of a place over the displacement; None: the largest of three Minis."""
    return PLACE_ERROR if share is None else check_within(share, "place_error", 0, 1)


def sensor_of(result: Reconstruction) -> tuple[object, ...]:
    """What results of one sensor and calibration have in common."""
    return result.calibration_digest, result.shape, result.mm_per_px


def not_comparable(a: Reconstruction, b: Reconstruction) -> str:
    """Why there is no motion from one frame to the other, whatever they show; "" if there may be."""
    if sensor_of(a) != sensor_of(b):
        return "the frame is of another sensor or calibration"
    if a.time_s is not None and b.time_s is not None and b.time_s < a.time_s:
        return f"the frames are out of order: {b.time_s:.3f} s after {a.time_s:.3f} s"
    return ""


def lost(why: str, shared: float = 0.0) -> Motion:
    """No motion, and why."""
    return Motion(None, None, None, (), shared, LOST, why)


def motion_of(
    first: TouchedSurface,
    second: TouchedSurface,
    start: Array,
    prior: tuple[float, float],
    place_error: float,
) -> Motion:
    """`motion_between` of prepared surfaces."""
    if min(first.count, second.count) < LEAST_PX:
        return lost(f"no contact: {min(first.count, second.count)} px touch, {LEAST_PX} are needed")
    found = _fitted(first, second, start, np.eye(6))
    if isinstance(found, Motion):
        return found
    blind, freely = blind_directions(first, found)
    if blind:
        found = _fitted(first, second, start, freely)
        if isinstance(found, Motion):
            return found
    shared = found.count / len(first.points)
    stated, _, undetermined = determined_by(freely.T @ found.information @ freely)
    if undetermined.any():
        return lost("the part that both frames touch does not determine the motion", shared)
    inverse = freely @ stated @ freely.T
    pose = pose_of_step(inverse @ found.right, found.center) @ found.pose
    center = moved(pose, first.middle)
    travel = float(np.linalg.norm((center - first.middle)[:2]))
    if (misfit := found.misfit) > MOST_MISFIT:
        return lost(f"the surfaces differ by {misfit:.1f} times their errors: is it another object?", shared)
    own = pose_covariance(first, found, inverse, travel * place_error)
    if filled := blind_depth(first, second):
        own[2, 2] += UNKNOWN_MM**2
    along = np.linalg.inv(np.column_stack([freely, *(one.direction for one in blind)]))[: freely.shape[1]]
    seen = along @ own @ along.T + LUCK * stated
    pose, covariance = _with_prior(pose, start, center, freely, along, seen, prior)
    if why := _too_far(pose, start, center):
        return lost(why, shared)
    state = FOUND if has_moved(first, pose) else UNSURE
    return Motion(pose, covariance, center, (*blind, *filled), shared, state)


def _with_prior(
    pose: Array,
    start: Array,
    center: Array,
    freely: Array,
    along: Array,
    own: Array,
    prior: tuple[float, float],
) -> tuple[Array, Array]:
    """The best pose by what was seen along (k, 6), with its covariance (k, k), and by the prior; and its covariance.

    The step from the start is one of the free motions (6, k): where nothing was seen, the start stays.
    Kalman's update in Joseph's form: the sum that is inverted is definite, because both parts are.
    """
    held = np.diag(np.square(np.repeat(prior, 3)))
    gain = np.linalg.solve(along @ held @ along.T + own, along @ held).T
    left = np.eye(6) - gain @ along
    step = step_of_pose(pose @ np.linalg.inv(start), center)
    found = pose_of_step(freely @ along @ gain @ along @ step, center) @ start
    return found, left @ held @ left.T + gain @ own @ gain.T


def _information(prior: tuple[float, float]) -> Array:
    """The information (6,) of standard deviations, mm and rad."""
    return np.asarray(1 / np.square(np.repeat(prior, 3)))


def _fitted(first: TouchedSurface, second: TouchedSurface, start: Array, seen: Array) -> Equations | Motion:
    """The equations about one step from the best pose, in the directions (6, k) alone, held to the start by REACH."""
    # Errors of neighbors are alike, but the equations count each as news: so must what holds them at the start.
    held = (BLOCK_PX / first.every) ** 2 * _information(REACH)
    pose, back = start, np.linalg.inv(start)  # rigid, as every pose: never singular
    for _ in range(MOST_STEPS):
        equations = first.equations(second, pose)
        share, seen_px = equations.count / len(first.points), equations.count * first.every**2
        if seen_px < LEAST_PX or share < LEAST_SHARE:
            wanted = f"{LEAST_PX} px and {100 * LEAST_SHARE:.0f} % are needed"
            return lost(
                f"both frames touch {seen_px} px of the contact, {100 * share:.0f} %: {wanted}", share
            )
        step = equations.step(seen, held, step_of_pose(pose @ back, equations.center))
        shift, turn = float(np.linalg.norm(step[:3])), float(np.linalg.norm(step[3:]))
        if shift < LAST_MM and turn < LAST_RAD:
            break
        step *= min(1.0, LONGEST_MM / max(shift, LAST_MM), LONGEST_RAD / max(turn, LAST_RAD))
        pose = pose_of_step(step, equations.center) @ pose
    return equations


def _too_far(pose: Array, start: Array, center: Array) -> str:
    """Why a pose is beyond the reach of the method; "" if it is not."""
    step = step_of_pose(pose @ np.linalg.inv(start), center)
    if (shift := float(np.linalg.norm(step[:3]))) > MOST_FROM_START_MM:
        return f"the best fit is {shift:.2f} mm from the start, more than {MOST_FROM_START_MM:g} mm: start nearer"
    if (turn := turn_deg(pose)) > MOST_TURN_DEG:
        return f"the object turned by {turn:.1f} degrees, more than {MOST_TURN_DEG:g}: take a later frame as the first"
    return ""
