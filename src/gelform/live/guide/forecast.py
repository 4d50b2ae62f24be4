"""How good a calibration on the presses so far will be, and what more would bring: a learning curve in a second."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gelform.calibration.candidates import Candidate, candidates_for, training_samples
from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.prepare import find_contacts, prepare
from gelform.calibration.circles.samples import PreparedPress
from gelform.calibration.presses.press_set import Presses
from gelform.calibration.report.learning import floor_and_slope
from gelform.metrics import score_slopes

LEAST, HELD_OUT_EVERY, MORE = 6, 4, 5
SAMPLES = 400


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
    if count < LEAST:
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
