"""Where the touching object moved since it touched: its path on the picture, its axes, and the numbers beside it."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from gelform.motion.between import FOUND, LEAST_PX, LOST, NO_PRIOR, Motion, lost, sensor_of
from gelform.motion.rigid import Array, moved
from gelform.motion.track import Follower
from gelform.result import Reconstruction

KEPT_PLACES = 256  # places of a path that are kept and sent with each frame
STEP_PX = 1.0  # px; nearer to the last place of the path there is no new one
UNSEEN = 0.25  # of the sigma without any contact; a larger sigma is that of a direction that nothing shows
UNKNOWN = dict.fromkeys(("shift_mm", "shift_sigma_mm", "turn_deg", "turn_sigma_deg", "axes"))


class MovedSince:
    """Follows the touching object from frame to frame; begins anew when nothing touches, or with another calibration."""

    def __init__(self) -> None:
        self._sensor: tuple[object, ...] = ()
        self._follow = Follower()
        self._places: deque[tuple[float, float] | None] = deque(maxlen=KEPT_PLACES)

    def __call__(self, result: Reconstruction, place_error: float | None) -> dict[str, Any]:
        """The motion up to the next frame, for the page; what is not known is None.

        Parameters
        ----------
        result : (H, W)
        place_error : as in `gelform.track`

        Returns
        -------
        dict
            `state`, `why`, `blind` : of the motion, in words
            `path` : places (x, y) in px of the contact's middle; None between two of them where the object was lost
            `shift_mm` : of the contact's middle along x and y; `shift_sigma_mm`
            `turn_deg` : about z, clockwise in the image; `turn_sigma_deg`
            `axes` : the object's x, y and z on the picture, 1 long if not tilted; z is None if the tilt is not known
        """
        if result.mm_per_px is None:
            return _facts(lost("the calibration has no scale")) | {"path": []}
        touches = np.count_nonzero(result.contact & result.known) >= LEAST_PX
        if not touches or self._sensor != sensor_of(result):
            self._sensor, self._follow = sensor_of(result), Follower(place_error=place_error)
            self._places.clear()
        motion = self._follow(result).motion if touches else lost("nothing touches")
        facts = _facts(motion)
        if facts["shift_mm"] is not None and motion.center_mm is not None:
            middle = (np.array(result.shape[::-1]) - 1) / 2
            self._add((motion.center_mm[:2] / result.mm_per_px + middle).round(2).tolist())
        elif motion.state == LOST and self._places and self._places[-1] is not None:
            self._places.append(None)
        return facts | {"path": list(self._places)}

    def _add(self, place: Any) -> None:
        last = self._places[-1] if self._places else None
        if last is None or np.hypot(*np.subtract(place, last)) >= STEP_PX:
            self._places.append(place)


def _facts(motion: Motion) -> dict[str, Any]:
    """What is known of a motion."""
    blind = list(dict.fromkeys(one.words for one in motion.blind))
    facts: dict[str, Any] = {"state": motion.state, "why": motion.why, "blind": blind, **UNKNOWN}
    if motion.state != FOUND or motion.pose is None or motion.covariance is None or motion.center_mm is None:
        return facts
    most_mm, most_rad = UNSEEN * np.array(NO_PRIOR)
    sigma, turn = np.sqrt(np.diag(motion.covariance)), motion.pose[:3, :3]
    if _largest_sigma(motion.covariance[:2, :2]) < most_mm:
        before = moved(np.linalg.inv(motion.pose), motion.center_mm)
        facts |= {"shift_mm": (motion.center_mm - before)[:2].tolist(), "shift_sigma_mm": sigma[:2].tolist()}
    if sigma[5] < most_rad:
        yaw = float(np.arctan2(turn[1, 0], turn[0, 0]))
        facts |= {"turn_deg": float(np.degrees(yaw)), "turn_sigma_deg": float(np.degrees(sigma[5]))}
        tilted = _largest_sigma(motion.covariance[3:5, 3:5]) < most_rad
        flat = [[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)], None]
        facts["axes"] = turn[:2].T.tolist() if tilted else flat
    return facts


def _largest_sigma(covariance: Array) -> float:
    """The standard deviation along the direction in which a covariance is largest."""
    return float(np.sqrt(max(0.0, np.linalg.eigvalsh(covariance)[-1])))
