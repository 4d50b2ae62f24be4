"""calibrate: presses of a ball in, a Calibration out, without a click."""

from __future__ import annotations

import re
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from os import PathLike

from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.followed import followed_share
from gelform.calibration.circles.prepare import find_contacts, prepare, prepared_by_offset
from gelform.calibration.circles.refine import Refined, refine
from gelform.calibration.circles.samples import PreparedPress
from gelform.calibration.circles.settle import settled
from gelform.calibration.circles.sigma import circle_sigmas
from gelform.calibration.coverage import coverage_notes
from gelform.calibration.draft import fit_all
from gelform.calibration.heights import judged_by_heights
from gelform.calibration.inputs import check_inputs, input_notes, repeated_images
from gelform.calibration.presses.folder import Presses, as_presses
from gelform.calibration.report.held_out import measure_held_out
from gelform.calibration.report.record import report_of_run
from gelform.calibration.report.solved import solved_by_place
from gelform.calibration.selection.by_lights import judged_by_lights
from gelform.calibration.selection.candidates import (
    AUTO,
    ZONES,
    Candidate,
    Start,
    candidates_for,
    candidates_from,
)
from gelform.calibration.selection.folds import Fold, make_folds, size_folds, unlike_the_others
from gelform.calibration.selection.select import select
from gelform.calibration.selection.slope_errors import share_seen
from gelform.calibration.selection.trials import HeldOutPresses
from gelform.calibration.start import start_from
from gelform.calibration.unlabelled import surround_sigma
from gelform.calibration_file import Calibration
from gelform.color_models import ColorModel, DepthAwareModel, DepthByLightsModel, HierarchicalModel
from gelform.errors import CalibrationError
from gelform.progress import Progress, no_progress

MIN_PRESSES = 3


def calibrate(
    presses: Presses | str | PathLike[str],
    *,
    color_model: str = "auto",
    start: Calibration | str | PathLike[str] | None = None,
    progress: Progress = no_progress,
) -> Calibration:
    """Calibrate a sensor from presses of a ball.

    Finds each contact circle, deals the presses into folds to choose the color model and its training zone on
    presses that it has not seen, and fits the chosen one on all of them.

    Parameters
    ----------
    presses : from `read_presses`, or what that reads without options
    color_model : "auto" or a name in `gelform.color_models.COLOR_MODELS`
    start : the calibration of another unit of the same sensor, of any color model, or its file
        What it learnt is kept where these presses say nothing else: five of them can do.
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
    prepared, refined, folds = _refined_and_folded(prepared, found, repeated_images(presses), model, progress)
    _check_enough(presses, refined, len(folds))

    sizes = size_folds(prepared, found, refined.accepted, start=model, progress=progress)
    if first_unit is None:
        refined, folds, sizes = _settled(prepared, found, refined, folds, sizes)
    candidates, zones = _candidates(color_model, len(folds[0].training), first_unit)
    by_offset = prepared_by_offset(presses, prepared, (c.change_offset for c in candidates))
    able = _able(candidates, by_offset.keys())
    held_out = HeldOutPresses(by_offset, found, folds, sizes)
    selection = select(able, held_out, zones=zones, progress=progress)
    selection, judged = judged_by_heights(
        presses, by_offset, refined, selection, held_out, named=color_model != AUTO
    )
    if color_model == AUTO:
        selection, lit = judged_by_lights(by_offset, refined, selection, held_out)
        judged = (*judged, *lit)

    draft = fit_all(presses, by_offset[selection.chosen.change_offset], refined, selection.chosen)
    measured = measure_held_out(draft, presses, held_out, selection, progress=progress)
    report = report_of_run(
        presses,
        refined,
        measured,
        circle_sigmas(prepared, found, folds, model),
        selection,
        notes=(
            *_left_out(candidates, able),
            *judged,
            *input_notes(presses, prepared, refined, measured.samples),
        ),
        seconds=time.monotonic() - began,
        start=first_unit,
    )
    forward = None if draft.forward is None else replace(draft.forward, held_out_noise=measured.forward_noise)
    sigma = replace(
        measured.slope_sigma,
        steepest=None if draft.slope_sigma is None else draft.slope_sigma.steepest,
        surround_sigma=_surround_sigma(by_offset, refined, selection.chosen.zone, draft.color_model),
    )
    draft = replace(draft, slope_sigma=sigma, held_out=report.held_out, report=report, forward=forward)
    sigma = solved_by_place(draft, sigma, presses, measured.samples, share_seen(folds))
    return replace(draft, slope_sigma=sigma)


def _surround_sigma(
    by_offset: Mapping[float, Sequence[PreparedPress]], refined: Refined, zone: float, model: ColorModel
) -> float:
    """Of the accepted presses; 0 where the background has pixels of 0, by which nothing can be divided."""
    prepared = by_offset.get(DepthAwareModel.change_offset)
    if prepared is None:
        return 0.0
    return surround_sigma(
        *refined.of_accepted(prepared), zone, model if isinstance(model, DepthByLightsModel) else None
    )


def _refined_and_folded(
    prepared: list[PreparedPress],
    found: Sequence[ContactCircle],
    excluded: dict[int, str],
    start: HierarchicalModel | None,
    progress: Progress,
) -> tuple[list[PreparedPress], Refined, list[Fold]]:
    """The presses with how far they follow the ball, circles of those that fit, and the folds.

    What the folds contradict is left out of circles and folds.
    """
    refined = refine(prepared, found, excluded=excluded, start=start, progress=progress)
    used = refined.accepted
    share = followed_share([prepared[i] for i in used], [refined.contacts[i] for i in used])
    if share < 1:
        prepared = [replace(press, followed=share) for press in prepared]
        refined = refine(prepared, found, excluded=excluded, start=start, progress=progress)
    folds = make_folds(prepared, found, refined.accepted, start=start, progress=progress)
    odd = unlike_the_others(prepared, found, folds, start=start)
    if odd:
        refined = refine(prepared, found, excluded={**excluded, **odd}, start=start, progress=progress)
        folds = make_folds(prepared, found, refined.accepted, start=start, progress=progress)
    return prepared, refined, folds


def _settled(
    prepared: Sequence[PreparedPress],
    found: Sequence[ContactCircle],
    refined: Refined,
    folds: Sequence[Fold],
    sizes: Sequence[Fold],
) -> tuple[Refined, list[Fold], list[Fold]]:
    """The same with the last moves of all circles that train, each fold's by its own presses."""

    def of(indices: Sequence[int], contacts: Sequence[ContactCircle]) -> tuple[ContactCircle, ...]:
        return settled([prepared[i] for i in indices], contacts, [found[i] for i in indices])

    contacts, used = list(refined.contacts), refined.accepted
    for i, contact in zip(used, of(used, [contacts[i] for i in used])):
        contacts[i] = contact
    dealt, by_size = (
        [replace(fold, contacts=of(fold.training, fold.contacts)) for fold in part] for part in (folds, sizes)
    )
    return replace(refined, contacts=tuple(contacts)), dealt, by_size


def _check_enough(presses: Presses, refined: Refined, folds: int) -> None:
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
    listed = "; ".join(f"{len(one)} like {one[0]}" for one in most)
    raise CalibrationError(
        f"Expected at least {MIN_PRESSES} presses of a ball that fit, got {len(refined.accepted)} of "
        f"{len(presses.presses)} in {presses.folder}. Rejected: {listed or 'none'}. "
        "Press a ball of known diameter firmly at many places, one image each, best not deeper than half its radius. "
        + " ".join(
            coverage_notes([refined.contacts[i].circle_px for i in refined.accepted], presses.image_shape)
        )
    )


def _candidates(
    color_model: str, training: int, start: Start | None
) -> tuple[list[Candidate], Sequence[float]]:
    """What is tried, simplest first, and the training zones to choose among."""
    if start is None:
        return candidates_for(color_model, training), ZONES
    return candidates_from(start), (start.zone,)


def _able(candidates: Sequence[Candidate], offsets: Collection[float]) -> list[Candidate]:
    """The candidates that can work with this background."""
    able = [c for c in candidates if c.change_offset in offsets]
    if not able:
        raise CalibrationError(
            f"The color model {candidates[0].model} divides by the background, which has pixels of 0. "
            "Raise the exposure, or calibrate with --model polynomial."
        )
    return able


def _left_out(candidates: Sequence[Candidate], able: Sequence[Candidate]) -> list[str]:
    return [
        f"{c.model} was left out: it divides by the background, which has pixels of 0."
        for c in candidates
        if c not in able
    ]
