"""The path of an object through results: each frame against a keyframe, which is replaced as the contact moves on."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gelform.motion.between import (
    FOUND,
    LEAST_PX,
    LOST,
    MOST_TURN_DEG,
    Motion,
    checked_place_error,
    checked_prior,
    lost,
    motion_of,
    not_comparable,
)
from gelform.motion.rigid import Array, about_other_center, moved, turn_deg
from gelform.motion.surface import TouchedSurface
from gelform.result import Reconstruction

KEPT_SHARE = 0.6  # of the keyframe's contact; with less in sight the present frame becomes the keyframe
KEPT_TURN_DEG = MOST_TURN_DEG / 2


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
        if motion.shared < KEPT_SHARE or turn_deg(motion.pose) > KEPT_TURN_DEG:
            self._begin(self._last)
        return found, key.number

    def _from(self, key: _Placed, surface: TouchedSurface, start: Array) -> Motion:
        """The motion from a frame to this one; in blind directions each frame between adds to what is not known."""
        frames = np.sqrt(self._number - key.number)
        prior = checked_prior(None if self._prior is None else [frames * one for one in self._prior])
        return motion_of(key.surface, surface, start, prior, self._place_error)

    def _first(self, surface: TouchedSurface, result: Reconstruction) -> tuple[Motion, int]:
        """The origin of the path."""
        found = Motion(np.eye(4), np.zeros((6, 6)), surface.middle, (), 1.0, FOUND)
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
