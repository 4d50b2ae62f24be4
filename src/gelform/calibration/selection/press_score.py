"""How far off a color model is on one press: its normals, and the shape of the cap that they integrate to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.circles.find import ContactCircle, scale_of
from gelform.calibration.circles.samples import PreparedPress
from gelform.color_models import ColorModel
from gelform.depth import depth_from_gradients
from gelform.metrics import score_slopes

INSET_PX = 3.0  # of the contact's rim, at 240 rows: as `metrics.press_errors` has it
SCORED_PIXELS = 500
PATCH = 24  # samples across the contact that are integrated to score the depth


@dataclass(frozen=True)
class PressScore:
    """Errors on one press, both with a free centre, since labels are off by a pixel.

    Attributes
    ----------
    normal_deg : mean angle to the ball's normals, degrees
    cap_px : standard deviation of the depth minus the ball's cap, px
    """

    normal_deg: float
    cap_px: float


def press_score(press: PreparedPress, found: ContactCircle, model: ColorModel) -> PressScore:
    """Errors of a model inside a contact circle, 3 px off its rim."""
    zone = max(0.5, 1 - INSET_PX * scale_of(press.size.shape) / found.radius_px)
    rows, cols = press.pixels(found, zone, SCORED_PIXELS)
    gradients = press.gradients(model, rows, cols)
    score = score_slopes(gradients, cols, rows, (found.x_px, found.y_px), press.ball_radius_px)
    return PressScore(score.normal_deg, _cap_error_px(press, found, model, score.center_px, rows, cols, zone))


def _cap_error_px(
    press: PreparedPress,
    found: ContactCircle,
    model: ColorModel,
    center: tuple[float, float],
    rows: NDArray[np.intp],
    cols: NDArray[np.intp],
    zone: float,
) -> float:
    """Standard deviation of the depth, integrated over the contact's bounding box, minus the ball's cap."""
    step = max(1, round(2 * zone * found.radius_px / PATCH))
    y, x = np.mgrid[rows.min() : rows.max() + 1 : step, cols.min() : cols.max() + 1 : step]
    gradients = press.gradients(model, y.ravel(), x.ravel()).reshape(*y.shape, 2)
    depth = depth_from_gradients(gradients.astype(np.float32), mm_per_px=float(step), solver="dct")
    square = (x - center[0]) ** 2 + (y - center[1]) ** 2
    inside = (x - found.x_px) ** 2 + (y - found.y_px) ** 2 < (zone * found.radius_px) ** 2
    cap = np.sqrt(np.maximum(press.ball_radius_px**2 - square, 0))
    return float(np.std((depth - cap)[inside]))
