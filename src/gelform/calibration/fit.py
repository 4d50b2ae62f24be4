"""calibrate: presses of a ball in, a Calibration out, without a click."""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, replace
from datetime import datetime, timezone

import numpy as np

from gelform import __version__
from gelform.background.average import noise_from_image
from gelform.background.change import ChangeSettings, PreparedBackground
from gelform.background.check import check_background_of_frames
from gelform.ball import ball_center
from gelform.calibration.circles.find import Contact, find_contact, magnitude, scale_of
from gelform.calibration.circles.markers import change_without_markers
from gelform.calibration.circles.refine import Refined, refine
from gelform.calibration.circles.samples import PreparedPress
from gelform.calibration.circles.sigma import circle_sigmas
from gelform.calibration.coverage import coverage_notes
from gelform.calibration.evaluate import errors_of
from gelform.calibration.forward import forward_from_presses, image_noise
from gelform.calibration.inputs import check_inputs, input_notes
from gelform.calibration.presses.folder import Presses
from gelform.calibration.report.held_out import HeldOutSample, held_out_sample
from gelform.calibration.report.record import CalibrationReport, PressReport, summary
from gelform.calibration.selection.candidates import (
    DEFAULT_ZONE,
    ZONES,
    Candidate,
    Start,
    candidates_for,
    candidates_from,
)
from gelform.calibration.selection.folds import Fold, make_folds, size_folds, unlike_the_others
from gelform.calibration.selection.select import Selection, select, standard_error
from gelform.calibration.selection.slope_errors import slope_sigma_from_folds
from gelform.calibration.selection.trials import HeldOutPresses
from gelform.calibration_file import Calibration
from gelform.color_models import COLOR_MODELS, ColorModel, HierarchicalModel
from gelform.color_models._shared.gamut import Gamut
from gelform.confidence import SlopeSigma
from gelform.errors import CalibrationError
from gelform.markers import MarkerFinder
from gelform.metrics import PressErrors
from gelform.progress import Progress, no_progress
from gelform.reconstruct import Reconstructor

BLUR_PX = 1.25
MIN_PRESSES = 3
UNTOUCHED_PERCENTILE = 99.0
FIRST_GUESS = SlopeSigma(rest=0.02, slopes=(0.0, 0.5), sigmas=(0.02, 0.06), clean=0.04, correlation_px=10.0)


def calibrate(
    presses: Presses,
    *,
    color_model: str = "auto",
    start: Calibration | None = None,
    progress: Progress = no_progress,
) -> Calibration:
    """Calibrate a sensor from presses of a ball.

    Finds each contact circle, deals the presses into folds to choose the color model and its training zone on
    presses that it has not seen, and fits the chosen one on all of them.

    Parameters
    ----------
    presses : from `read_presses`
    color_model : "auto" or a name in `gelform.color_models.COLOR_MODELS`
    start : the calibration of another unit of the same sensor, color model `hierarchical`
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
    ValueError
        An unknown color model, or a start that cannot be one.
    """
    started = time.monotonic()
    candidates_for(color_model, len(presses.presses))  # an unknown name fails before any work
    check_inputs(presses)
    prepared = prepare(presses, COLOR_MODELS["polynomial"].change_offset, progress=progress)
    found = [find_contact_of(press, progress, i, len(prepared)) for i, press in enumerate(prepared)]
    begin = None if start is None else start_from(start, presses, color_model)
    refined, folds = _refined_and_folded(prepared, found, begin, progress)
    _check_enough(presses, refined)
    zones: Sequence[float] = ZONES
    candidates = candidates_for(color_model, len(folds[0].training))
    if start is not None and begin is not None:
        zones = (start.settings.get("zone", DEFAULT_ZONE),)
        candidates = candidates_from(begin, zones[0])
    by_offset = _by_offset(presses, prepared, candidates)
    first = None if begin is None else begin.model
    sizes = size_folds(prepared, found, refined.accepted, start=first, progress=progress)
    able = _able(candidates, by_offset)
    held_out = HeldOutPresses(by_offset, found, folds, sizes)
    selection = select(able, held_out, zones=zones, progress=progress)
    draft = _draft(presses, by_offset[selection.chosen.change_offset], refined, selection.chosen)
    errors, sigma, samples = _held_out(draft, presses, by_offset, found, folds, selection, progress)
    left_out = tuple(c.model for c in candidates if c not in able)
    sigmas = circle_sigmas(prepared, found, folds, None if begin is None else begin.model)
    report = _report(presses, refined, errors, sigmas, selection, left_out, time.monotonic() - started)
    used = refined.accepted
    notes = input_notes(presses, [prepared[i] for i in used], [refined.contacts[i] for i in used])
    report = replace(report, notes=(*report.notes, *notes), samples=tuple(samples))
    return replace(draft, slope_sigma=sigma, held_out=report.held_out, report=report)


def prepare(presses: Presses, offset: float, *, progress: Progress = no_progress) -> list[PreparedPress]:
    """Color changes of all presses, checked against the background."""
    rest = PreparedBackground(presses.background, change_settings(presses, offset))
    finder = MarkerFinder(presses.background)
    prepared = []
    for done, press in enumerate(presses.presses):
        try:
            exposure, _ = rest.compare(press.image)
        except CalibrationError as problem:
            raise CalibrationError(f"{press.name}: {problem}") from None
        change, usable = change_without_markers(press.image, rest, exposure, finder)
        size = magnitude(change - np.median(change, axis=(0, 1)).astype(np.float32))
        radius_px = press.ball_diameter_mm / 2 / presses.mm_per_px
        prepared.append(PreparedPress(press.name, change, size, radius_px, usable, presses.background))
        progress(done + 1, len(presses.presses), "preparing")
    check_background_of_frames([press.image for press in presses.presses], presses.background)
    return prepared


def change_settings(presses: Presses, offset: float) -> ChangeSettings:
    """Division by the background, blurred by 1.25 px at 240 rows; known response and crosstalk undone."""
    blur_px = BLUR_PX * scale_of(presses.image_shape)
    return ChangeSettings("divide", offset, blur_px, presses.geometry.matrix, presses.response)


def find_contact_of(press: PreparedPress, progress: Progress, index: int, count: int) -> Contact:
    """`find_contact`, reported."""
    contact = find_contact(press.color_change)
    progress(index + 1, count, "finding contact circles")
    return contact


def start_from(start: Calibration, presses: Presses, color_model: str) -> Start:
    """What a first unit's calibration gives a second one to begin with.

    Raises
    ------
    ValueError
        Its color model is none that can be started from, or its images are of another size.
    """
    model = start.color_model
    if not isinstance(model, HierarchicalModel) or color_model not in ("auto", "hierarchical"):
        wanted = color_model if isinstance(model, HierarchicalModel) else model.name
        raise ValueError(
            f"Expected a start with the color model hierarchical, which can be drawn to another, got {wanted}. "
            "Calibrate the first unit with --model hierarchical."
        )
    model.check_like(model.degree, presses.image_shape)
    return Start(model, start.digest)


def _refined_and_folded(
    prepared: list[PreparedPress], found: Sequence[Contact], begin: Start | None, progress: Progress
) -> tuple[Refined, list[Fold]]:
    """Circles of the presses that fit, and the folds; what the folds contradict is left out of both."""
    model = None if begin is None else begin.model
    refined = refine(prepared, found, start=model, progress=progress)
    folds = make_folds(prepared, found, refined.accepted, start=model, progress=progress)
    odd = unlike_the_others(prepared, found, folds, start=model)
    if odd:
        refined = refine(prepared, found, excluded=odd, start=model, progress=progress)
        folds = make_folds(prepared, found, refined.accepted, start=model, progress=progress)
    return refined, folds


def _check_enough(presses: Presses, refined: Refined) -> None:
    if len(refined.accepted) >= MIN_PRESSES:
        return
    figures = r" ?\(?\d[\d.]*( px)?\)?"  # alike but for these, reasons are counted together
    heads = [reason.split(":")[0] for reason in refined.reasons if reason is not None]
    reasons = Counter(re.sub(figures, "", head) for head in heads)
    listed = "; ".join(f"{count} x {reason}" for reason, count in reasons.most_common(4))
    raise CalibrationError(
        f"Expected at least {MIN_PRESSES} presses of a ball that fit, got {len(refined.accepted)} of "
        f"{len(presses.presses)} in {presses.folder}. Rejected: {listed or 'none'}. "
        "Press a ball of known diameter firmly at many places, one image each, not deeper than half its radius. "
        + " ".join(
            coverage_notes([refined.contacts[i].circle_px for i in refined.accepted], presses.image_shape)
        )
    )


def _by_offset(
    presses: Presses, prepared: list[PreparedPress], candidates: Sequence[Candidate]
) -> dict[float, list[PreparedPress]]:
    """The presses as each candidate wants them, by the offset of its division, prepared once each.

    A candidate that divides by the bare background is left out where the background has pixels of 0.
    """
    by_offset = {COLOR_MODELS["polynomial"].change_offset: prepared}
    for offset in {c.change_offset for c in candidates} - by_offset.keys():
        if offset > 0 or float(presses.background.min()) > 0:
            by_offset[offset] = prepare(presses, offset)
    return by_offset


def _able(candidates: Sequence[Candidate], by_offset: dict[float, list[PreparedPress]]) -> list[Candidate]:
    """The candidates that can work with this background."""
    able = [c for c in candidates if c.change_offset in by_offset]
    if not able:
        raise CalibrationError(
            f"The color model {candidates[0].model} divides by the background, which has pixels of 0. "
            "Raise the exposure, or calibrate with --model polynomial."
        )
    return able


def _draft(
    presses: Presses, prepared: list[PreparedPress], refined: Refined, chosen: Candidate
) -> Calibration:
    """The calibration fitted on every accepted press; held-out figures are filled in later."""
    used = [prepared[i] for i in refined.accepted]
    contacts = [refined.contacts[i] for i in refined.accepted]
    samples = chosen.samples(used, contacts)
    return Calibration(
        sensor_name=presses.sensor_name,
        serial=presses.serial,
        gel_id=presses.gel_id,
        view=presses.view,
        image_shape=presses.image_shape,
        mm_per_px=presses.mm_per_px,
        mm_per_px_sigma=presses.mm_per_px_sigma,
        background=presses.background,
        background_noise=noise_from_image(presses.background)
        if presses.background_noise is None
        else presses.background_noise,
        change=change_settings(presses, chosen.change_offset),
        color_model=chosen.fit(used, contacts),
        forward=forward_from_presses(used, contacts, chosen.zone, presses.mm_per_px),
        slope_sigma=FIRST_GUESS,
        untouched_change=_untouched_change(used, contacts),
        held_out={},
        training_digests=tuple(presses.presses[i].digest for i in refined.accepted),
        settings={
            "zone": chosen.zone,
            **dict(chosen.settings),
            **({} if chosen.start is None else {"start": chosen.start.digest}),
            "presses": len(used),
            "response": presses.response,
            **presses.geometry.settings(),
            "image_noise": image_noise(
                [presses.presses[i].image for i in refined.accepted], presses.background
            ).tolist(),
        },
        library_version=__version__,
        created_utc=datetime.now(timezone.utc).isoformat(timespec="seconds"),
        gamut=Gamut.fit(samples.color_change, samples.gradients),
    )


def _held_out(
    draft: Calibration,
    presses: Presses,
    by_offset: dict[float, list[PreparedPress]],
    found: Sequence[Contact],
    folds: Sequence[Fold],
    selection: Selection,
    progress: Progress,
) -> tuple[dict[int, PressErrors], SlopeSigma, list[HeldOutSample]]:
    """Errors of every usable press through the whole path, with what was chosen and fitted without it.

    The slopes' spread is that of the chosen candidate: it becomes the calibration's.
    """
    models: list[ColorModel] = []
    errors: dict[int, PressErrors] = {}
    samples: list[HeldOutSample] = []
    prepared = by_offset[selection.chosen.change_offset]
    for done, (fold, candidate) in enumerate(zip(folds, selection.by_fold)):
        suited = by_offset[candidate.change_offset]
        model = candidate.fit([suited[i] for i in fold.training], fold.contacts)
        change = change_settings(presses, candidate.change_offset)
        reconstruct = Reconstructor(replace(draft, color_model=model, change=change))
        for i in fold.held_out:
            circle = _free_circle(suited[i], found[i], model, candidate.zone)
            errors[i] = errors_of(presses.presses[i], circle, reconstruct)
            samples.append(held_out_sample(i, presses.presses[i], circle, reconstruct))
        if candidate != selection.chosen:
            model = selection.chosen.fit([prepared[i] for i in fold.training], fold.contacts)
        models.append(model)
        progress(done + 1, len(folds), "measuring on held-out presses")
    return errors, slope_sigma_from_folds(models, folds, prepared, found), samples


def _free_circle(
    press: PreparedPress, found: Contact, model: ColorModel, zone: float
) -> tuple[float, float, float]:
    """The held-out press's circle: found in its own image, its centre free, its radius not refined."""
    rows, cols = press.pixels(found, zone, 1500)
    gradients = press.gradients(model, rows, cols)
    x, y = ball_center(gradients, cols, rows, (found.x_px, found.y_px), press.ball_radius_px)
    return x, y, found.radius_px


def _report(
    presses: Presses,
    refined: Refined,
    errors: dict[int, PressErrors],
    sigmas: dict[int, tuple[float, float]],
    selection: Selection,
    left_out: Sequence[str],
    seconds: float,
) -> CalibrationReport:
    rows = []
    for i, press in enumerate(presses.presses):
        contact, reason = refined.contacts[i], refined.reasons[i]
        rows.append(
            PressReport(
                press.name,
                press.ball_diameter_mm,
                *contact.circle_px,
                accepted=reason is None,
                reason=reason,
                errors=asdict(errors[i]) if i in errors else None,
                center_sigma_px=sigmas[i][0] if i in sigmas and reason is None else None,
                contact_radius_sigma_px=sigmas[i][1] if i in sigmas and reason is None else None,
            )
        )
    candidates = [
        {
            "candidate": trial.candidate.describe(),
            "normal_free_deg": trial.mean_deg(),
            "standard_error_deg": standard_error([s.normal_deg for s in trial.by_fold.values()]),
            "normal_free_deg_other_size": trial.mean_deg(by_size=True),
            "cap_free_um": 1e3 * presses.mm_per_px * float(trial.expected_losses().mean()),
            "cap_free_um_se": 1e3 * presses.mm_per_px * standard_error(trial.expected_losses()),
            "chosen": trial.candidate == selection.chosen,
        }
        for trial in selection.trials
    ]
    notes: tuple[str, ...] = (
        f"Held-out errors: {len(errors)} presses in {len(selection.by_fold)} folds; circles, model, its kind and its zone "
        f"were found without a fold's presses. {_agreeing(selection)} folds chose what all presses together chose.",
        *presses.geometry.notes(presses.response, presses.mm_per_px_sigma),
    )
    notes += tuple(
        f"{name} was left out: it divides by the background, which has pixels of 0." for name in left_out
    )
    return CalibrationReport(tuple(rows), tuple(candidates), summary(list(errors.values())), seconds, notes)


def _agreeing(selection: Selection) -> str:
    agree = sum(candidate == selection.chosen for candidate in selection.by_fold)
    return f"{agree} of {len(selection.by_fold)}"


def _untouched_change(presses: Sequence[PreparedPress], contacts: Sequence[Contact]) -> float:
    """Size of the color change that untouched pixels stay under, beyond three contact radii."""
    sizes = []
    for press, contact in zip(presses, contacts):
        height, width = press.size.shape
        rows, cols = np.ogrid[:height, :width]
        far = (cols - contact.x_px) ** 2 + (rows - contact.y_px) ** 2 > (3 * contact.radius_px) ** 2
        if far.any():
            sizes.append(float(np.percentile(press.size[far], UNTOUCHED_PERCENTILE)))
    return float(np.median(sizes)) if sizes else 0.03
