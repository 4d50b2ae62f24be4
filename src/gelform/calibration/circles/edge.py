"""The contact edge, where the gel leaves the ball: its radius over that of the visible circle, measured.

The visible rim of a press lies outside the contact, by a tenth on most sensors and by a half on some. Beyond the contact
edge the gel is less steep than the ball, and the ball's slopes are wrong labels. A model trained on the inner half alone,
where the gel certainly follows the ball, reads held-out presses and shows where that begins.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.samples import (
    PRESS_PIXELS,
    TRIAL_SAMPLES,
    USUAL_EDGE,
    PreparedPress,
    contact_samples,
    with_rest_samples,
)
from gelform.calibration.enough import FOLDS, NEEDED
from gelform.result.metrics.ball import STEEPEST_FRACTION, ball_center, ball_gradients
from gelform.slopes.color_models import COLOR_MODELS, DEFAULT_MODEL, ColorModel

INNER = 0.5  # fraction of the visible radius that trains
RINGS = np.arange(0.05, 1.001, 0.05)
REFERENCE = (0.1, 0.4)  # fractions of the visible radius; slopes read between them count as right
# of that reading; with less, the gel has left the ball; .75 of .70-.80: slopes of one size by the other, and on three sets
LEAST_GAIN = 0.75


def contact_radius_ratio(presses: Sequence[PreparedPress], contacts: Sequence[ContactCircle]) -> float:
    """Radius, over the visible one, from which the median press reads less than 0.75 times its ball's slope.

    The reading further in counts as 1. Rings are 0.05 visible radii wide, and two of them have to be below 0.75. It is
    `USUAL_EDGE` for fewer than 12 presses.
    """
    if not NEEDED.edge.met(len(presses)):
        return USUAL_EDGE
    visible = [replace(press, contact_radius_ratio=1.0) for press in presses]
    gains = []
    for group in range(FOLDS):
        others = [i for i in range(len(visible)) if i % FOLDS != group]
        model = _of_inner_half([visible[i] for i in others], [contacts[i] for i in others])
        gains += [_gains(visible[i], contacts[i], model) for i in range(group, len(visible), FOLDS)]
    return edge_of_gains(np.array(gains))


def edge_of_gains(gains: NDArray[np.float64]) -> float:
    """The edge from gains (presses, rings), read slopes over the ball's; NaN where a press has no pixels in a ring."""
    known = np.isfinite(gains).any(axis=0)
    median = np.full(gains.shape[1], np.nan)
    median[known] = np.nanmedian(gains[:, known], axis=0)
    middles = (RINGS[:-1] + RINGS[1:]) / 2
    inner = (REFERENCE[0] <= RINGS[:-1]) & (RINGS[1:] <= REFERENCE[1] + 1e-9)
    relative = median / np.nanmean(median[inner])
    below = relative < LEAST_GAIN
    both = np.flatnonzero(below & np.append(below[1:], True))
    if not both.size:
        return float(RINGS[-1])
    last = max(int(both[0]), 1)
    part = (relative[last - 1] - LEAST_GAIN) / max(relative[last - 1] - relative[last], 1e-12)
    return float(np.interp(np.clip(part, 0, 1), (0, 1), middles[last - 1 : last + 1]))


def _of_inner_half(presses: Sequence[PreparedPress], contacts: Sequence[ContactCircle]) -> ColorModel:
    samples = contact_samples(presses, contacts, INNER, total=TRIAL_SAMPLES)
    return COLOR_MODELS[DEFAULT_MODEL].fit(with_rest_samples(samples, presses, contacts))


def _gains(press: PreparedPress, contact: ContactCircle, model: ColorModel) -> NDArray[np.float64]:
    """Gains of each ring, read slopes over the ball's by least squares, about the center fitted to the inner half."""
    rows, cols = press.pixels(contact, 1.0, PRESS_PIXELS)
    read, radius = press.gradients(model, rows, cols), press.contact_radius(contact)
    start = contact.x_px, contact.y_px
    inner = np.hypot(cols - start[0], rows - start[1]) < INNER * radius
    center = ball_center(read[inner], cols[inner], rows[inner], start, press.ball_radius_px)
    ball = ball_gradients(cols, rows, center, press.ball_radius_px)
    away = np.hypot(cols - center[0], rows - center[1])
    ring = np.digitize(away / radius, RINGS) - 1
    ring[away > STEEPEST_FRACTION * press.ball_radius_px] = -1
    members = (ring >= 0) & (ring < len(RINGS) - 1)
    along, square = (
        np.bincount(ring[members], np.sum(values[members] * ball[members], axis=1), len(RINGS) - 1)
        for values in (read, ball)
    )
    return np.where(square > 0, along / np.maximum(square, 1e-12), np.nan)
