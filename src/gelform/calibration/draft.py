"""The chosen color model fitted on every accepted press: a calibration that does not know its errors yet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime, timezone
from typing import Any

import numpy as np

from gelform import __version__
from gelform.background.average import noise_from_image
from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.prepare import change_settings
from gelform.calibration.circles.refine import Refined
from gelform.calibration.circles.samples import PreparedPress
from gelform.calibration.forward import forward_from_presses, image_noise
from gelform.calibration.presses.press_set import Presses
from gelform.calibration.relaxation import relaxation_from_presses
from gelform.calibration.selection.candidates import Candidate
from gelform.calibration.shadows import shadow_noise
from gelform.calibration.unlabelled import steepest_at_places
from gelform.calibration_file import Calibration
from gelform.color_models._shared.gamut import Gamut
from gelform.confidence import SlopeSigma

UNTOUCHED_PERCENTILE = 99.0
UNTOUCHED_DISTANCE = 3  # contact radii
USUAL_UNTOUCHED_CHANGE = 0.03  # where no press leaves room for it
# What a Reconstructor weighs slopes by until the held-out presses have told.
FIRST_GUESS = SlopeSigma(rest=0.02, slopes=(0.0, 0.5), sigmas=(0.02, 0.06), clean=0.04, correlation_px=10.0)


def fit_all(
    presses: Presses, prepared: Sequence[PreparedPress], refined: Refined, chosen: Candidate
) -> Calibration:
    """The calibration of every accepted press; its errors and its slope sigma are filled in later.

    Parameters
    ----------
    presses : as read
    prepared : with the color changes that the candidate wants
    refined : their circles, and which presses are accepted
    chosen : the color model, its settings and its training zone
    """
    used, contacts = refined.of_accepted(prepared)
    own = [presses.presses[i] for i in refined.accepted]
    samples = chosen.samples(used, contacts)
    noise = presses.background_noise
    model = chosen.fit_samples(samples)
    forward = forward_from_presses(used, contacts, chosen.zone, presses.mm_per_px, presses.sensor_name)
    cast = shadow_noise(model, forward, used, contacts, presses.background)
    relaxation_mm = relaxation_from_presses(model, used, contacts, presses.background, presses.mm_per_px)
    return Calibration(
        sensor_name=presses.sensor_name,
        serial=presses.serial,
        gel_id=presses.gel_id,
        view=presses.view,
        image_shape=presses.image_shape,
        mm_per_px=presses.mm_per_px,
        mm_per_px_sigma=presses.mm_per_px_sigma,
        background=presses.background,
        background_noise=noise_from_image(presses.background) if noise is None else noise,
        change=change_settings(presses, chosen.change_offset),
        color_model=model,
        forward=replace(forward, shadow_noise=cast),
        slope_sigma=replace(FIRST_GUESS, steepest=steepest_at_places(samples)),
        untouched_change=untouched_change(used, contacts),
        held_out={},
        training_digests=tuple(press.digest for press in own),
        settings=_settings(presses, chosen, [press.image for press in own], used[0].followed, relaxation_mm),
        library_version=__version__,
        created_utc=datetime.now(timezone.utc).isoformat(timespec="seconds"),
        gamut=Gamut.fit(samples.color_change, samples.gradients),
    )


def _settings(
    presses: Presses,
    chosen: Candidate,
    images: Sequence[Any],
    followed: float = 1.0,
    relaxation_mm: float | None = None,
) -> dict[str, Any]:
    """What the run chose and was given and how the gel relaxes, as the calibration records it."""
    return {
        "zone": chosen.zone,
        **({} if followed == 1 else {"followed": followed}),
        **dict(chosen.settings),
        **({} if chosen.start is None else {"start": chosen.start.digest}),
        "presses": len(images),
        "response": presses.response,
        **({"camera": dict(presses.camera)} if presses.camera else {}),
        **presses.geometry.settings(),
        **({} if relaxation_mm is None else {"relaxation_mm": relaxation_mm}),
        "image_noise": image_noise(images, presses.background).tolist(),
    }


def untouched_change(presses: Sequence[PreparedPress], contacts: Sequence[ContactCircle]) -> float:
    """Size of the color change that untouched pixels stay under, beyond three contact radii."""
    sizes = []
    for press, contact in zip(presses, contacts):
        height, width = press.size.shape
        rows, cols = np.ogrid[:height, :width]
        reach = UNTOUCHED_DISTANCE * contact.radius_px
        far = (cols - contact.x_px) ** 2 + (rows - contact.y_px) ** 2 > reach**2
        if far.any():
            sizes.append(float(np.percentile(press.size[far], UNTOUCHED_PERCENTILE)))
    return float(np.median(sizes)) if sizes else USUAL_UNTOUCHED_CHANGE
