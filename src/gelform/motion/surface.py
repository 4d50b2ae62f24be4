"""Rigid motions, the touched surface of a result as matching needs it, and the equations of a small motion of it.

Rigid motions are (4, 4) in mm, small steps (shift x, y, z in mm; turn about x, y, z in rad) about a center. The axes are
those of a depth map: x to the right, y down, z toward the camera; (0, 0, 0) is the image's middle on the gel at rest. A
positive turn about z leads from x to y, clockwise in the image.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform._native import Kernel
from gelform.arrays import Array, Floats, Mask, Slopes
from gelform.errors import GelformError
from gelform.foundations.checks import check_is, check_mm_per_px, check_values, value_range
from gelform.result import Reconstruction

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
    change = np.eye(6)
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
MARGIN_PX = 4  # px around a contact, for the filters

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
        smooth = cv2.getGaussianKernel(7, 0.8)
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
        jacobian, normal, inside = np.empty((n, 3, 6), np.float32), np.empty((6, 7)), np.empty(n, np.bool_)
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
        """The touched pixels (h, w) more than 3 px inside the border, where slopes change because the contact ends."""
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (7, 7))
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
    # What the stated sigma lacks: 0.03 of a slope, and 5 um of a depth.
    return cv2.add(known, (0.03**2, 0.03**2, 0.005**2, 0), dst=known)
