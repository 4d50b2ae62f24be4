"""The fit of the selected color model on all accepted presses: a calibration without its errors yet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from typing import Any

import numpy as np
import scipy  # its parts load at first use

from gelform import __version__
from gelform.arrays import Array, Map, Mask, Numbers, Slopes
from gelform.calibration.circles.find import (
    ZONE,
    ContactCircle,
    PreparedPress,
    change_settings,
    training_samples,
)
from gelform.calibration.circles.locate import Located
from gelform.calibration.coverage import NEEDED, SAMPLED
from gelform.calibration.presses.press_set import Presses
from gelform.calibration.selection import (
    Candidate,
    Fold,
    HeldOutPresses,
    Selection,
    SlopeReader,
    candidates_for,
    candidates_from,
    fitted_responses,
    select,
)
from gelform.calibration_file import Calibration, CalibrationSettings
from gelform.errors import GelformError
from gelform.foundations.findings import Progress, no_progress
from gelform.image.background import noise_from_image
from gelform.slopes.color_models import COLOR_MODELS, ColorModel
from gelform.slopes.sigma import SlopeSigma, ends_shown

# Weights of slopes before held-out presses are measured; roughly those of any sensor.
FIRST_GUESS = SlopeSigma(rest=0.02, per_step=0.04, full_confidence_sigma=0.04, correlation_px=10.0)
LENGTHS_MM = np.geomspace(0.15, 2.0, 53)


@dataclass(frozen=True, eq=False)
class Fitted:
    """The selected color model and forward response, fitted on all accepted presses, and without each fold."""

    held_out: HeldOutPresses  # the located presses, split into folds, with the fits without each
    selection: Selection  # the selected candidate
    calibration: Calibration  # of all accepted presses, without its errors yet
    notes: tuple[str, ...] = ()  # the color models that could not be compared, with the reasons


def fit(
    located: Located,
    folds: Sequence[Fold],
    color_model: str,
    *,
    compare: bool = False,
    progress: Progress = no_progress,
) -> Fitted:
    """Select the stiffness of the color model and its forward response on held-out presses, and fit both on all.

    The color model is ignored if `located` has another unit's, unless it was just offered and 12 presses or more can choose.
    `compare` tries all models and does not change the selection.
    """
    accepted, start = len(located.refined.accepted), located.start
    begun = [] if start is None else [candidates_from(start, accepted)]
    choice = start is None or (start.offered and NEEDED.edge.met(accepted))
    alone = [candidates_for(color_model, accepted)] if choice else []
    held_out = HeldOutPresses(located, folds)
    selection = select([*begun, *alone], held_out, progress=progress)
    notes: tuple[str, ...] = ()
    if compare:
        selection, notes = _compared(selection, held_out, accepted, progress)
    prepared, untouched = held_out.prepared_for(selection.chosen)
    used, contacts = located.refined.of_accepted(prepared)
    own = located.presses.subset(located.refined.accepted)
    calibration = fit_all(own, used, contacts, selection.chosen, untouched)
    shown = set(located.refined.accepted)  # a frame that shows a used press again is no new one either
    digests = [
        one.digest for i, one in enumerate(located.presses.presses) if located.repeated.get(i, i) in shown
    ]
    calibration = replace(calibration, training_digests=tuple(digests))
    return Fitted(held_out, selection, calibration, notes)


def _compared(
    selection: Selection, held_out: HeldOutPresses, presses: int, progress: Progress
) -> tuple[Selection, tuple[str, ...]]:
    """The selection followed by the trials of every other color model, and the models that could not be tried."""
    trials = {trial.candidate: trial for trial in selection.trials}
    left_out: list[str] = []
    for name in COLOR_MODELS:
        try:
            others = select([candidates_for(name, presses)], held_out, progress=progress).trials
        except GelformError as problem:  # its extra is not installed, or it needs more presses
            left_out.append(f"{name} was not compared: {problem}")
            continue
        trials |= {trial.candidate: trial for trial in others if trial.candidate not in trials}
    return replace(selection, trials=tuple(trials.values())), tuple(left_out)


def fit_all(
    presses: Presses,
    prepared: Sequence[PreparedPress],
    contacts: Sequence[ContactCircle],
    chosen: Candidate,
    untouched: float,
) -> Calibration:
    """The calibration of presses by the selected candidate; its errors and its slope sigma are filled in later."""
    noise = presses.background_noise
    model = chosen.fit(training_samples(prepared, contacts))
    step = chosen if chosen.step_ridge is not None else chosen.with_steps(len(prepared))[0]
    assert step.step_ridge is not None
    reader = SlopeReader(model, prepared[0], untouched)
    (forward,) = fitted_responses(reader, prepared, contacts, [step.step_ridge], start=chosen.start)
    images = [press.image for press in presses.presses]
    levels = [image[one.pixels(contact, ZONE)] for image, one, contact in zip(images, prepared, contacts)]
    shares = ends_shown(np.concatenate(levels))  # under 1 % do not teach the effect of a clipped channel
    forward = replace(
        forward,
        step_sigma=None if chosen.step_ridge is None else forward.step_sigma,
        clipped=np.asarray(shares > 0.01),
    )
    relaxation_mm = relaxation_from_presses(model, prepared, contacts, presses.background, presses.mm_per_px)
    return Calibration(
        sensor_name=presses.sensor_name,
        serial=presses.serial,
        gel_id=presses.gel_id,
        view=presses.camera_view,
        image_shape=presses.image_shape,
        mm_per_px=presses.mm_per_px,
        mm_per_px_sigma=presses.mm_per_px_sigma,
        background=presses.background,
        background_noise=noise_from_image(presses.background) if noise is None else noise,
        change=change_settings(presses, chosen.change_offset),
        color_model=model,
        forward=forward,
        slope_sigma=FIRST_GUESS if forward.step_sigma is None else replace(FIRST_GUESS, per_step=1.0),
        untouched_change=untouched,
        held_out={},
        training_digests=tuple(press.digest for press in presses.presses),
        settings=_settings(presses, chosen, images, prepared[0].contact_radius_ratio, relaxation_mm),
        library_version=__version__,
        created_utc=datetime.now(timezone.utc).isoformat(timespec="seconds"),
    )


def _settings(
    presses: Presses,
    chosen: Candidate,
    images: Sequence[Any],
    contact_radius_ratio: float,
    relaxation_mm: float | None = None,
) -> CalibrationSettings:
    """Inputs and choices of the run and the gel's relaxation, as the calibration records them."""
    return CalibrationSettings(
        contact_radius_ratio=contact_radius_ratio,
        step_ridge=chosen.step_ridge,
        start=None if chosen.start is None else chosen.start.digest,
        presses=len(images),
        response=presses.response,
        camera=dict(presses.camera) if presses.camera else None,
        relaxation_mm=relaxation_mm,
        image_noise=image_noise(images, presses.background).tolist(),
        others=dict(chosen.settings),
        **presses.geometry.settings(),
    )


def image_noise(images: Sequence[Array], background: Map) -> Numbers:
    """Standard deviation (3,) of an image's pixel, gray levels: the median over some of the images.

    A background is often an average of frames, with less noise than the images of presses.
    """
    some = images[:: max(1, len(images) // SAMPLED)]
    found = [noise_from_image(image.astype(np.float32) - background) for image in some]
    return np.asarray(np.median(found, axis=0), dtype=np.float64)


def relaxation_from_presses(
    model: ColorModel,
    presses: Sequence[PreparedPress],
    contacts: Sequence[ContactCircle],
    background: Map,
    mm_per_px: float,
) -> float | None:
    """The gel's relaxation length L in mm; None if the surroundings of the contacts do not show it.

    Around a ball's contact the gel is a membrane under tension on an elastic bed, `laplace(z) = z/L^2` (Kerr, J. Appl.
    Mech. 31, 1964). It has the depth A K0(r/L) and the slope -A/L K1(r/L) at the distance r from the ball's axis. One L is
    fitted to the slopes of all presses by least squares, and one A to each.
    """
    prepared, step = model.prepare(background, presses[0].size.shape), -(-len(presses) // SAMPLED)
    errors, squares = np.zeros(LENGTHS_MM.size), 0.0
    for press, contact in zip(presses[::step], contacts[::step]):
        slopes = prepared.gradients_from_color(np.ascontiguousarray(press.color_change))[0]
        r, slope, pixels = slopes_around(slopes, contact, press.usable, mm_per_px)
        if r.size:
            errors += [_misfit(r, slope, pixels, length) for length in LENGTHS_MM]
            squares += float(pixels @ slope**2)
    best = int(np.argmin(errors))
    explained = 0 < best < errors.size - 1 and errors[best] < 0.5 * squares
    return float(LENGTHS_MM[best]) if explained else None


def slopes_around(
    gradients: Slopes, contact: ContactCircle, usable: Mask | None, mm_per_px: float
) -> tuple[Numbers, Numbers, Numbers]:
    """Distance (mm), mean outward slope and number of visible pixels of rings around a contact, 1 px wide."""
    height, width = gradients.shape[:2]
    dx = np.arange(width, dtype=np.float32) - np.float32(contact.x_px)
    dy = (np.arange(height, dtype=np.float32) - np.float32(contact.y_px))[:, None]
    r = np.hypot(dx, dy)
    outward = (gradients[..., 0] * dx + gradients[..., 1] * dy) / np.maximum(r, 1)
    ring = r.astype(np.intp)
    # From 4 px on, within which the blurred image still shows the ball; beyond 3 mm the gel is level.
    first, last = int(contact.radius_px + 4) + 1, int(contact.radius_px + 3 / mm_per_px)
    inside = (ring >= first) & (ring < last) & (True if usable is None else usable)
    at, size = ring[inside] - first, max(last - first, 1)
    count, sums, far = (
        np.bincount(at, weights=of, minlength=size)
        for of in (None, outward[inside].astype(np.float64), r[inside].astype(np.float64))
    )
    whole = 2 * np.pi * (first + np.arange(size) + 0.5)
    known = count > 0.75 * whole  # a tilt of all slopes cancels over a whole ring
    n = count[known].astype(np.float64)
    return far[known] / n * mm_per_px, sums[known] / n, n


def _misfit(r_mm: Numbers, slope: Numbers, weight: Numbers, length_mm: float) -> float:
    """Sum of squares that remains after the best -A K1(r/L) with A >= 0."""
    shape = scipy.special.k1e(r_mm / length_mm) * np.exp((r_mm[0] - r_mm) / length_mm)
    size = max(-float(weight @ (slope * shape)) / float(weight @ shape**2), 0.0)
    return float(weight @ (slope + size * shape) ** 2)
