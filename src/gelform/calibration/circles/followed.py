"""How far out the gel follows the ball: the share of the visible circle inside which a ball's slopes are the gel's.

The colour of a press fades out, and what the eye calls its rim can be far outside the contact: up to 1.25 times its radius
on simulated DIGITs with soft gels, 1.6 times on a real one. Labels between the two are too steep. A model that learns from
them must be less steep than they are far out, and then it is too steep further in: by how much tells how far out
the labels hold.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gelform.ball import ball_center, ball_gradients
from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.samples import PreparedPress, contact_samples, with_rest_samples
from gelform.color_models import ColorModel, PolynomialModel

SHARES = (1.0, 0.95, 0.9, 0.85, 0.8, 0.75, 0.7, 0.65, 0.6, 0.55, 0.5)
# Of them, the last whose outer ring reads so much of what its inner part reads is where the gel leaves the ball: on eight
# simulated sensors within 0.06 of the truth.
LEAST_STEEPNESS = 0.9
# Of the share: pixels beyond the one are its outer ring, within the other its inner part.
RING, INNER = 0.85, 0.6
# Of the visible circle: gels that follow the ball so far are usual ones, whose zones are shares of it as they are; where the
# ball is left before, zones are shares of what a usual visible circle of that contact would be.
USUAL, USUAL_CIRCLE = 0.85, 0.9
LEAST_PRESSES = 12
MANY, OF_MANY, OF_FEW = 18, 3, 6  # groups that are left out in turn; of few presses each is missed more
# Of the polynomial in place: a stiffer one follows no labels closely, and reads right ones as wrong.
DEGREES = (3, 2, 0)
PIXELS, PIXELS_OF_PRESS = 12_000, 2_000


def followed_share(presses: Sequence[PreparedPress], contacts: Sequence[ContactCircle]) -> float:
    """Share of the visible radius that presses are cut down to, `PreparedPress.followed`.

    1 for usual gels; for fewer than 12 presses, which do not tell; and where most are so deep that their visible circle is
    as wide as the ball: then it is the ball's radius that says how far the gel follows.

    Parameters
    ----------
    presses, contacts : that fit, and their circles
    """
    if len(presses) < LEAST_PRESSES or _are_deep(presses, contacts):
        return 1.0
    for share in SHARES:
        ratios = _steepness(presses, contacts, share)
        error = float(np.std(ratios)) / np.sqrt(len(ratios))
        if float(np.median(ratios)) + error >= LEAST_STEEPNESS:
            return 1.0 if share >= USUAL else share / USUAL_CIRCLE
    return SHARES[-1] / USUAL_CIRCLE


def _are_deep(presses: Sequence[PreparedPress], contacts: Sequence[ContactCircle]) -> bool:
    deep = [press.followed_radius(one) < one.radius_px for press, one in zip(presses, contacts)]
    return bool(np.mean(deep) >= 0.5)


def _steepness(
    presses: Sequence[PreparedPress], contacts: Sequence[ContactCircle], share: float
) -> list[float]:
    """Of each press, by a model of other presses: slopes read over the ball's in the outer ring, over those further in."""
    ratios = []
    groups = OF_MANY if len(presses) >= MANY else OF_FEW
    for group in range(groups):
        others = [i for i in range(len(presses)) if i % groups != group]
        model = _fit([presses[i] for i in others], [contacts[i] for i in others], share)
        for i in range(group, len(presses), groups):
            ratios.append(_steepness_of(presses[i], contacts[i], share, model))
    return [ratio for ratio in ratios if np.isfinite(ratio)]


def _fit(presses: Sequence[PreparedPress], contacts: Sequence[ContactCircle], share: float) -> ColorModel:
    samples = contact_samples(presses, contacts, share, total=PIXELS)
    return PolynomialModel.fit(with_rest_samples(samples, presses, contacts), position_degrees=DEGREES)


def _steepness_of(press: PreparedPress, contact: ContactCircle, share: float, model: ColorModel) -> float:
    rows, cols = press.pixels(contact, share, PIXELS_OF_PRESS)
    seen = press.gradients(model, rows, cols)
    center = ball_center(seen, cols, rows, (contact.x_px, contact.y_px), press.ball_radius_px)
    ball = ball_gradients(cols, rows, center, press.ball_radius_px)
    reach = share * press.followed_radius(contact)
    away = np.hypot(cols - center[0], rows - center[1]) / reach
    outer, inner = (
        float(np.sum(seen[part] * ball[part]) / max(float(np.sum(ball[part] ** 2)), 1e-12))
        for part in ((away > RING) & (away < 1), away < INNER)
    )
    return outer / inner if inner > 0 and (away > RING).any() else float("nan")
