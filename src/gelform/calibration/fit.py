"""calibrate: from presses of a ball to a Calibration, without a click; and how wrong it is about the ball's places."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from os import PathLike

import numpy as np

from gelform.arrays import Numbers
from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.locate import check_places, light_notes, locate
from gelform.calibration.coverage import SAMPLED
from gelform.calibration.held_out import measure_held_out
from gelform.calibration.inputs import ball_readings, check_inputs, input_notes, notes_of, surround_notes
from gelform.calibration.presses.folder import Presses, as_presses
from gelform.calibration.presses.press_set import Press
from gelform.calibration.report.record import report_of_run
from gelform.calibration.selection import candidates_for, fit, make_folds
from gelform.calibration.start import AUTO, start_from, starter_note, starter_start
from gelform.calibration_file import Calibration
from gelform.foundations.findings import Progress, no_progress
from gelform.motion.between import motion_between
from gelform.motion.surface import moved
from gelform.reconstruct import Reconstructor


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
    of_image = *surround_notes(presses), *light_notes(presses.background)
    located = replace(located, notes=(*of_image, *notes_of(balls), *untried, *located.notes))
    check_places(located)
    folds = make_folds(located, progress=progress)
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


def place_error_from_presses(
    calibration: Calibration, presses: Sequence[Press], contacts: Sequence[ContactCircle]
) -> float | None:
    """Root mean square error of a ball's center along an axis, over its displacement; None: too few pairs.

    Each press is compared with the next one of the same ball. Its center is found from the contact's slopes
    (`gelform.motion`) and from the circle in the image. Slopes are wrong by a little more at one place than at another, so
    the two differ by more, the farther the ball moved.
    """
    reconstruct, pitch = Reconstructor(calibration), calibration.known_mm_per_px
    middle = (np.array(calibration.image_shape[::-1]) - 1) / 2
    step = -(-len(presses) // SAMPLED)
    whole = [
        (press, np.array([circle.x_px, circle.y_px]))
        for press, circle in zip(presses[::step], contacts[::step])
        if circle.is_whole_in(calibration.image_shape)
    ]
    whole.sort(key=lambda one: one[0].ball_diameter_mm)
    shares: list[Numbers] = []
    results = [reconstruct.from_image(press.image) for press, _ in whole]
    for (first, second), ((one, from_px), (other, to_px)) in zip(pairwise(results), pairwise(whole)):
        start = np.eye(4)
        start[:2, 3] = travel = (to_px - from_px) * pitch
        distance = float(np.linalg.norm(travel))
        if one.ball_diameter_mm != other.ball_diameter_mm or distance < 1:
            continue  # in less than 1 mm the circles' own errors matter
        pose = motion_between(first, second, start=start).pose
        if pose is not None:
            center = np.array([*(from_px - middle) * pitch, first.peak_mm - one.ball_diameter_mm / 2])
            shares.append((moved(pose, center)[:2] - (to_px - middle) * pitch) / distance)
    return float(np.sqrt(np.mean(np.square(shares)))) if len(shares) >= 4 else None
