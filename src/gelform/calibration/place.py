"""The error of a place on the sensor, in proportion to a displacement, as a calibration's own presses show it.

A ball's center is found from the contact's slopes (`gelform.motion`) and from the circle in the image. Slopes are wrong by
a little more at one place than at another, so the two differ by more, the farther the ball moved.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.enough import SAMPLED
from gelform.calibration.presses.press_set import Press
from gelform.calibration_file import Calibration
from gelform.motion.between import motion_between
from gelform.motion.rigid import moved
from gelform.reconstruct import Reconstructor

LEAST_MM = 1.0  # of a displacement; the circles' own errors matter below
LEAST_PAIRS = 4


def place_error_from_presses(
    calibration: Calibration, presses: Sequence[Press], contacts: Sequence[ContactCircle]
) -> float | None:
    """Root mean square error of a ball's center along an axis, over its displacement; None: too few pairs.

    Each press is compared with the next one of the same ball, from where the circles say that it is.
    """
    reconstruct, pitch = Reconstructor(calibration), calibration.known_mm_per_px
    middle = (np.array(calibration.image_shape[::-1]) - 1) / 2
    step = -(-len(presses) // SAMPLED)
    whole = [
        (press, np.array([circle.x_px, circle.y_px]))
        for press, circle in zip(presses[::step], contacts[::step])
        if _is_whole(circle, calibration.image_shape)
    ]
    whole.sort(key=lambda one: one[0].ball_diameter_mm)
    shares: list[NDArray[np.float64]] = []
    results = [reconstruct.from_image(press.image) for press, _ in whole]
    for (first, second), ((one, from_px), (other, to_px)) in zip(pairwise(results), pairwise(whole)):
        start = np.eye(4)
        start[:2, 3] = travel = (to_px - from_px) * pitch
        distance = float(np.linalg.norm(travel))
        if one.ball_diameter_mm != other.ball_diameter_mm or distance < LEAST_MM:
            continue
        pose = motion_between(first, second, start=start).pose
        if pose is not None:
            center = np.array([*(from_px - middle) * pitch, first.peak_mm - one.ball_diameter_mm / 2])
            shares.append((moved(pose, center)[:2] - (to_px - middle) * pitch) / distance)
    return float(np.sqrt(np.mean(np.square(shares)))) if len(shares) >= LEAST_PAIRS else None


def _is_whole(circle: ContactCircle, shape: tuple[int, int]) -> bool:
    """Whether a circle lies inside an image (H, W), so that its center is sure."""
    x, y, radius = circle.circle_px
    return radius <= x <= shape[1] - 1 - radius and radius <= y <= shape[0] - 1 - radius
