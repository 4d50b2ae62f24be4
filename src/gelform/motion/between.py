"""Where an object moved between two contacts: its pose, the pose's covariance, and what the contacts cannot show.

Rigid motions are (4, 4) in mm, small steps (shift x, y, z in mm; turn about x, y, z in rad) about a center. The axes are
those of a depth map: x to the right, y down, z toward the camera; (0, 0, 0) is the image's middle on the gel at rest. A
positive turn about z leads from x to y, clockwise in the image.

The touched surface of one frame is moved rigidly onto that of the other, so that its slopes and its depth agree
(Gauss-Newton, weighted by both frames' standard deviations, Huber's loss). docs/motion-derivation.md has the formulas.

No plain estimator of the covariance is honest, because errors of slopes are alike over many pixels and partly the same in
both frames. C = F S F + R D R' + p p' + (f d)^2 E: S from the sums of 16 px blocks (a sandwich), F and D factors that were
chosen on measured contacts (docs/motion-derivation.md), R the pose's response to slopes that are off everywhere, p the pull
of errors that stay at their place while the object moves a little, f d the error of a place on the sensor, in proportion to
the displacement; E = 1 for x and y, and for turns less, over the contact's radius, because the error changes along it.

Blind are the directions of motion that leave a surface as it is, such as turns of a ball. A direction is seen if the change
of slopes that it predicts from one frame correlates with the one from the other: shape does, noise does not. A
calibration's own error looks like shape too, so turns of a ball are blind up to that error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform._native import Kernel
from gelform.arrays import Array, Floats, Mask, Slopes
from gelform.errors import GelformError
from gelform.foundations.checks import (
    check_is,
    check_mm_per_px,
    check_numbers,
    check_values,
    check_within,
    value_range,
)
from gelform.foundations.information import determined_by
from gelform.result import Reconstruction

FREEDOM = 6  # of a rigid motion: three shifts and three turns
ORTHONORMAL = 1e-6  # largest entry of R'R - 1 of a rotation, and error of the last row


def pose_of_step(step: Array, center: Array) -> Array:
    """The motion (4, 4) that turns by step[3:] about the center, then shifts by step[:3]."""
    pose = np.eye(4)
    pose[:3, :3] = cv2.Rodrigues(np.asarray(step[3:], np.float64))[0]
    pose[:3, 3] = center + step[:3] - pose[:3, :3] @ center
    return pose


def step_of_pose(pose: Array, center: Array) -> Array:
    """The step (6,) about a center that is a motion (4, 4); the inverse of `pose_of_step`."""
    return np.concatenate([moved(pose, center) - center, cv2.Rodrigues(pose[:3, :3])[0].ravel()])


def moved(pose: Array, points: Array) -> Array:
    """Points (..., 3) after a motion."""
    return np.asarray(points @ pose[:3, :3].T + pose[:3, 3], dtype=np.float64)


def about_other_center(offset: Array) -> Array:
    """The matrix (6, 6) that makes a step about a center one about another, which is `offset` (3,) away."""
    x, y, z = offset
    change = np.eye(FREEDOM)
    change[:3, 3:] = [[0, z, -y], [-z, 0, x], [y, -x, 0]]  # turn x offset
    return change


def turn_deg(pose: Array) -> float:
    """The angle of a motion's rotation, degrees."""
    return float(np.degrees(np.linalg.norm(cv2.Rodrigues(pose[:3, :3])[0])))


def checked_pose(pose: ArrayLike, name: str) -> Array:
    """A rigid motion (4, 4); ValueError or TypeError for anything else."""
    matrix: Array = np.asarray(check_values(pose, name), dtype=np.float64)
    wrong = matrix.shape != (4, 4) or np.abs(matrix[3] - (0, 0, 0, 1)).max() > ORTHONORMAL
    turn = np.zeros((3, 3)) if wrong else matrix[:3, :3]
    if np.abs(turn.T @ turn - np.eye(3)).max() > ORTHONORMAL or np.linalg.det(turn) < 0:
        raise ValueError(f"Expected {name} as a rigid motion (4, 4): rotation, shift in mm and 0, 0, 0, 1.")
    return matrix


LARGEST = 1e6  # mm and mm/mm; sums of squares of larger ones are beyond float32
LARGEST_SIGMA = 3.0  # mm/mm and mm; what is less certain, or NaN, counts as this
MOVED_PX = 3.0  # px; errors that belong to a place on the sensor are alike so far, and look like shape
MARGIN_PX = 4  # px around a contact, as far as the derivatives of its slopes reach

_motion_rows = Kernel(
    "motion_rows",
    "f32[n,3] points, f32[n,2] slopes, f32[n,3] variance, f32[h,w,2] gradients, f32[h,w] depth, "
    "f32[h,w,2] along_x, f32[h,w,2] along_y, f32[h,w,3] variances, bool[h,w] contact, bool[h,w] inner, f64[3,4] pose, "
    "f64[3] center, f64[2] pitch, f64[2] origin, f32 huber, out f32[n,3] residual, out f32[n,3,6] jacobian, "
    "out f32[n,3] weight, out bool[n] inside, out f64[6,7] normal",
)


@dataclass(frozen=True, eq=False)
class Equations:
    """What a small further step (6,) about a center changes at the points of a moved surface."""

    pose: Array  # (4, 4), where the equations hold
    center: Array  # (3,)
    residual: Floats  # (N, 3) slope along x and y, depth: the other surface minus the moved one
    jacobian: Floats  # (N, 3, 6) their change with the step
    weight: Floats  # (N, 3), 0 where the other surface was not touched
    inside: Mask  # (N,) bool, whether a point is in the inner part of the other contact
    information: Array  # (6, 6), of the normal equations
    right: Array  # (6,)
    count: int  # number of points that the other surface has too

    @property
    def shared(self) -> Mask:
        """The points (N,) that the other surface has too."""
        return np.asarray(self.weight[:, 2] > 0)

    @property
    def misfit(self) -> float:
        """Root mean square of the residuals over their stated errors."""
        return float(np.sqrt(np.sum(self.weight * np.square(self.residual)) / max(1, 3 * self.count)))

    def step(self, seen: Array, held: Array, off: Array) -> Array:
        """The best step (6,) in some directions (6, k), held by an information (6,) to where it is `off` (6,) from."""
        along = seen.T @ (self.information + np.diag(held)) @ seen  # definite by what holds it
        right = seen.T @ (self.right - held * off)
        return np.asarray(seen @ np.linalg.solve(along, right), dtype=np.float64)


class TouchedSurface:
    """The touched pixels of a result as points, and its maps (h, w) in the rectangle around them, prepared once.

    The points are those of a frame that others are compared with; of the other frames, nobody asks for them.
    """

    def __init__(self, result: Reconstruction) -> None:
        check_is(result, Reconstruction, "a result")
        if result.mm_per_px is None:
            raise GelformError("Motion needs millimeters, and the calibration of this result has no scale.")
        self.pitch: Array = np.array(check_mm_per_px(result.mm_per_px))
        height, width = self.shape = result.contact.shape
        left, top, across, down = cv2.boundingRect(result.contact.view(np.uint8))
        rows = slice(max(top - MARGIN_PX, 0), top + down + MARGIN_PX)
        cols = slice(max(left - MARGIN_PX, 0), left + across + MARGIN_PX)
        self.closed = _closed(result.contact[rows, cols], self.pitch)
        self.contact = self.closed & result.known[rows, cols]
        self.depth = np.ascontiguousarray(result.depth_mm[rows, cols])
        # As read: a solution that smooths a crest moves it.
        slopes = result.gradients if result.observed_gradients is None else result.observed_gradients
        self.gradients = np.ascontiguousarray(slopes[rows, cols])
        # (x, y) in px of the rectangle that is 0 mm
        self.origin: Array = np.array([(width - 1) / 2 - cols.start, (height - 1) / 2 - rows.start])
        self.variances = _variances(result, rows, cols)
        for size, unit in ((self.depth, "mm"), (self.gradients, "mm/mm")):
            if (largest := max(map(abs, value_range(size)))) > LARGEST:
                raise GelformError(
                    f"Motion needs depth and slopes up to {LARGEST:.0e}, got {largest:.1e} {unit}: are the units right?"
                )
        # Derivatives (h, w, 2) of smoothed slopes along x, and along y.
        smooth = cv2.getGaussianKernel(2 * MARGIN_PX - 1, 0.8)
        difference, pitch = np.convolve(smooth.ravel(), [-0.5, 0, 0.5]), self.pitch
        self.derivatives = (
            cv2.sepFilter2D(self.gradients, -1, difference / pitch[0], smooth),
            cv2.sepFilter2D(self.gradients, -1, smooth, difference / pitch[1]),
        )
        self.count = int(np.count_nonzero(self.contact))
        self.share = self.count / result.contact.size
        # One of so many rows and columns is a point: errors of neighbors are alike, so more than 1500 tell little more.
        self.every = max(1, int(np.ceil(np.sqrt(self.count / 1500))))

    @cached_property
    def pixels(self) -> NDArray[np.intp]:
        """Rows and columns (N, 2) of the points in the rectangle."""
        return self.every * np.argwhere(self.contact[:: self.every, :: self.every])

    @cached_property
    def points(self) -> Floats:
        """Positions (N, 3), mm."""
        points = np.empty((len(self.pixels), 3), np.float32)
        points[:, :2] = (self.pixels[:, ::-1] - self.origin) * self.pitch
        points[:, 2] = self.depth[tuple(self.pixels.T)]
        return points

    @cached_property
    def slopes(self) -> Slopes:
        """Slopes (N, 2) of the points."""
        return self.gradients[tuple(self.pixels.T)]

    @cached_property
    def point_variances(self) -> Floats:
        return self.variances[tuple(self.pixels.T)]

    def equations(self, other: TouchedSurface, pose: Array) -> Equations:
        """The equations of a step that follows the motion `pose` of this surface onto another, about its moved middle."""
        n, center = len(self.points), moved(pose, self.middle)
        residual, weight = np.empty((n, 3), np.float32), np.empty((n, 3), np.float32)
        jacobian, inside = np.empty((n, 3, FREEDOM), np.float32), np.empty(n, np.bool_)
        normal = np.empty((FREEDOM, FREEDOM + 1))
        count = _motion_rows(
            self.points, self.slopes, self.point_variances, other.gradients, other.depth, *other.derivatives,
            other.variances, other.contact, other.inner, np.ascontiguousarray(pose[:3]), center, self.pitch, other.origin,
            3.0, residual, jacobian, weight, inside, normal,  # root mean squares, from which residuals count less
        )  # fmt: skip
        return Equations(pose, center, residual, jacobian, weight, inside, normal[:, :6], normal[:, 6], count)

    @cached_property
    def middle(self) -> Array:
        """The mean (3,) of the points."""
        return np.asarray(self.points.mean(axis=0, dtype=np.float64))

    @property
    def centroid(self) -> Array:
        """The mean place (2,) of the touched pixels, mm."""
        return np.asarray((np.argwhere(self.contact).mean(axis=0)[::-1] - self.origin) * self.pitch)

    @cached_property
    def scale(self) -> Array:
        """Units (6,) of a step in which shifts and turns move the points by alike: 1 mm, and 1 mm at their distance."""
        away = self.points - self.middle
        return np.repeat([1.0, np.sqrt(len(away) / np.sum(np.square(away)))], 3)

    @cached_property
    def own(self) -> Equations:
        """The equations of this surface onto itself."""
        return self.equations(self, np.eye(4))

    @cached_property
    def inner(self) -> Mask:
        """The touched pixels (h, w) so far inside that their smoothed slopes are of the contact alone."""
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * MARGIN_PX - 1,) * 2)
        inner = cv2.erode(self.closed.view(np.uint8), disc, borderValue=0)
        return self.contact & inner.view(np.bool_)

    def pixels_at(self, points: Array) -> Floats:
        """Columns and rows (..., 2) in the rectangle at points (..., 3)."""
        return np.asarray(points[..., :2] / self.pitch + self.origin, dtype=np.float32)


def _closed(contact: Mask, pitch: Array) -> Mask:
    """A contact (h, w) with the gaps between the tops of a texture, narrower than 1 mm, which move with them."""
    across, down = (2 * np.rint(0.5 / pitch) + 1).astype(int).tolist()
    border = (down, down, across, across)
    padded = cv2.copyMakeBorder(contact.astype(np.uint8), *border, cv2.BORDER_CONSTANT, value=0)
    closed = cv2.morphologyEx(padded, cv2.MORPH_CLOSE, np.ones((down, across), np.uint8))
    return closed[down:-down, across:-across].view(np.bool_)


def _variances(result: Reconstruction, rows: slice, cols: slice) -> Floats:
    """Variances (h, w, 3) of a pixel's slopes and of its depth; a sigma that is not stated counts as 0."""
    slopes, depth = (result.gradients_sigma, result.gradients), (result.depth_sigma_mm, result.depth_mm)
    maps = (np.zeros_like(of) if sigma is None else sigma for sigma, of in (slopes, depth))
    known = cv2.merge([one[rows, cols] for one in maps])
    cv2.patchNaNs(known, LARGEST_SIGMA)
    np.square(np.minimum(known, np.float32(LARGEST_SIGMA), out=known), out=known)
    # What the stated sigma lacks, of a slope and of a depth (mm).
    of_slope, of_depth = 0.03**2, 0.005**2
    return cv2.add(known, (of_slope, of_slope, of_depth, 0), dst=known)


FOUND, LOST, UNSURE = "found", "lost", "cannot tell yet"
# Mm and degrees: farther from the start there are other minima; farther turned, every method drifts by .1-.3 mm, 2-5 deg.
MOST_FROM_START_MM, MOST_TURN_DEG = 0.5, 10.0
NO_PRIOR = 10.0, float(np.radians(MOST_TURN_DEG))  # mm and rad, what is known where nothing is seen
LAST_MM, LAST_RAD = 2e-3, 5e-4  # a smaller step is the last
BLOCK_PX = 16  # px, side of the blocks whose errors count as independent
LEAST_SHARE, LEAST_PX = 0.25, BLOCK_PX**2  # of the contact, and pixels (a block), that both frames touch
HALF = 0.5  # of the squares of a change: what explains less of them is blind


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
    # Beyond, the squares of a prior and of what was seen have no common precision.
    return check_within(shift, "prior's mm", 1e-6, 1e6), check_within(turn, "prior's rad", 1e-6, 1e6)


def checked_place_error(share: float | None) -> float:
    """The error of a place over the displacement; None: the largest of three Minis (two GelSlims have .010, .015)."""
    return 0.006 if share is None else check_within(share, "place_error", 0, 1)


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
    found = _fitted(first, second, start, np.eye(FREEDOM))
    if isinstance(found, Motion):
        return found
    blind, freely, pivot_mm = blind_directions(first, found)
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
    if (misfit := found.misfit) > 1:  # .84 at most on real contacts
        return lost(f"the surfaces differ by {misfit:.1f} times their errors: is it another object?", shared)
    own, filled = pose_covariance(first, found, inverse, travel * place_error), []
    if max(first.share, second.share) > 0.9:  # no gel at rest is left that depth could be measured from
        own[2, 2] += 1e6  # mm^2
        words = "shifts along z: the contact fills the view, nothing is at rest"
        filled = [Blind(np.array([0, 0, 1.0, 0, 0, 0]), 0.0, words)]
    along = np.linalg.inv(np.column_stack([freely, *(one.direction for one in blind)]))[: freely.shape[1]]
    # A thousandth of the covariance by the stated sigmas remains where residuals are 0 or come from one block, which
    # measures none; where it is measured, on textures and balls, it is 1 to 60 times that of the stated sigmas.
    seen = along @ own @ along.T + 1e-3 * stated
    if pivot_mm:  # what turns about a center that is elsewhere would shift this one
        seen[:2, :2] += (pivot_mm * min(prior[1], NO_PRIOR[1])) ** 2 * np.eye(2)
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
    left = np.eye(FREEDOM) - gain @ along
    step = step_of_pose(pose @ np.linalg.inv(start), center)
    found = pose_of_step(freely @ along @ gain @ along @ step, center) @ start
    return found, left @ held @ left.T + gain @ own @ gain.T


def _fitted(first: TouchedSurface, second: TouchedSurface, start: Array, seen: Array) -> Equations | Motion:
    """The equations about one step from the best pose, in the directions (6, k) alone, held to the start by the range."""
    # Errors of neighbors are alike, but the equations count each as news: so must what holds them at the start.
    reach = np.repeat((MOST_FROM_START_MM, np.radians(MOST_TURN_DEG)), 3)
    held = (BLOCK_PX / first.every) ** 2 * (1 / np.square(reach))
    pose, back = start, np.linalg.inv(start)  # rigid, as every pose: never singular
    for _ in range(30):
        equations = first.equations(second, pose)
        share, seen_px = equations.count / len(first.points), equations.count * first.every**2
        if seen_px < LEAST_PX or share < LEAST_SHARE:
            return lost(
                f"the two frames have {100 * share:.0f} % of the contact in common ({seen_px} px), and a motion needs "
                f"{100 * LEAST_SHARE:.0f} % and {LEAST_PX} px: move less between them",
                share,
            )
        step = equations.step(seen, held, step_of_pose(pose @ back, equations.center))
        shift, turn = float(np.linalg.norm(step[:3])), float(np.linalg.norm(step[3:]))
        if shift < LAST_MM and turn < LAST_RAD:
            break
        step *= min(1.0, reach[0] / max(shift, LAST_MM), reach[-1] / max(turn, LAST_RAD))
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


def pose_covariance(surface: TouchedSurface, equations: Equations, inverse: Array, place_mm: float) -> Array:
    """Covariance (6, 6) of a step, from the equations at the best pose and the inverse (6, 6) of their information."""
    weighted = equations.jacobian * equations.weight[..., None]
    scores = np.einsum("nki,nk->ni", weighted, equations.residual)
    row, col = surface.pixels.T // BLOCK_PX
    block = row * (int(col.max()) + 1) + col
    sums = np.stack([np.bincount(block, of) for of in scores.T], axis=1)
    count = int(np.count_nonzero(np.bincount(block, equations.shared)))
    sandwich = inverse @ (sums.T @ sums) @ inverse * count / max(count - FREEDOM, 1)
    # Slopes off by a constant, and too steep by a factor, along x and along y; and the pull of what stays.
    common = [np.stack([np.ones_like(of), of]) @ weighted[:, k] for k, of in enumerate(surface.slopes.T)]
    response = inverse @ np.vstack([*common, _pull(surface, equations)]).T
    of_z, of_tilt = 5.5, 2.8  # factors of standard deviations
    factors = np.array([1, 1, of_z, of_tilt, of_tilt, 1])
    covariance = sandwich * np.outer(factors, factors)
    offset, gain = 0.003, 0.02  # mm/mm, and of a slope: standard deviations of what all slopes have in common
    covariance += (response * np.square([offset, gain, offset, gain, 1])) @ response.T
    # The ends of a contact err against each other, along it (tilts) and across it (yaw), on pairs of a cube's edge.
    covariance += np.diag(np.square(place_mm * surface.scale * (1, 1, 0, 0.25, 0.25, 0.7)))
    return np.asarray(covariance, dtype=np.float64)


def _pull(surface: TouchedSurface, equations: Equations) -> Array:
    """The right side (6,) that draws the object back to where it was: errors that stay match best without a motion.

    They are taken to be as large as those that changed: s, the RMS of the slopes' residuals. With errors alike as
    exp(-d^2 / 2 l^2), l = 3 px, a point that moved by d is drawn back by d exp(-d^2 / 2 l^2) (s / l)^2.
    """
    weights, alike_mm = equations.weight[:, :2], MOVED_PX * surface.pitch
    variance = np.sum(weights * np.square(equations.residual[:, :2])) / np.sum(weights)
    there = moved(equations.pose, surface.points)
    shift = (there - surface.points)[:, :2] / alike_mm
    share = (weights[:, 0] + weights[:, 1]) * np.exp(-np.einsum("nk,nk->n", shift, shift) / 2)
    drawn = share[:, None] * shift * (variance / alike_mm)
    x, y = np.ones(len(drawn)) @ drawn
    lever = (there - equations.center).T @ drawn
    return np.array([x, y, 0, -lever[2, 1], lever[2, 0], lever[0, 1] - lever[1, 0]])


@dataclass(frozen=True, eq=False)
class Blind:
    """A direction of motion that cannot be seen.

    Its correlation is that of the changes of slope which both frames predict, below 0.71; of a ball, the share of the
    places that no ball explains, below 0.5.
    """

    direction: Array  # (6,) a shift, mm, and a turn, rad, about the contact's middle
    correlation: float
    words: str  # what moves so, such as "turns about the ball's center at (0.1, -0.4, -2.6) mm"


def blind_directions(first: TouchedSurface, at: Equations) -> tuple[tuple[Blind, ...], Array, float]:
    """The directions that the equations at the best pose of two contacts cannot tell, and the others (6, k).

    The others do not turn about the axes of blind turns, and do not shift along blind shifts. The last is the standard
    deviation of a ball's center along z, mm; 0 without one.
    """
    scale = first.scale
    _, directions, undetermined = determined_by(at.information, scale)
    alike = np.where(undetermined, 0.0, _correlations(first, at, directions))
    chosen = alike < HALF**0.5  # 97 % of the directions that are not blind lie above
    if chosen.any() and (ball := _ball(first, at)) is not None:
        pivot, shape = ball
        turns = np.concatenate([about_other_center(-pivot)[:3, 3:], np.eye(3)]).T
        center = f"turns about the ball's center at {_place(at.center + pivot)}"
        pivot_mm = float(_sizes(pivot)) * shape**0.5
        return tuple(Blind(turn, shape, center) for turn in turns), np.eye(FREEDOM)[:, :3], pivot_mm
    unseen = directions[:, chosen].T
    # A small turn beside a shift is noise: times a prior of millimeters, it would make turns uncertain that are seen.
    turning = _sizes(unseen[:, 3:] / scale[3:]) > 0.3 * _sizes(unseen[:, :3])
    shifts = np.linalg.eigh(at.information[:3, :3])[1].T
    unseen[~turning] = np.pad(shifts[: np.count_nonzero(~turning)], ((0, 0), (0, 3)))
    held = np.where(turning[:, None], unseen * (0, 0, 0, 1, 1, 1), unseen / scale**2) * scale
    others = np.linalg.svd(held)[2][len(held) :]
    words = [
        f"turns about {_axis(turn)} through {_place(at.center + np.cross(turn, shift) / (turn @ turn))}"
        if turns_too
        else f"shifts along {_axis(shift)}"
        for shift, turn, turns_too in zip(unseen[:, :3], unseen[:, 3:], turning)
    ]
    return tuple(map(Blind, unseen, alike[chosen].tolist(), words)), scale[:, None] * others.T, 0.0


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
        one.jacobian.reshape(-1, FREEDOM) @ steps.astype(np.float32)
        for one, steps in ((at, directions), (first.own, back))
    )
    both, *alone = (
        np.diag((weight * one).T @ other) for one, other in ((theirs, ours), (theirs, theirs), (ours, ours))
    )
    return np.asarray(both / np.sqrt(np.maximum(alone[0] * alone[1], 1e-30)), dtype=np.float64)


def _ball(first: TouchedSurface, at: Equations) -> tuple[Array, float] | None:
    """The center, from that of the equations, of a ball that both frames show, and the share of the places that is none.

    Slopes read too small or too steep, as by another unit's calibration, leave a ball's normals linear in the place.
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
    away, off = point - middle, normal - upward
    places, apart = of_point @ np.square(away).sum(axis=1), of_point @ np.square(off).sum(axis=1)
    both = of_point @ (away * off).sum(axis=1)
    left = 1 - max(both, 0) ** 2 / max(places * apart, 1e-30)
    pivot = middle - upward * both / max(apart, 1e-12 * total)
    # The stated variance of a slope over its square.
    doubt = 2 * np.count_nonzero(weight) / max(float(np.sum(weight * np.square(first.slopes))), 1e-30)
    return (pivot, left) if left < min(HALF, doubt) else None


def _sizes(vectors: Array) -> Array:
    return np.asarray(np.linalg.norm(vectors, axis=-1))


def _place(point: Array) -> str:
    return f"({', '.join(f'{value:.1f}' for value in point)}) mm"


def _axis(direction: Array) -> str:
    """The name of the nearest axis, or the direction itself."""
    unit = direction / np.linalg.norm(direction)
    nearest = int(np.abs(unit).argmax())
    if abs(unit[nearest]) > 0.95:
        return "xyz"[nearest]
    return f"({', '.join(f'{value:.2f}' for value in unit * np.sign(unit[nearest]))})"
