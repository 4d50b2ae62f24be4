"""The contact of each press: the loop that fits circles and color model to each other, and the selection of presses.

The contact edge, where the gel leaves the ball: its radius over that of the visible circle, measured.

The visible rim of a press lies outside the contact, by a tenth on most sensors and by a half on some. Beyond the contact
edge the gel is less steep than the ball, and the ball's slopes are wrong labels. A model trained on the inner half alone,
where the gel certainly follows the ball, reads held-out presses and shows where that begins.

Presses that a set shows again: frames of the same ball at the same place are one press.

They show the same light, so a model that has seen one reads the others with small errors, and is right nowhere else. On
simulated sensors 4 depths at each of 12 places, held out as 48 presses, were read with half the error that new presses
were, and the model was worse than that of 12 presses, one for each place.
"""

from __future__ import annotations

import re
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from gelform.calibration.candidates import Start
from gelform.calibration.circles.find import (
    PRESS_PIXELS,
    TRIAL_SAMPLES,
    USUAL_EDGE,
    ZONE,
    ContactCircle,
    PreparedPress,
    contact_radius,
    contact_samples,
    moved,
    scale_of,
    why_no_contact,
    with_rest_samples,
)
from gelform.calibration.circles.prepare import find_contacts, prepare
from gelform.calibration.circles.refine import (
    agreement,
    fit_model,
    is_deep,
    joint_moves,
    recentered,
    why_impossible,
    why_misfits,
    why_too_wide,
)
from gelform.calibration.coverage import FOLDS, NEEDED, coverage_notes
from gelform.calibration.presses.press_set import Presses
from gelform.errors import CalibrationError
from gelform.foundations.findings import Progress, no_progress
from gelform.result.metrics import STEEPEST_FRACTION, ball_center, ball_gradients
from gelform.slopes.color_models import COLOR_MODELS, DEFAULT_MODEL, ColorModel, StartableModel

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
        training = [visible[i] for i in others], [contacts[i] for i in others]
        samples = with_rest_samples(contact_samples(*training, INNER, total=TRIAL_SAMPLES), *training)
        model = COLOR_MODELS[DEFAULT_MODEL].fit(samples)
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


ROUNDS = (
    5  # rounds of fitting the model and moving circles to it; further ones move none by a tenth of a pixel
)
JOINT_DEGREES = (1,)  # degree of position of the model that moves the circles of deep presses
BALL_FACTORS = np.geomspace(0.5, 2.0, 21)  # factors of the stated ball
MANY_REFUSED = 0.3  # of the presses; if more are refused, another ball is tried
NEARLY_ALL = 0.9  # of the presses that have to fit the other ball
WIDE_MARK = 1.6  # median circle by hand over imprint; 1.1-1.2 on home-made sensors, 2 if diameters were given
STATED_SIZE = 0.07  # |log| of a factor; one step of the sweep either way still is the stated ball


@dataclass(frozen=True)
class Refined:
    """The presses after refinement."""

    contacts: tuple[ContactCircle, ...]  # one per press, refined if it was accepted, else as found
    reasons: tuple[str | None, ...]  # the reason that a press was rejected, or None
    model: ColorModel | None  # the model that refined them

    @property
    def accepted(self) -> list[int]:
        """Indices of the presses that fit."""
        return [i for i, reason in enumerate(self.reasons) if reason is None]

    def of_accepted(
        self, presses: Sequence[PreparedPress]
    ) -> tuple[list[PreparedPress], list[ContactCircle]]:
        """The accepted ones of all presses, and their circles."""
        return [presses[i] for i in self.accepted], [self.contacts[i] for i in self.accepted]


@dataclass(frozen=True, eq=False)
class Located:
    """Presses with their circles, and the reasons for rejected presses."""

    presses: Presses  # as read
    prepared: list[PreparedPress]  # with their color changes and the measured edge of their contacts
    found: list[ContactCircle]  # the circle found in each image by itself
    refined: Refined  # circles that agree with each other, and reasons
    # the frames that show another one's press again, with the one that stays
    repeated: Mapping[int, int] = field(default_factory=dict)
    start: Start | None = None  # another unit's model that a fit may begin with, or None
    refined_by: StartableModel | None = None  # the model of it that circles were refined with, or None
    notes: tuple[str, ...] = ()  # notes for the user


def locate(presses: Presses, start: Start | None = None, *, progress: Progress = no_progress) -> Located:
    """The contact circle of each press, refined with all others inside the measured edge of the contact.

    An offered start helps with few presses; from 12 on the presses alone determine their circles.
    """
    prepared = prepare(presses, progress=progress)
    found = find_contacts(prepared, progress=progress)
    notes = mark_notes(prepared, found)
    if start is not None and start.note:
        notes += (f"{start.note} Colors of another gel differ; with few presses the start's count.",)
    repeated, model = repeated_presses(presses, prepared, found), None if start is None else start.model
    excluded = {i: f"the same press as {presses.presses[kept].name}" for i, kept in repeated.items()}
    if start is not None and start.offered and NEEDED.edge.met(len(found) - len(repeated)):
        model = None
    refined = refine(prepared, found, excluded=excluded, start=model, progress=progress)
    if start is not None and start.offered and model is not None:
        alone = refine(prepared, found, excluded=excluded)
        if len(alone.accepted) > len(refined.accepted):
            notes += (
                f"{start.subject} was not used: {len(refined.accepted)} presses fit with it, "
                f"{len(alone.accepted)} without it.",
            )
            refined, model, start = alone, None, None
    other_ball = other_ball_note(prepared, found, refined, excluded)
    ratio = contact_radius_ratio(*refined.of_accepted(prepared))
    if ratio != prepared[0].contact_radius_ratio:
        prepared = [replace(press, contact_radius_ratio=ratio) for press in prepared]
        refined = refine(prepared, found, excluded=excluded, start=model, progress=progress)
    notes += () if other_ball is None else (other_ball,)
    return Located(presses, prepared, found, refined, repeated, start, model, notes)


def mark_notes(presses: Sequence[PreparedPress], found: Sequence[ContactCircle]) -> tuple[str, ...]:
    """Notes on circles by hand, or stage's centers, that are of another place or size than what the images show."""
    notes, ratios = [], []
    for press, contact in zip(presses, found):
        if press.mark is None or press.refused is not None:
            continue
        x, y, radius = press.mark
        apart = float(np.hypot(contact.x_px - x, contact.y_px - y)) / (radius or contact.radius_px)
        if not contact.marked:
            notes.append(f"{press.name} ({apart:.1f} radii)")
        elif radius:
            ratios.append(radius / contact_radius(press.size, x, y))
    said = []
    if notes:
        said.append(
            "Circles by hand or stage's centers are not used where a ball is clearly seen at another place: "
            f"{', '.join(notes)}. Check these rows of the table."
        )
    if ratios and np.median(ratios) > WIDE_MARK:
        said.append(
            f"The circles by hand are {np.median(ratios):.1f} times as wide as the imprints about their centers. "
            "contact_radius_px is a radius: was the diameter given?"
        )
    return tuple(said)


def refine(
    presses: Sequence[PreparedPress],
    found: Sequence[ContactCircle],
    *,
    excluded: Mapping[int, str] | None = None,
    start: StartableModel | None = None,
    progress: Progress = no_progress,
) -> Refined:
    """Move each circle to agree with a color model fitted on all of them; reject presses that do not agree.

    The first model is fitted without the presses that the border cuts, because their circles are found too far inside. It
    moves them and does not judge them. The second one is fitted on them too. Of a few presses, those that the border cuts
    show slopes that no other shows: a model without them refused 1-3 of 12 good ones on two sensors.
    """
    reasons = [why_impossible(press, contact) for press, contact in zip(presses, found)]
    reasons = [reason or wide for reason, wide in zip(reasons, why_too_wide(presses, found))]
    for i, reason in (excluded or {}).items():
        reasons[i] = reason
    candidates = [i for i, reason in enumerate(reasons) if reason is None]
    whole = [i for i in candidates if _is_whole(presses[i], found[i])]
    contacts, fit_on = list(found), whole if NEEDED.whole.met(len(whole)) else candidates
    contacts = _jointly_centered(presses, contacts, fit_on)
    model: ColorModel | None = None
    for round_ in range(ROUNDS if NEEDED.model.met(len(candidates)) else 0):
        model = fit_model([presses[i] for i in fit_on], [contacts[i] for i in fit_on], start)
        for i in candidates:
            contacts[i] = recentered(presses[i], contacts[i], found[i], model)
        misfits = why_misfits([presses[i] for i in candidates], [contacts[i] for i in candidates], model)
        late = {i: reason for i, reason in zip(candidates, misfits) if reason is not None}
        unseen = set(candidates) - set(fit_on) if round_ == 0 else set()
        fit_on = [i for i in candidates if i not in late or i in unseen] or candidates
        progress(round_ + 1, ROUNDS, "fitting circles and colors together")
    if model is not None:
        for i, reason in late.items():
            reasons[i] = reason
            contacts[i] = found[i]
    return Refined(tuple(contacts), tuple(reasons), model)


def _jointly_centered(
    presses: Sequence[PreparedPress], contacts: list[ContactCircle], fit_on: Sequence[int]
) -> list[ContactCircle]:
    """The contacts, moved with a first model of all if most presses are deep, which are found 2-10 px off.

    Usual presses are found within 1-2 px. Alternating keeps them so, while the stiff model would move them.
    """
    deep = [is_deep(presses[i], contacts[i]) for i in fit_on]
    if not NEEDED.whole.met(len(fit_on)) or np.mean(deep) < 0.5:
        return contacts
    chosen = [presses[i] for i in fit_on]
    for _ in range(ROUNDS):
        moves = joint_moves(chosen, [contacts[i] for i in fit_on], ZONE, JOINT_DEGREES, total=TRIAL_SAMPLES)
        for i, (dx, dy) in zip(fit_on, moves):
            x, y = contacts[i].x_px + float(dx), contacts[i].y_px + float(dy)
            contacts[i] = moved(contacts[i], presses[i].size, x, y)
    return contacts


def _is_whole(press: PreparedPress, contact: ContactCircle) -> bool:
    """Whether the circle lies inside the frame; a circle that the border cuts is found too far inside."""
    height, width = press.size.shape
    margin = contact.radius_px
    return margin <= contact.x_px <= width - 1 - margin and margin <= contact.y_px <= height - 1 - margin


def other_ball_note(
    presses: Sequence[PreparedPress],
    found: Sequence[ContactCircle],
    refined: Refined,
    excluded: Container[int] = (),
) -> str | None:
    """A note if many presses are refused, and nearly all fit a ball of another size; else None.

    Presses that were excluded before for any ball do not count.
    """
    judged = [i for i in range(len(presses)) if i not in excluded]
    presses, found, count = [presses[i] for i in judged], [found[i] for i in judged], len(judged)
    if count - len(refined.accepted) < MANY_REFUSED * count:
        return None
    fits = []
    for factor in BALL_FACTORS:
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
    if abs(np.log(factor)) <= STATED_SIZE:
        return None
    return (
        f"{accepted} of {count} presses fit a ball {factor:.2f} times as large as stated. Check ball_diameter_mm and "
        "mm_per_px."
    )


def check_places(located: Located) -> None:
    """Raise a CalibrationError if under three presses fit, with the reasons of the others."""
    least, refined, presses = NEEDED.places.presses, located.refined, located.presses
    if len(refined.accepted) >= least:
        return
    rejected = [(row.name, why) for row, why in zip(presses.presses, refined.reasons) if why is not None]
    kinds: dict[str, list[str]] = {}
    for name, why in rejected:  # reasons that differ only in figures are counted together
        kinds.setdefault(re.sub(r"\d[\d.]*", "", why), []).append(f"{name}: {why}")
    most = sorted(kinds.values(), key=len, reverse=True)[:4]
    listed = "; ".join(f"{len(one)} like {one[0]}" for one in most)
    circles = [refined.contacts[i].circle_px for i in refined.accepted]
    remedy = "".join(f"{note} " for note in located.notes)
    notes = coverage_notes(circles, presses.image_shape, started=located.start is not None)
    raise CalibrationError(
        f"Expected at least {least} presses of a ball that fit, got {len(refined.accepted)} of "
        f"{len(presses.presses)} in {presses.folder}. Rejected: {listed or 'none'}. "
        f"{remedy}Press a ball of known diameter firmly at many places, one image each, best not deeper than half its "
        f"radius. {' '.join(notes)}"
    )
