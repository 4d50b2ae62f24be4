"""A ball of another size: where presses are refused for their slopes or radius, and a larger or smaller ball fits them."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import replace

import numpy as np

from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.refine import Refined, agreement, refine
from gelform.calibration.circles.samples import PreparedPress

FACTORS = np.geomspace(0.5, 2.0, 21)
REFUSED = 0.3  # of the presses, from which on another ball is looked for
NEARLY_ALL = 0.9  # of them
OWN_SIZE = 0.07  # |log| of a factor: a step of the sweep either way is the stated ball


def other_ball_note(
    presses: Sequence[PreparedPress],
    found: Sequence[ContactCircle],
    refined: Refined,
    excluded: Container[int] = (),
) -> str | None:
    """What to check where many presses are refused, and nearly all fit a ball so many times as large; else None.

    Parameters
    ----------
    presses, found : prepared, and the circle found in each image
    refined : with the ball that was stated
    excluded : indices of presses that were refused before, whatever their ball: they do not count
    """
    judged = [i for i in range(len(presses)) if i not in excluded]
    presses, found, count = [presses[i] for i in judged], [found[i] for i in judged], len(judged)
    if count - len(refined.accepted) < REFUSED * count:
        return None
    fits = []
    for factor in FACTORS:
        scaled = [replace(press, ball_radius_px=factor * press.ball_radius_px) for press in presses]
        other = refine(scaled, found)
        if other.model is not None and len(other.accepted) >= NEARLY_ALL * count:
            error = np.median(
                [agreement(scaled[i], other.contacts[i], other.model)[0] for i in other.accepted]
            )
            fits.append((float(error * factor), float(factor), len(other.accepted)))
    if not fits:
        return None
    _, factor, accepted = min(fits)
    if abs(np.log(factor)) <= OWN_SIZE:
        return None
    return (
        f"{accepted} of {count} presses fit a ball {factor:.2f} times as large as stated: check ball_diameter_mm and "
        "mm_per_px."
    )
