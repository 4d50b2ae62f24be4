"""calibrate: from presses of a ball to a Calibration, without a click."""

from __future__ import annotations

import time
from dataclasses import replace
from os import PathLike

from gelform.calibration.balls import ball_readings, notes_of
from gelform.calibration.candidates import AUTO, candidates_for, start_from, starter_note, starter_start
from gelform.calibration.circles.locate import check_places, locate
from gelform.calibration.fitted import fit
from gelform.calibration.held_out.folds import make_folds
from gelform.calibration.held_out.measure import measure_held_out
from gelform.calibration.inputs import check_inputs, input_notes, surround_notes
from gelform.calibration.place import place_error_from_presses
from gelform.calibration.presses.folder import Presses, as_presses
from gelform.calibration.report.record import report_of_run
from gelform.calibration_file import Calibration
from gelform.foundations.progress import Progress, no_progress


def calibrate(
    presses: Presses | str | PathLike[str],
    *,
    color_model: str = "auto",
    start: Calibration | str | PathLike[str] | None = AUTO,
    compare: bool = False,
    progress: Progress = no_progress,
) -> Calibration:
    """Calibrate a sensor from presses of a ball.

    It finds each contact circle, and measures the contact edge, where the gel leaves the ball. It splits the presses into
    folds, and selects the stiffness of the color model and its forward response on held-out presses. Then it fits both on
    all presses.

    Parameters
    ----------
    presses : from `read_presses`, or a path that it reads without options
    color_model : "auto" or a name in `gelform.slopes.color_models.COLOR_MODELS`
    start : "auto", None, or the calibration of another unit of the same sensor, of any color model, or its file
        Its model is kept where these presses give no other information, so five presses suffice. "auto" also tries the
        starter of a known make, and keeps it if held-out presses are not read worse; None tries none.
    compare : whether every color model is tried on the same folds, for the report's table; the selection stays the same
    progress : called with (done, total, what)

    Returns
    -------
    Calibration
        With `.report`: every circle, the reasons for rejected presses, the candidates, the held-out errors.

    Raises
    ------
    CalibrationError
        Too few presses fit; the message has the reason for each rejected one.
    ValueError, TypeError
        An unknown color model, a start that cannot be one, or no presses.
    """
    began = time.monotonic()
    presses = as_presses(presses, progress=progress)
    candidates_for(color_model, len(presses.presses))  # an unknown name fails before any work
    check_inputs(presses)
    untried: tuple[str, ...] = ()
    if start is None or start == AUTO:
        known = starter_start(presses, color_model)
        first_unit = known if start == AUTO and known is not None and known.offered else None
        untried = starter_note(presses, color_model) if start == AUTO else ()
    else:
        first_unit = known = start_from(start, presses, color_model)

    located = locate(presses, first_unit, progress=progress)
    balls = ball_readings(located, known)
    located = replace(located, notes=(*surround_notes(presses), *notes_of(balls), *untried, *located.notes))
    check_places(located)
    folds = make_folds(
        located.prepared, located.found, located.refined.accepted, start=located.refined_by, progress=progress
    )
    fitted = fit(located, folds, color_model, compare=compare, progress=progress)
    judged = measure_held_out(fitted, progress=progress)
    notes = input_notes(located)
    made = replace(fitted.calibration, slope_sigma=judged.slope_sigma, forward=judged.forward)
    own = [presses.presses[i] for i in located.refined.accepted]
    circles = [located.refined.contacts[i] for i in located.refined.accepted]
    place_error = place_error_from_presses(made, own, circles)
    report = report_of_run(fitted, judged, balls, notes=notes, seconds=time.monotonic() - began)
    return replace(
        made,
        settings=replace(made.settings, place_error=place_error),
        held_out=report.held_out,
        report=report,
    )
