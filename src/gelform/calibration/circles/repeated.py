"""Presses that a set shows again: frames of the same ball at the same place are one press.

They show the same light, so a model that has seen one reads the others with small errors, and is right nowhere else. On
simulated sensors 4 depths at each of 12 places, held out as 48 presses, were read with half the error that new presses
were, and the model was worse than that of 12 presses, one for each place.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse.csgraph import connected_components

from gelform.calibration.circles.find import ContactCircle, scale_of, why_no_contact
from gelform.calibration.circles.prepare import find_contacts, prepare
from gelform.calibration.circles.refine import is_deep
from gelform.calibration.circles.samples import PreparedPress
from gelform.calibration.presses.press_set import Presses
from gelform.errors import CalibrationError

# px at 240 rows; the circles found in frames of one press, of another moment, exposure or compression, are within 1.8
NEAR_PX = 2.0


def repeated_presses(
    presses: Presses, prepared: Sequence[PreparedPress], found: Sequence[ContactCircle]
) -> dict[int, int]:
    """The frames that show another one's press again, and the frame of it that stays.

    The deepest one stays, unless its visible circle is as wide as the ball. Frames without a contact are left as they are.

    Raises
    ------
    CalibrationError
        The same image is listed with two balls.
    """
    _check_balls(presses)
    shown = [i for i, contact in enumerate(found) if why_no_contact(contact) is None]
    if not shown:
        return {}
    places = [(prepared[i].ball_radius_px, found[i].x_px, found[i].y_px) for i in shown]
    ball, x, y = np.array(places).T[..., None]
    near = np.hypot(x - x.T, y - y.T) < NEAR_PX * scale_of(presses.image_shape)
    group = connected_components(near & (ball == ball.T), directed=False)[1]
    kept: dict[int, int] = {}
    for i, press in zip(shown, group):
        kept[press] = max(
            kept.get(press, i), i, key=lambda k: (not is_deep(prepared[k], found[k]), found[k].radius_px)
        )
    return {i: kept[press] for i, press in zip(shown, group) if i != kept[press]}


def count_presses(presses: Presses) -> int:
    """The number of presses, frames of one press counted once, and frames without a contact as they are."""
    prepared = prepare(presses)
    return len(prepared) - len(repeated_presses(presses, prepared, find_contacts(prepared)))


def _check_balls(presses: Presses) -> None:
    first = {press.digest: press for press in reversed(presses.presses)}
    for press in presses.presses:
        earlier = first[press.digest]
        if earlier.ball_diameter_mm != press.ball_diameter_mm:
            raise CalibrationError(
                f"{press.name} and {earlier.name} of {presses.folder} are the same image, listed with balls of "
                f"{press.ball_diameter_mm:g} and {earlier.ball_diameter_mm:g} mm. Correct the table."
            )
