"""The path of an object through results, each against a keyframe; and one surface of several contacts, solved as one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce

import cv2
import numpy as np
from numpy.typing import ArrayLike

from gelform.arrays import Array, Map
from gelform.depth.integrate import integrate
from gelform.errors import GelformError
from gelform.foundations.checks import check_list
from gelform.foundations.filters import fill_unknown
from gelform.motion.between import (
    BLOCK_PX,
    FOUND,
    FREEDOM,
    LARGEST_SIGMA,
    LEAST_PX,
    LOST,
    MOST_TURN_DEG,
    Motion,
    TouchedSurface,
    about_other_center,
    checked_place_error,
    checked_pose,
    checked_prior,
    lost,
    motion_of,
    moved,
    not_comparable,
    sensor_of,
    turn_deg,
)
from gelform.result import Reconstruction
from gelform.slopes.gradients import slopes_of_solution

KEPT_SHARE = 0.6  # of the keyframe's contact; with less in sight the present frame becomes the keyframe


@dataclass(frozen=True, eq=False)
class Tracked:
    """Where an object is in one frame of a sequence.

    Attributes
    ----------
    index, time_s : of the frame, as in its result
    keyframe : number of the frame it was compared with, from 0 in the sequence
    motion : from the first contact of the sequence to this frame. Its state, `blind` and `shared` are those against the
        keyframe; its covariance has grown with each keyframe
    """

    index: int | None
    time_s: float | None
    keyframe: int
    motion: Motion


def track(
    results: Iterable[Reconstruction],
    *,
    prior: Sequence[float] | None = None,
    place_error: float | None = None,
) -> Iterator[Tracked]:
    """Follow an object through results in the order of their frames; one `Tracked` for each of them.

    The first frame with a contact is the origin. While no frame fits it and its contact grows without a break, as at the
    first touch of an object, the grown contact takes its place. Each frame is compared with the keyframe, and if that fails
    with the last frame that was found. A frame without a usable motion is "lost" and says why; the next ones are compared
    with the same frames again.

    Parameters
    ----------
    results : (H, W) each, of one sensor, with a scale
    prior : (mm, rad), standard deviations of the motion from a frame to the next, which blind directions take alone
    place_error : as in `motion_between`

    Raises
    ------
    ValueError, TypeError, GelformError
        As `motion_between`.
    """
    follower = Follower(prior, place_error)
    if not isinstance(results, Iterable):
        raise TypeError(f"Expected results one after the other, got {type(results).__name__}.")
    for result in results:
        yield follower(result)


@dataclass(frozen=True, eq=False)
class _Placed:
    """A frame that was found: its surface, its number and its result, and the motion from the first contact to it."""

    surface: TouchedSurface
    number: int
    result: Reconstruction
    found: Motion


class Follower:
    """What `track` remembers: the keyframe, the last frame that was found, and its pose from the keyframe."""

    def __init__(self, prior: Sequence[float] | None = None, place_error: float | None = None) -> None:
        checked_prior(prior)
        self._prior, self._place_error = prior, checked_place_error(place_error)
        self._key: _Placed | None = None
        self._last: _Placed
        self._pose: Array  # from the keyframe to the last frame
        self._number = -1
        self._alone = False  # whether the contact of the origin lasts, and no frame fitted it yet

    def __call__(self, result: Reconstruction) -> Tracked:
        """Where the object is in the next frame."""
        self._number += 1
        motion, keyframe = self._motion(result)
        return Tracked(result.index, result.time_s, keyframe, motion)

    def _motion(self, result: Reconstruction) -> tuple[Motion, int]:
        """The motion from the first contact, and the number of the frame that it was compared with."""
        surface = TouchedSurface(result)
        if self._key is None:
            if surface.count < LEAST_PX:
                return lost(f"no contact: {surface.count} px touch, {LEAST_PX} are needed"), 0
            return self._first(surface, result)
        key = self._key
        if why := not_comparable(self._last.result, result):
            return lost(why), key.number
        motion = self._from(key, surface, self._pose)
        if motion.state == LOST and self._last is not key:
            # While an object is pressed in, its contact grows, and the first touch no longer shows its surface.
            nearer = self._from(self._last, surface, np.eye(4))
            if nearer.state != LOST:
                key, motion = self._last, nearer
                self._begin(key)
        self._alone &= motion.state == LOST and surface.count >= LEAST_PX
        if self._alone and key.surface.count < KEPT_SHARE * surface.count:
            return self._first(surface, result)
        if motion.state == LOST or motion.pose is None:
            return motion, key.number
        found = after(key.found, motion)
        self._pose, self._last = motion.pose, _Placed(surface, self._number, result, found)
        if motion.shared < KEPT_SHARE or turn_deg(motion.pose) > MOST_TURN_DEG / 2:
            self._begin(self._last)
        return found, key.number

    def _from(self, key: _Placed, surface: TouchedSurface, start: Array) -> Motion:
        """The motion from a frame to this one; in blind directions each frame between adds to what is not known."""
        frames = np.sqrt(self._number - key.number)
        prior = checked_prior(None if self._prior is None else [frames * one for one in self._prior])
        return motion_of(key.surface, surface, start, prior, self._place_error)

    def _first(self, surface: TouchedSurface, result: Reconstruction) -> tuple[Motion, int]:
        """The origin of the path."""
        found = Motion(np.eye(4), np.zeros((FREEDOM, FREEDOM)), surface.middle, (), 1.0, FOUND)
        self._begin(_Placed(surface, self._number, result, found))
        self._alone = True
        return found, self._number

    def _begin(self, key: _Placed) -> None:
        self._key = self._last = key
        self._pose = np.eye(4)


def after(first: Motion, then: Motion) -> Motion:
    """Two motions, one after the other, neither lost; the covariances add up about the center of the second."""
    poses, centers, covariances = zip(*((one.pose, one.center_mm, one.covariance) for one in (first, then)))
    carried = about_other_center(centers[1] - moved(poses[1], centers[0]))
    carried[:, :3], carried[:, 3:] = carried[:, :3] @ poses[1][:3, :3], carried[:, 3:] @ poses[1][:3, :3]
    covariance = covariances[1] + carried @ covariances[0] @ carried.T
    return replace(then, pose=poses[1] @ poses[0], covariance=covariance)


MOST_SIDE = 4000  # px, of a mosaic
TINY = 1e-12  # weight where nothing is known
Placed = tuple[TouchedSurface, Array, Array, Array]  # with its pose, covariance and center


def mosaic(
    results: Sequence[Reconstruction], poses: Sequence[Motion | Tracked | ArrayLike]
) -> Reconstruction:
    """The surface that several results of one object show together, as a result of its own.

    Minimizes `sum W |grad z - g|^2 + 1e-3 sum w (z - mean z)^2` over what all contacts show: g are their slopes and z their
    depths, moved back to the first frame, W and w the inverse variances, less toward the border of a contact.

    Parameters
    ----------
    results : (H, W) each, of one sensor, with a scale
    poses : of each result, from the first frame to it: from `track` or `motion_between`, or (4, 4). Lost ones are left out

    Returns
    -------
    Reconstruction
        Its middle is that of the first frame, its pixels are as large. `known` and `contact` are where a contact was;
        `depth_sigma_mm` has the depths' sigma and the poses' covariance.

    Raises
    ------
    ValueError, TypeError, GelformError
        Not one pose for each result; results of different sensors or without a scale; none with a contact and a pose; a
        surface wider than 4000 px.
    """
    check_list(results, "results", Reconstruction)
    check_list(poses, "poses")
    if len(results) != len(poses):
        raise ValueError(f"Expected one pose for each result, got {len(results)} and {len(poses)}.")
    if len({sensor_of(one) for one in results}) > 1:
        raise ValueError("Expected results of one sensor and calibration, got several.")
    seen = placed(results, poses)
    if not seen:
        raise GelformError("No result has both a contact and a pose, so there is no surface.")
    shape, pitch = shape_of(seen), seen[0][0].pitch
    totals = reduce(np.add, (layer_of(*one, shape) for one in seen))
    *slopes_and_depth, slope_weight, depth_weight, share = totals
    known_px = np.asarray(share > 0)
    slope_weight, depth_weight = np.maximum(slope_weight, TINY), np.maximum(depth_weight, TINY)
    slopes = np.dstack(slopes_and_depth[:2]) / slope_weight[..., None]
    # Filled beyond the border, or its slopes there would be of a step down to 0.
    mean = np.asarray(slopes_and_depth[2] / depth_weight, np.float32)[..., None]
    mean = fill_unknown(mean, known_px)[..., 0]
    weight = slope_weight / slope_weight.max()
    # The anchor holds at 0: what is solved for is the difference from the mean depth. It has a thousandth of the slopes'
    # weight, which know the shape better.
    solution = integrate(
        slopes - slopes_of_solution(mean, (pitch[0], pitch[1])), mm_per_px=tuple(pitch), weights=weight, mask=known_px,
        anchor=np.where(known_px, 1e-3 * depth_weight * pitch.prod() / slope_weight.max(), 0),
    )  # fmt: skip
    depth = np.where(known_px, mean + solution.depth_mm, 0).astype(np.float32)
    # Errors of depth are much alike in all contacts, so several are no surer than one.
    sigma = np.where(known_px, np.sqrt(share / depth_weight), LARGEST_SIGMA).astype(np.float32)
    slope_sigma = np.where(known_px, 1 / np.sqrt(slope_weight), LARGEST_SIGMA).astype(np.float32)
    return Reconstruction(
        depth=depth, depth_sigma_mm=sigma, gradients=slopes_of_solution(depth, (pitch[0], pitch[1])),
        gradients_sigma=np.stack([slope_sigma, slope_sigma], axis=-1), confidence=weight.astype(np.float32) * known_px,
        contact=known_px, known=known_px, mm_per_px=results[0].mm_per_px, mm_per_px_sigma=results[0].mm_per_px_sigma,
        solver=solution.solver, curl_rms=solution.curl_rms, calibration_digest=results[0].calibration_digest,
    )  # fmt: skip


def placed(results: Sequence[Reconstruction], poses: Sequence[Motion | Tracked | ArrayLike]) -> list[Placed]:
    """The surfaces of the results with a contact and a pose; a matrix alone is sure."""
    found = []
    for surface, one in zip(map(TouchedSurface, results), poses):
        if not surface.count:
            continue
        motion = one.motion if isinstance(one, Tracked) else one
        if not isinstance(motion, Motion):
            found.append(
                (surface, checked_pose(motion, "a pose"), np.zeros((FREEDOM, FREEDOM)), surface.middle)
            )
        elif motion.pose is not None and motion.covariance is not None and motion.center_mm is not None:
            found.append((surface, motion.pose, motion.covariance, motion.center_mm))
    return found


def shape_of(seen: Sequence[Placed]) -> tuple[int, int]:
    """The size (H, W) about the first frame's middle that holds all contacts, odd or even as the first frame's."""
    reach = [
        np.abs(moved(np.linalg.inv(pose), one.points)[:, :2] / one.pitch).max(axis=0)
        for one, pose, *_ in seen
    ]
    across, down = np.ceil(np.max(reach, axis=0)).astype(int).tolist()
    first = seen[0][0].shape
    height, width = 2 * down + 2 + first[0] % 2, 2 * across + 2 + first[1] % 2
    if max(height, width) > MOST_SIDE:
        raise ValueError(
            f"Expected a surface of at most {MOST_SIDE} px a side, got {height}x{width}: are the poses in mm?"
        )
    return height, width


def layer_of(
    surface: TouchedSurface, pose: Array, covariance: Array, center: Array, shape: tuple[int, int]
) -> Array:
    """A contact in the frame of the first: what each pixel (H, W) adds to sums, from the place that was there.

    Both slopes and the depth, weighted; their weights; the share (0-1) of what the contact weighs in its middle.
    """
    height, width = shape
    back, turn = np.linalg.inv(pose), pose[:3, :3]
    row, col = np.mgrid[:height, :width]
    place = np.stack([col - (width - 1) / 2, row - (height - 1) / 2], axis=-1) * surface.pitch
    there = moved(pose, np.dstack([place, np.full(shape, surface.middle[2])]))  # in the contact's frame
    for _ in range(5):  # until the place is known to a fraction of a pixel
        pixel = surface.pixels_at(there)
        there[..., 2] = _sampled(surface.depth, pixel)
        there[..., :2] += (place - moved(back, there)[..., :2]) @ turn[:2, :2].T
    slopes = _sampled(surface.gradients, pixel)
    variances = _sampled(surface.variances, pixel).astype(np.float64)
    touched = cv2.copyMakeBorder(surface.contact.view(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    inward_px = _sampled(cv2.distanceTransform(touched, cv2.DIST_L2, 3)[1:-1, 1:-1], pixel)
    share = np.where(inward_px > 0.5, np.minimum(inward_px / BLOCK_PX, 1), 0)
    normal = np.dstack([-slopes, np.ones(shape)])
    change = np.concatenate([normal, np.cross(there - center, normal)], axis=-1)  # by an error of the pose
    of_pose = np.asarray(np.einsum("...i,ij,...j->...", change, covariance, change), dtype=np.float64)
    of_depth = variances[..., 2] + of_pose
    normal = normal @ turn  # turned back
    slope_weight = 2 * share / np.maximum(variances[..., 0] + variances[..., 1], TINY)
    depth_weight = share / np.maximum(of_depth, TINY)
    values = np.dstack([-normal[..., :2] / normal[..., 2:], moved(back, there)[..., 2]])
    weighted = values * np.dstack([slope_weight, slope_weight, depth_weight])
    return np.stack([*np.moveaxis(weighted, -1, 0), slope_weight, depth_weight, share])


def _sampled(values: Map, pixel: Map) -> Map:
    """Values (h, w) or (h, w, n) at places (H, W, 2), px, between pixels; 0 outside."""
    return np.asarray(cv2.remap(values, pixel, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT))
