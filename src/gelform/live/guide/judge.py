"""The content of an image during a guided calibration: nothing, a moving ball or a press; and the forecast of errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.calibration.candidates import Candidate, candidates_for, training_samples
from gelform.calibration.circles.find import ContactCircle, find_contact, scale_of, why_no_contact
from gelform.calibration.circles.prepare import BLUR_PX, USUAL_OFFSET, ColorChanges, find_contacts, prepare
from gelform.calibration.circles.samples import PreparedPress
from gelform.calibration.enough import enough
from gelform.calibration.presses.press_set import Presses
from gelform.calibration.report.learning import floor_and_slope
from gelform.errors import CalibrationError
from gelform.image.background.change import ChangeSettings
from gelform.result.metrics import score_slopes

LEAST_RADIUS_PX = 9.0  # px, radius of a contact, at 240 rows
DEEPEST = 0.87  # contact radius over ball radius: pressed in by half the radius
APART = 0.4  # of the contact radius: a smaller distance to an earlier press is the same place
OUTSIDE = 0.2  # of the contact radius: largest distance of its center beyond the border
TOUCHED, NOISE_FACTOR = 0.05, 1.6  # color change of a touch; multiple of the change by noise
TOUCHED_PART = 500  # a touch covers at least 1/500 of the image
STILL_LEVELS, STILL_NOISE = 1.0, 0.9  # largest change of a still block: gray levels, times noise
SMALL = 8  # px, width of such a block
MORE = 5  # presses that a forecast looks ahead
HELD_OUT_EVERY = 4  # every fourth press tests a fit to the others
SAMPLES = 400  # sampled pixels of a held-out press

Circle = tuple[float, float, float]


@dataclass(frozen=True)
class Look:
    """The content of an image.

    Attributes
    ----------
    circle : the contact (x, y, radius) in px, or None
    touched : whether anything touches the gel
    moving : whether it differs from the previous image
    reason : why this press is not accepted; "" if it is
    """

    circle: Circle | None
    touched: bool
    moving: bool
    reason: str


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

    def look(self, image: NDArray[Any], accepted: Sequence[Circle] = ()) -> Look:
        """Judge an image (H, W, 3), given the accepted presses."""
        moving = self._moves(image)
        try:
            change, _ = self._changes(image)
        except CalibrationError as refusal:
            return Look(None, True, moving, str(refusal))
        if _largest(change) < self._touched:
            return Look(None, False, moving, "")
        contact = find_contact(change)
        if why_no_contact(contact) is not None:
            return Look(
                None, True, moving, "No ball is clearly visible. Press it a little harder, straight down."
            )
        return Look(contact.circle_px, True, moving, self._reason(contact, accepted))

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


@dataclass(frozen=True)
class Forecast:
    """Mean angle between normals of presses that are held out.

    Attributes
    ----------
    presses : so many were there
    now_deg : expected of a calibration on them
    more_deg : expected with five more
    """

    presses: int
    now_deg: float
    more_deg: float


def forecast_of(presses: Presses) -> Forecast | None:
    """Fit the simplest color model on a half and on three quarters of the presses, and extrapolate.

    The law is error^2 = a + b / n, as in the report's learning curve; the final fit tries more models and refines
    the circles, so it is rather better than this.

    Parameters
    ----------
    presses : those accepted so far

    Returns
    -------
    Forecast or None
        None with fewer than six presses.
    """
    count = len(presses.presses)
    if not enough("forecast", count):
        return None
    prepared = prepare(presses)
    found = find_contacts(prepared)
    candidate = candidates_for("polynomial", count)[0]
    held_out = range(0, count, HELD_OUT_EVERY)
    rest = [k for k in range(count) if k not in held_out]
    sizes = [max(2, len(rest) // 2), len(rest)]
    errors = [_error_deg(candidate, rest[:size], held_out, prepared, found) for size in sizes]
    floor, slope = floor_and_slope(sizes, errors)
    return Forecast(
        count, float(np.sqrt(floor + slope / count)), float(np.sqrt(floor + slope / (count + MORE)))
    )


def _error_deg(
    candidate: Candidate,
    training: Sequence[int],
    tested: Sequence[int],
    prepared: Sequence[PreparedPress],
    found: Sequence[ContactCircle],
) -> float:
    model = candidate.fit(training_samples([prepared[k] for k in training], [found[k] for k in training]))
    degrees = []
    for k in tested:
        press, circle = prepared[k], found[k]
        rows, columns = press.pixels(circle, 1.0, SAMPLES)
        slopes = press.gradients(model, rows, columns)
        score = score_slopes(slopes, columns, rows, (circle.x_px, circle.y_px), press.ball_radius_px)
        degrees.append(score.normal_deg)
    return float(np.mean(degrees))
