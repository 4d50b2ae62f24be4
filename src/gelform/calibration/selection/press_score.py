"""How far off a color model is on one press: the depth that it integrates to, and the normals of that depth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gelform.ball import ball_center
from gelform.calibration.circles.find import ContactCircle, scale_of
from gelform.calibration.circles.samples import PreparedPress
from gelform.color_models import ColorModel
from gelform.depth import depth_from_gradients
from gelform.gradients import gradients_from_depth
from gelform.metrics import angle_deg

INSET_PX = 3.0  # of the contact's rim, at 240 rows: as `metrics.press_errors` has it
PATCH = 24  # samples across the contact, whose slopes are integrated


@dataclass(frozen=True)
class PressScore:
    """Errors on one press, both with a free centre, since labels are off by a pixel.

    Attributes
    ----------
    normal_deg : mean angle between the normals of the depth and the ball's, degrees
    cap_px : standard deviation of the depth minus the ball's cap, px
    """

    normal_deg: float
    cap_px: float


class Lattice(NamedTuple):
    """Every step-th pixel of a contact's box and a step around it.

    Attributes
    ----------
    inside : (h, w) bool, whether it is scored
    x, y : (h, w), its column and row
    step : px
    """

    inside: NDArray[np.bool_]
    x: NDArray[np.intp]
    y: NDArray[np.intp]
    step: int


def press_score(
    press: PreparedPress, found: ContactCircle, model: ColorModel, lattice: Lattice | None = None
) -> PressScore:
    """Errors of a model inside a contact circle, 3 px off its rim.

    The slopes on a lattice over the contact's box, `lattice_of(press, found)`, are integrated, as a frame's are. Both the
    depth and the ball's cap are differenced on that lattice, so what its steps leave out cancels.
    """
    inside, x, y, step = lattice_of(press, found) if lattice is None else lattice
    gradients = press.gradients(model, y.ravel(), x.ravel()).reshape(*y.shape, 2)
    depth = depth_from_gradients(gradients.astype(np.float32), mm_per_px=float(step), solver="dct")
    slopes = gradients_from_depth(depth, mm_per_px=float(step))
    start = found.x_px, found.y_px
    center = ball_center(slopes[inside], x[inside], y[inside], start, press.ball_radius_px)
    square = (x - center[0]) ** 2 + (y - center[1]) ** 2
    cap = np.sqrt(np.maximum(press.ball_radius_px**2 - square, 0))
    truth = gradients_from_depth(cap, mm_per_px=float(step))
    normal_deg = float(angle_deg(slopes[inside], truth[inside]).mean())
    return PressScore(normal_deg, float(np.std((depth - cap)[inside])))


def lattice_of(press: PreparedPress, found: ContactCircle) -> Lattice:
    """Where a press is scored: the same for every model."""
    radius = press.followed * found.radius_px
    zone = max(0.5, 1 - INSET_PX * scale_of(press.size.shape) / radius)
    step = max(1, round(2 * zone * radius / PATCH))
    scored = np.zeros(press.size.shape, dtype=bool)
    rows, cols = press.pixels(found, zone)
    scored[rows, cols] = True
    (top, bottom), (left, right) = ((max(at.min() - step, 0), at.max() + step + 1) for at in (rows, cols))
    inside = scored[top:bottom:step, left:right:step]
    y, x = np.mgrid[: inside.shape[0], : inside.shape[1]] * step
    return Lattice(inside, x + left, y + top, step)
