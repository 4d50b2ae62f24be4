"""The content of an image during a guided calibration: nothing, a moving ball or a press."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.calibration.circles.find import (
    ContactCircle,
    about_median,
    find_contact,
    magnitude,
    marked_contact,
    scale_of,
    why_no_contact,
)
from gelform.calibration.circles.prepare import BLUR_PX, USUAL_OFFSET, ColorChanges
from gelform.errors import CalibrationError
from gelform.image.background.change import ChangeSettings

LEAST_RADIUS_PX = 9.0  # px, radius of a contact, at 240 rows
DEEPEST = 0.87  # contact radius over ball radius: pressed in by half the radius
APART = 0.4  # of the contact radius: a smaller distance to an earlier press is the same place
OUTSIDE = 0.2  # of the contact radius: largest distance of its center beyond the border
TOUCHED, NOISE_FACTOR = 0.05, 1.6  # color change of a touch; multiple of the change by noise
TOUCHED_PART = 500  # a touch covers at least 1/500 of the image
STILL_LEVELS, STILL_NOISE = 1.0, 0.9  # largest change of a still block: gray levels, times noise
SMALL = 8  # px, width of such a block

Circle = tuple[float, float, float]


@dataclass(frozen=True)
class Look:
    """The content of an image.

    Attributes
    ----------
    circle : the contact (x, y, radius) in px, or None
    touched : whether anything touches the gel
    marked : whether the circle's center is the one that was clicked
    moving : whether it differs from the previous image
    reason : why this press is not accepted; "" if it is
    """

    circle: Circle | None
    touched: bool
    moving: bool
    reason: str
    marked: bool = False


class Judge:
    """Analyzes the images of one sensor in sequence.

    Parameters
    ----------
    background : (H, W, 3) float32, the background image
    untouched : (H, W, 3) uint8, one frame at rest, which shows how much noise changes the colors
    noise : standard deviation of a pixel in one frame, gray levels
    ball_radius_px : of the ball that presses
    """

    def __init__(
        self,
        background: NDArray[np.float32],
        untouched: NDArray[np.uint8],
        noise: float,
        ball_radius_px: float,
    ) -> None:
        self._shape = background.shape[:2]
        self._scale = scale_of((self._shape[0], self._shape[1]))
        settings = ChangeSettings("divide", USUAL_OFFSET, BLUR_PX * self._scale)
        self._changes = ColorChanges(background, settings)
        self._still = STILL_LEVELS + STILL_NOISE * noise
        self._ball_px = ball_radius_px
        self._before: NDArray[np.float32] | None = None
        self._touched = max(TOUCHED, NOISE_FACTOR * _largest(self._changes(untouched)[0]))

    def look(
        self,
        image: NDArray[Any],
        accepted: Sequence[Circle] = (),
        clicked: tuple[float, float] | None = None,
    ) -> Look:
        """Judge an image (H, W, 3), given the accepted presses, and the center (x, y) that was clicked or None."""
        moving = self._moves(image)
        try:
            change, _ = self._changes(image)
        except CalibrationError as refusal:
            return Look(None, True, moving, str(refusal))
        if _largest(change) < self._touched:
            return Look(None, False, moving, "")
        contact = find_contact(change)
        if clicked is not None:
            size = magnitude(about_median(change))
            contact = marked_contact(contact, size, *clicked, None)
        if why_no_contact(contact) is not None:
            return Look(
                None,
                True,
                moving,
                "No ball is clearly visible. Press it a little harder, straight down. Or click the middle of its imprint.",
            )
        return Look(contact.circle_px, True, moving, self._reason(contact, accepted), contact.marked)

    def _moves(self, image: NDArray[Any]) -> bool:
        height, width = self._shape
        small = cv2.resize(image, (width // SMALL, height // SMALL), interpolation=cv2.INTER_AREA)
        small = small.astype(np.float32)
        before, self._before = self._before, small
        return before is None or float(np.abs(small - before).max()) > self._still

    def _reason(self, contact: ContactCircle, accepted: Sequence[Circle]) -> str:
        x, y, radius = contact.circle_px
        (height, width), by = self._shape, OUTSIDE * radius
        if not (-by < x < width + by and -by < y < height + by):
            return "The press is too far outside. Press at the circle."
        if radius < LEAST_RADIUS_PX * self._scale:
            return "The press is too light. Press a little harder."
        if radius > DEEPEST * self._ball_px:
            return "The press is too deep, or the ball has another size. Press at most half the ball's radius deep."
        if any(np.hypot(x - ax, y - ay) < APART * max(radius, ar) for ax, ay, ar in accepted):
            return "You pressed here before. Press at the circle."
        return ""


def _largest(change: NDArray[np.float32]) -> float:
    """The size that a five-hundredth of a color change's pixels exceed."""
    size = np.abs(change).max(axis=-1)
    rank = size.size - size.size // TOUCHED_PART - 1
    return float(np.partition(size, rank, axis=None)[rank])
