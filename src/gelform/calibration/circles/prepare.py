"""Color changes of presses, computed once, in which circles are found and on which color models are fitted."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.circles.find import (
    AGREES,
    MIN_EVIDENCE,
    ContactCircle,
    about_median,
    find_contact,
    magnitude,
    marked_contact,
    scale_of,
)
from gelform.calibration.circles.samples import PreparedPress
from gelform.calibration.circles.templates import find_by_templates
from gelform.calibration.presses.press_set import Presses
from gelform.errors import CalibrationError
from gelform.foundations.progress import Progress, no_progress
from gelform.image.background.change import ChangeSettings, PreparedBackground
from gelform.image.background.check import check_background_of_frames
from gelform.image.background.light import FrameLight
from gelform.image.markers import MarkerFinder
from gelform.slopes.color_models import COLOR_MODELS, PLAIN_MODEL

BLUR_PX = 1.25  # px at 240 rows; it reduces a camera's noise, not the gel's edges
USUAL_OFFSET = COLOR_MODELS[PLAIN_MODEL].change_offset


class ColorChanges:
    """Color changes of images from one background image (H, W, 3), 0-255; markers are bridged."""

    def __init__(self, background: NDArray[np.float32], settings: ChangeSettings) -> None:
        self._rest = PreparedBackground(background, settings)
        self._finder = MarkerFinder(background)

    def __call__(self, image: NDArray[Any]) -> tuple[NDArray[np.float32], NDArray[np.bool_] | None]:
        """The color change (H, W, 3) of an image, and the pixels off markers; None if all are.

        Raises
        ------
        CalibrationError
            The background is not of this image.
        """
        light, _ = self._rest.compare(image)
        return change_without_markers(image, self._rest, light, self._finder)


def change_settings(presses: Presses, offset: float = USUAL_OFFSET) -> ChangeSettings:
    """Division by the background, blurred by 1.25 px at 240 rows, after removing known response curve and crosstalk."""
    blur_px = BLUR_PX * scale_of(presses.image_shape)
    return ChangeSettings("divide", offset, blur_px, presses.geometry.matrix, presses.response)


def prepare(
    presses: Presses, offset: float = USUAL_OFFSET, *, progress: Progress = no_progress
) -> list[PreparedPress]:
    """The presses with their color changes, each checked against the background, to which `offset` gray levels are added.

    A press that is of another light is refused, with the reason, and has no color change.

    Raises
    ------
    CalibrationError
        The background does not belong to half of the presses or more, of which one is named, or not to all together.
    """
    changes = ColorChanges(presses.background, change_settings(presses, offset))
    prepared = []
    for done, press in enumerate(presses.presses):
        refused = None
        try:
            change, usable = changes(press.image)
        except CalibrationError as problem:
            change, usable, refused = np.zeros((*presses.image_shape, 3), np.float32), None, str(problem)
        size = magnitude(about_median(change))
        radius_px = press.ball_diameter_mm / 2 / presses.mm_per_px
        mark = press.label if press.center_px is None else (*press.center_px, None)
        rest = presses.background
        prepared.append(
            PreparedPress(press.name, change, size, radius_px, usable, rest, mark=mark, refused=refused)
        )
        progress(done + 1, len(presses.presses), "preparing")
    others = [(one.name, one.refused) for one in prepared if one.refused is not None]
    if 2 * len(others) >= len(prepared):
        name, reason = others[0]
        raise CalibrationError(
            f"{len(others)} of {len(prepared)} presses do not fit the background. {name}: {reason}"
        )
    kept = [press.image for press, one in zip(presses.presses, prepared) if one.refused is None]
    check_background_of_frames(kept, presses.background)
    return prepared


def prepared_by_offset(
    presses: Presses, prepared: list[PreparedPress], offsets: Iterable[float]
) -> dict[float, list[PreparedPress]]:
    """The presses by the offset of the division that color models need: `prepared` and the missing ones.

    Pixels with background 0 cannot be divided with the offset 0; they are not usable then.
    """
    by_offset = {USUAL_OFFSET: prepared}
    divides = np.asarray((presses.background > 0).all(axis=-1), dtype=bool)
    for offset in set(offsets) - by_offset.keys():
        own = [
            replace(press, contact_radius_ratio=prepared[0].contact_radius_ratio)
            for press in prepare(presses, offset)
        ]
        if offset == 0 and not divides.all():
            own = [
                replace(p, usable=np.asarray(divides if p.usable is None else p.usable & divides))
                for p in own
            ]
        by_offset[offset] = own
    return by_offset


def find_contacts(prepared: list[PreparedPress], *, progress: Progress = no_progress) -> list[ContactCircle]:
    """The contact circle of each image: where its color change is odd, else as marked, else by templates of a ball."""
    found = []
    for done, press in enumerate(prepared):
        contact = find_contact(press.color_change)
        if press.mark is not None:
            contact = marked_contact(contact, press.size, *press.mark)
        found.append(contact)
        progress(done + 1, len(prepared), "finding contact circles")
    known = [
        None if contact.is_weak and press.refused is None and not _has_radius(press) else contact.circle_px
        for press, contact in zip(prepared, found)
    ]
    for k, (circle, evidence) in find_by_templates(prepared, known).items():
        x, y, radius = circle
        apart = np.hypot(x - found[k].x_px, y - found[k].y_px)
        if found[k].marked and apart < AGREES * radius:
            found[k] = replace(found[k], radius_px=radius)  # a stage knows the center alone
        elif evidence >= MIN_EVIDENCE and not found[k].marked:
            found[k] = replace(found[k], x_px=x, y_px=y, radius_px=radius, evidence=evidence)
    return found


def _has_radius(press: PreparedPress) -> bool:
    return press.mark is not None and press.mark[2] is not None


def change_without_markers(
    image: NDArray[Any], rest: PreparedBackground, light: FrameLight | None, finder: MarkerFinder
) -> tuple[NDArray[np.float32], NDArray[np.bool_] | None]:
    """The color change (H, W, 3) of an image, smooth across markers, and the pixels on no marker of either image.

    The second is None on a gel without markers. `light` is the one from `rest.compare(image)`, to be compensated, or
    None.
    """
    if not len(finder.untouched):
        return rest.change(image, light), None
    hidden = finder.untouched.mask | finder(image).mask
    return rest.change(rest.bridged(image, hidden), light), ~hidden
