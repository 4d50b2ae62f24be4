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

    The first frame with a contact is the origin. A frame without a usable motion is "lost" and says why; the next ones are
    compared with the same keyframe again, from the last pose that was found.

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


class Follower:
    """What `track` remembers: the keyframe and its pose, the last pose from it, and the last frame that was usable."""

    def __init__(self, prior: Sequence[float] | None = None, place_error: float | None = None) -> None:
        checked_prior(prior)
        self._prior, self._place_error = prior, checked_place_error(place_error)
        self._key: TouchedSurface | None = None
        self._origin: Motion  # from the first contact to the keyframe
        self._pose: Array  # from the keyframe to the last frame
        self._last: Reconstruction
        self._number, self._keyframe = -1, 0

    def __call__(self, result: Reconstruction) -> Tracked:
        """Where the object is in the next frame."""
        self._number += 1
        keyframe, motion = self._keyframe, self._motion(result)
        return Tracked(result.index, result.time_s, keyframe, motion)

    def _motion(self, result: Reconstruction) -> Motion:
        surface = TouchedSurface(result)
        if self._key is None:
            if surface.count < LEAST_PX:
                return lost(f"no contact: {surface.count} px touch, {LEAST_PX} are needed")
            found = Motion(np.eye(4), np.zeros((6, 6)), surface.middle, (), 1.0, FOUND)
            self._begin(surface, found, result)
            return found
        if why := not_comparable(self._last, result):
            return lost(why)
        # In blind directions each frame adds to what is not known.
        frames = np.sqrt(self._number - self._keyframe)
        prior = checked_prior(None if self._prior is None else [frames * one for one in self._prior])
        motion = motion_of(self._key, surface, self._pose, prior, self._place_error)
        if motion.state == LOST or motion.pose is None:
            return motion
        self._pose, self._last = motion.pose, result
        found = after(self._origin, motion)
        if motion.shared < KEPT_SHARE or turn_deg(motion.pose) > KEPT_TURN_DEG:
            self._begin(surface, found, result)
        return found

    def _begin(self, surface: TouchedSurface, found: Motion, result: Reconstruction) -> None:
        self._key, self._keyframe, self._origin = surface, self._number, found
        self._pose, self._last = np.eye(4), result


def after(first: Motion, then: Motion) -> Motion:
    """Two motions, one after the other, neither lost; the covariances add up about the center of the second."""
    poses, centers, covariances = zip(*((one.pose, one.center_mm, one.covariance) for one in (first, then)))
    carried = about_other_center(centers[1] - moved(poses[1], centers[0]))
    carried[:, :3], carried[:, 3:] = carried[:, :3] @ poses[1][:3, :3], carried[:, 3:] @ poses[1][:3, :3]
    covariance = covariances[1] + carried @ covariances[0] @ carried.T
    return replace(then, pose=poses[1] @ poses[0], covariance=covariance)
