"""calibrate: presses of a ball in, a Calibration out, without a click."""

from __future__ import annotations

import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from os import PathLike

from gelform.calibration.candidates import candidates_for, candidates_from, start_from
from gelform.calibration.circles.edge import contact_radius_ratio
from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.locate import other_ball_note
from gelform.calibration.circles.prepare import find_contacts, prepare, prepared_by_offset
from gelform.calibration.circles.refine import Refined, refine
from gelform.calibration.circles.samples import PreparedPress
from gelform.calibration.coverage import coverage_notes
from gelform.calibration.fitted import fit_all, untouched_change
from gelform.calibration.held_out.folds import circle_sigmas, make_folds
from gelform.calibration.held_out.measure import measure_held_out, solved_by_place
from gelform.calibration.held_out.scores import HeldOutPresses, Selection, select
from gelform.calibration.held_out.sigma import share_seen
from gelform.calibration.inputs import check_inputs, input_notes, repeated_images
from gelform.calibration.presses.folder import Presses, as_presses
from gelform.calibration.report.record import report_of_run
from gelform.calibration_file import Calibration
from gelform.color_models import COLOR_MODELS, HierarchicalModel
from gelform.errors import CalibrationError, GelformError
from gelform.progress import Progress, no_progress

MIN_PRESSES = 3


def calibrate(
    presses: Presses | str | PathLike[str],
    *,
    color_model: str = "auto",
    start: Calibration | str | PathLike[str] | None = None,
    compare: bool = False,
    progress: Progress = no_progress,
) -> Calibration:
    """Calibrate a sensor from presses of a ball.

    Finds each contact circle, measures where the gel leaves the ball, deals the presses into folds to choose on presses that
    they have not seen how stiff the color model and its forward response are, and fits both on all presses.

    Parameters
    ----------
    presses : from `read_presses`, or what that reads without options
    color_model : "auto" or a name in `gelform.color_models.COLOR_MODELS`
    start : the calibration of another unit of the same sensor, of any color model, or its file
        What it learnt is kept where these presses say nothing else: five of them can do.
    compare : whether every color model is tried on the same folds, for the report's table; what is chosen stays the same
    progress : called with (done, total, what)

    Returns
    -------
    Calibration
        With `.report`: every circle, why presses were rejected, the candidates, the held-out errors.

    Raises
    ------
    CalibrationError
        Too few presses fit: the message says why each was rejected.
    ValueError, TypeError
        An unknown color model, a start that cannot be one, or no presses.
    """
    began = time.monotonic()
    presses = as_presses(presses, progress=progress)
    candidates_for(color_model, len(presses.presses))  # an unknown name fails before any work
    check_inputs(presses)
    first_unit = None if start is None else start_from(start, presses, color_model)
    model = None if first_unit is None else first_unit.model

    prepared = prepare(presses, progress=progress)
    found = find_contacts(prepared, progress=progress)
    excluded = repeated_images(presses)
    refined = refine(prepared, found, excluded=excluded, start=model, progress=progress)
    other_ball = other_ball_note(prepared, found, refined, excluded)
    prepared, refined = _within_edge(prepared, found, refined, excluded, model, progress)
    folds = make_folds(prepared, found, refined.accepted, start=model, progress=progress)
    _check_enough(presses, refined, len(folds), other_ball)

    accepted = len(refined.accepted)
    candidates = candidates_for(color_model, accepted) if first_unit is None else candidates_from(first_unit)
    offsets = {one.change_offset for one in candidates}
    if compare:
        offsets |= {float(one.change_offset) for one in COLOR_MODELS.values()}
    by_offset = prepared_by_offset(presses, prepared, offsets)
    untouched = {offset: untouched_change(*refined.of_accepted(own)) for offset, own in by_offset.items()}
    held_out = HeldOutPresses(by_offset, found, folds, untouched)
    selection = select(candidates, held_out, progress=progress)
    left_out: tuple[str, ...] = ()
    if compare:
        selection, left_out = _compared(selection, held_out, accepted, progress)

    offset = selection.chosen.change_offset
    draft = fit_all(presses, by_offset[offset], refined, selection.chosen, untouched[offset])
    measured = measure_held_out(draft, presses, held_out, selection, progress=progress)
    report = report_of_run(
        presses,
        refined,
        measured,
        circle_sigmas(prepared, found, folds, model),
        selection,
        notes=(
            *(() if other_ball is None else (other_ball,)),
            *left_out,
            *input_notes(presses, prepared, refined),
        ),
        seconds=time.monotonic() - began,
        start=first_unit,
    )
    forward = (
        None if draft.forward is None else replace(draft.forward, residual_scale=measured.residual_scale)
    )
    draft = replace(
        draft, slope_sigma=measured.slope_sigma, held_out=report.held_out, report=report, forward=forward
    )
    sigma = solved_by_place(draft, measured.slope_sigma, presses, measured.samples, share_seen(folds))
    return replace(draft, slope_sigma=sigma)


def _within_edge(
    prepared: list[PreparedPress],
    found: Sequence[ContactCircle],
    refined: Refined,
    excluded: Mapping[int, str],
    start: HierarchicalModel | None,
    progress: Progress,
) -> tuple[list[PreparedPress], Refined]:
    """The presses with the measured edge of their contacts, and their circles, refined inside it."""
    ratio = contact_radius_ratio(*refined.of_accepted(prepared))
    if ratio == prepared[0].contact_radius_ratio:
        return prepared, refined
    prepared = [replace(press, contact_radius_ratio=ratio) for press in prepared]
    return prepared, refine(prepared, found, excluded=excluded, start=start, progress=progress)


def _compared(
    selection: Selection, held_out: HeldOutPresses, presses: int, progress: Progress
) -> tuple[Selection, tuple[str, ...]]:
    """The selection with the trials of every color model beside its own, and which could not be tried."""
    trials = {trial.candidate: trial for trial in selection.trials}
    left_out: list[str] = []
    for name in COLOR_MODELS:
        try:
            others = select(candidates_for(name, presses), held_out, progress=progress).trials
        except GelformError as problem:  # its extra is not installed, or the presses are not enough for it
            left_out.append(f"{name} was not compared: {problem}")
            continue
        trials |= {trial.candidate: trial for trial in others if trial.candidate not in trials}
    return replace(selection, trials=tuple(trials.values())), tuple(left_out)


def _check_enough(presses: Presses, refined: Refined, folds: int, other_ball: str | None) -> None:
    if folds >= MIN_PRESSES:
        return
    if len(refined.accepted) >= MIN_PRESSES:
        raise CalibrationError(
            f"Expected presses at {MIN_PRESSES} places or more, got {folds} among the {len(refined.accepted)} of "
            f"{presses.folder} that fit: the others show the same press. Press the ball at many places, one image each."
        )
    rejected = [(row.name, why) for row, why in zip(presses.presses, refined.reasons) if why is not None]
    kinds: dict[str, list[str]] = {}
    for name, why in rejected:  # alike but for figures, reasons are counted together
        kinds.setdefault(re.sub(r"\d[\d.]*", "", why), []).append(f"{name}: {why}")
    most = sorted(kinds.values(), key=len, reverse=True)[:4]
    remedy = f"{other_ball} " if other_ball else ""
    listed = "; ".join(f"{len(one)} like {one[0]}" for one in most)
    raise CalibrationError(
        f"Expected at least {MIN_PRESSES} presses of a ball that fit, got {len(refined.accepted)} of "
        f"{len(presses.presses)} in {presses.folder}. Rejected: {listed or 'none'}. "
        f"{remedy}Press a ball of known diameter firmly at many places, one image each, best not deeper than half its "
        "radius. "
        + " ".join(
            coverage_notes([refined.contacts[i].circle_px for i in refined.accepted], presses.image_shape)
        )
    )
