"""The contact of each press: the loop that fits circles and color model to each other, and the selection of presses.

A circle found in one image is off by a pixel or two. A model fitted on all presses averages that out. So each press moves
to the place where its ball agrees best with the model, and the model is fitted again.

If most presses are deep, all centers and the model move at once. A color model whose coefficients vary over the image
follows much of a wrong center, so alternating converges slowly. The labels are linear in small moves of their centers;
model and moves are solved together, with the model eliminated (variable projection, G. Golub and V. Pereyra,
SIAM J. Numer. Anal. 10, 1973).

The visible rim of a press lies outside the contact, by a tenth on most sensors and by a half on some. Beyond the contact
edge the gel is less steep than the ball, and the ball's slopes are wrong labels. A model trained on the inner half alone,
where the gel certainly follows the ball, reads held-out presses and shows where that begins.

Frames of the same ball at the same place are one press. They show the same light, so a model that has seen one reads the
others with small errors, and is right nowhere else. On simulated sensors 4 depths at each of 12 places, held out as 48
presses, were read with half the error that new presses were, and the model was worse than that of 12 presses, one for each
place.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy  # its parts load at first use
from scipy.ndimage import gaussian_filter1d
from scipy.sparse.csgraph import connected_components

from gelform.arrays import Array, Map, Numbers
from gelform.calibration.circles.find import (
    LEAST_PIXELS,
    PRESS_PIXELS,
    TRIAL_SAMPLES,
    USUAL_EDGE,
    ZONE,
    ContactCircle,
    PreparedPress,
    contact_radius,
    contact_samples,
    joined,
    prepare,
    ring_mean,
    scale_of,
    training_samples,
    why_no_contact,
    with_rest_samples,
)
from gelform.calibration.coverage import FOLDS, NEEDED, REFINING
from gelform.calibration.presses.press_set import Presses
from gelform.calibration.start import Start
from gelform.errors import CalibrationError, Progress, no_progress
from gelform.image.background import surround_of
from gelform.image.health import CHANNELS
from gelform.image.view import DARK
from gelform.result.metrics import STEEPEST_FRACTION, ball_center, ball_gradients, center_jacobian
from gelform.slopes.color_models import COLOR_MODELS, DEFAULT_MODEL, PLAIN_MODEL, ColorModel, StartableModel
from gelform.slopes.color_models.seam import HUBER_SLOPE, normal_equations, polynomial_terms, unit_position
from gelform.slopes.sigma import SATURATED_FROM

RINGS = np.linspace(0, 1, 21)[1:]  # visible radii, the borders of rings
# of the reading further in; with less, the gel has left the ball; .75 of .70-.80: slopes of one size by the other, and on
# three sets
LEAST_GAIN = 0.75
INNER = 0.5  # fraction of the visible radius that trains the model that measures the edge
# Rounds of fitting the model and moving circles to it; further ones move none by a tenth of a pixel.
ROUNDS = 5
STEEPEST_RING = 0.95  # of the ball's radius; a deep press is steepest further in
MISFIT = 0.7  # of a ball's slopes; less, or more than its inverse, is no ball of that diameter
JOINT_MOVE_PX = 3.0  # px at 240 rows, in one step; labels are linear in such moves
BALL_FACTORS = np.geomspace(0.5, 2.0, 21)  # factors of the stated ball
NEARLY_ALL = 0.9  # of the presses that have to fit the other ball


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
    refined: Refined  # circles that agree with each other, and reasons
    repeated: Mapping[int, int] = field(default_factory=dict)  # as `repeated_presses` gives it
    start: Start | None = None  # another unit's model that a fit may begin with, or None
    refined_by: StartableModel | None = None  # the model of it that circles were refined with, or None
    notes: tuple[str, ...] = ()  # notes for the user


def locate(presses: Presses, start: Start | None = None, *, progress: Progress = no_progress) -> Located:
    """The contact circle of each press, refined with all others inside the measured edge of the contact.

    An offered start helps with few presses; from 12 on the presses alone determine their circles.
    """
    prepared = prepare(presses, progress=progress)
    notes = mark_notes(prepared)
    if start is not None and start.note:
        notes += (f"{start.note} Colors of another gel differ; with few presses the start's count.",)
    repeated, model = repeated_presses(presses, prepared), None if start is None else start.model
    excluded = {i: f"the same press as {presses.presses[kept].name}" for i, kept in repeated.items()}
    if start is not None and start.offered and NEEDED.edge.met(len(prepared) - len(repeated)):
        model = None
    refined = refine(prepared, excluded=excluded, start=model, progress=progress)
    if start is not None and start.offered and model is not None:
        alone = refine(prepared, excluded=excluded)
        if len(alone.accepted) > len(refined.accepted):
            notes += (
                f"{start.subject} was not used: {len(refined.accepted)} presses fit with it, "
                f"{len(alone.accepted)} without it.",
            )
            refined, model, start = alone, None, None
    other_ball = other_ball_note(prepared, refined, excluded)
    edge = USUAL_EDGE if start is None or start.edge is None else start.edge
    ratio = contact_radius_ratio(*refined.of_accepted(prepared), usual=edge)
    if ratio != prepared[0].contact_radius_ratio:
        prepared = [replace(press, contact_radius_ratio=ratio) for press in prepared]
        refined = refine(prepared, excluded=excluded, start=model, progress=progress)
    notes += () if other_ball is None else (other_ball,)
    return Located(presses, prepared, refined, repeated, start, model, notes)


def repeated_presses(presses: Presses, prepared: Sequence[PreparedPress]) -> dict[int, int]:
    """The frames that show another one's press again, and the frame of it that stays.

    The deepest one stays, unless its visible circle is as wide as the ball. Frames without a contact are left as they are.
    CalibrationError: the same image is listed with two balls.
    """
    first = {press.digest: press for press in reversed(presses.presses)}
    for press in presses.presses:
        earlier = first[press.digest]
        if earlier.ball_diameter_mm != press.ball_diameter_mm:
            raise CalibrationError(
                f"{press.name} and {earlier.name} of {presses.folder} are the same image, listed with balls of "
                f"{press.ball_diameter_mm:g} and {earlier.ball_diameter_mm:g} mm. Correct the table."
            )
    shown = [i for i, press in enumerate(prepared) if why_no_contact(press.found) is None]
    if not shown:
        return {}
    places = [(prepared[i].ball_radius_px, *prepared[i].found.circle_px[:2]) for i in shown]
    ball, x, y = np.array(places).T[..., None]
    # px at 240 rows; the circles found in frames of one press, of another moment, exposure or compression, are within 1.8
    near = np.hypot(x - x.T, y - y.T) < 2 * scale_of(presses.image_shape)
    group = connected_components(near & (ball == ball.T), directed=False)[1]

    def depth(k: int) -> tuple[bool, float]:
        return not prepared[k].is_deep(prepared[k].found), prepared[k].found.radius_px

    kept: dict[int, int] = {}
    for i, number in zip(shown, group):
        kept[number] = max(kept.get(number, i), i, key=depth)
    return {i: kept[number] for i, number in zip(shown, group) if i != kept[number]}


def count_presses(presses: Presses) -> int:
    """The number of presses, frames of one press counted once, and frames without a contact as they are."""
    presses = presses.reduced()
    prepared = prepare(presses)
    return len(prepared) - len(repeated_presses(presses, prepared))


def mark_notes(presses: Sequence[PreparedPress]) -> tuple[str, ...]:
    """Notes on circles by hand, or stage's centers, that are of another place or size than what the images show."""
    elsewhere, ratios = [], []
    for press in presses:
        if press.mark is None or press.refused is not None:
            continue
        (x, y, radius), contact = press.mark, press.found
        apart = float(np.hypot(contact.x_px - x, contact.y_px - y)) / (radius or contact.radius_px)
        if not contact.marked:
            elsewhere.append(f"{press.name} ({apart:.1f} radii)")
        elif radius:
            ratios.append(radius / contact_radius(press.size, x, y))
    notes = []
    if elsewhere:
        notes.append(
            "Circles by hand or stage's centers are not used where a ball is clearly seen at another place: "
            f"{', '.join(elsewhere)}. Check these rows of the table."
        )
    # The median is 1.1-1.2 on home-made sensors, and 2 if diameters were given: nearer to 2 than to 1.
    if ratios and np.median(ratios) > 2**0.5:
        notes.append(
            f"The circles by hand are {np.median(ratios):.1f} times as wide as the imprints about their centers. "
            "contact_radius_px is a radius: was the diameter given?"
        )
    return tuple(notes)


def refine(
    presses: Sequence[PreparedPress],
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
    reasons = [why_impossible(press) or wide for press, wide in zip(presses, why_too_wide(presses))]
    for i, reason in (excluded or {}).items():
        reasons[i] = reason
    candidates = [i for i, reason in enumerate(reasons) if reason is None]
    whole = [i for i in candidates if presses[i].found.is_whole_in(presses[i].size.shape)]
    fit_on = whole if NEEDED.whole.met(len(whole)) else candidates
    contacts = _jointly_centered(presses, [press.found for press in presses], fit_on)
    model: ColorModel | None = None
    for round_ in range(ROUNDS if NEEDED.model.met(len(candidates)) else 0):
        model = fit_model([presses[i] for i in fit_on], [contacts[i] for i in fit_on], start)
        for i in candidates:
            contacts[i] = recentered(presses[i], contacts[i], model)
        misfits = why_misfits([presses[i] for i in candidates], [contacts[i] for i in candidates], model)
        late = {i: reason for i, reason in zip(candidates, misfits) if reason is not None}
        unseen = set(candidates) - set(fit_on) if round_ == 0 else set()
        fit_on = [i for i in candidates if i not in late or i in unseen] or candidates
        progress(round_ + 1, ROUNDS, "fitting circles and colors together")
    if model is not None:
        for i, reason in late.items():
            reasons[i] = reason
            contacts[i] = presses[i].found
    return Refined(tuple(contacts), tuple(reasons), model)


def _jointly_centered(
    presses: Sequence[PreparedPress], contacts: list[ContactCircle], fit_on: Sequence[int]
) -> list[ContactCircle]:
    """The contacts, moved with a first model of all if most presses are deep, which are found 2-10 px off.

    Usual presses are found within 1-2 px. Alternating keeps them so, while the stiff model would move them.
    """
    deep = [presses[i].is_deep(contacts[i]) for i in fit_on]
    if not NEEDED.whole.met(len(fit_on)) or np.mean(deep) < 0.5:
        return contacts
    chosen = [presses[i] for i in fit_on]
    for _ in range(ROUNDS):
        moves = joint_moves(chosen, [contacts[i] for i in fit_on])
        for i, (dx, dy) in zip(fit_on, moves):
            x, y = contacts[i].x_px + float(dx), contacts[i].y_px + float(dy)
            contacts[i] = moved(contacts[i], presses[i].size, x, y)
    return contacts


def moved(contact: ContactCircle, size: Map, x_px: float, y_px: float) -> ContactCircle:
    """The contact with another center, and its radius measured again about it."""
    radius = contact_radius(size, x_px, y_px, contact.radius_px)
    return replace(contact, x_px=x_px, y_px=y_px, radius_px=radius)


def fit_model(
    presses: Sequence[PreparedPress], contacts: Sequence[ContactCircle], start: StartableModel | None = None
) -> ColorModel:
    """The model that refines circles: a polynomial, or one that follows a start closely."""
    samples = training_samples(presses, contacts, total=TRIAL_SAMPLES)
    if start is not None:
        return COLOR_MODELS[start.name].fit(samples, ridge=1e-2, start=start)
    degrees = [degrees for least, degrees in REFINING if len(presses) >= least][-1]
    return COLOR_MODELS[PLAIN_MODEL].fit(samples, position_degrees=degrees)


def recentered(press: PreparedPress, contact: ContactCircle, model: ColorModel) -> ContactCircle:
    """The contact moved to the place near its found one where the ball agrees best with the model."""
    rows, cols = press.pixels(contact, ZONE, PRESS_PIXELS)
    if len(rows) < LEAST_PIXELS:
        return contact
    gradients = press.gradients(model, rows, cols)
    x, y = ball_center(gradients, cols, rows, (contact.x_px, contact.y_px), press.ball_radius_px, rounds=8)
    found = press.found
    far = np.hypot(x - found.x_px, y - found.y_px)
    # Deep presses are found within 10 px at 240 rows; over a quarter of a small press's radius is another place.
    limit = min(12.0 * scale_of(press.size.shape), 0.25 * found.radius_px)
    if far > limit:
        x, y = found.x_px + (x - found.x_px) * limit / far, found.y_px + (y - found.y_px) * limit / far
    return moved(found, press.size, x, y)


def why_impossible(press: PreparedPress) -> str | None:
    """The reason that a circle found in one image cannot be a press of this ball, or None."""
    if press.refused is not None:
        return press.refused
    if press.mark is not None:
        (x, y, radius), (height, width) = press.mark, press.size.shape
        beyond = radius or press.ball_radius_px
        if not (-beyond < x < width + beyond and -beyond < y < height + beyond):
            return (
                f"its circle by hand or stage's center lies outside the image, at {x / width:.2f} of its width and "
                f"{y / height:.2f} of its height: give px of the image, after crop and view"
            )
    contact = press.found
    reason = why_no_contact(contact)
    if reason is not None or len(press.pixels(contact, ZONE)[0]) >= LEAST_PIXELS:
        return reason
    if contact.radius_px > 3 * press.ball_radius_px:  # no press makes so wide a contact
        return (
            f"contact radius {contact.radius_px / press.ball_radius_px:.1f} times the ball's: ball_diameter_mm is in inches "
            "(25.4 mm each) or mm_per_px is wrong"
        )
    return "contact lies outside the frame"


def why_too_wide(presses: Sequence[PreparedPress]) -> list[str | None]:
    """For each press the reason that its visible circle is too wide for the stated ball, or None.

    A circle at least as wide as the ball belongs to a deep press, which draws the gel down around the ball. The gel is
    then steepest where it leaves the ball, nearer to the center than 0.95 of the ball's radius. If it is steepest further
    out in half of such presses, the ball is larger than stated, and all of them are refused.
    """
    steepest = {}  # radius at which the ring mean of |change| is largest, up to the visible circle; in ball radii
    for i, press in enumerate(presses):
        contact = press.found
        if press.is_deep(contact):
            rings = ring_mean(press.size, contact.x_px, contact.y_px)
            rings = gaussian_filter1d(rings, 2 * scale_of(press.size.shape))
            steepest[i] = float(np.argmax(rings[: max(1, round(contact.radius_px))])) / press.ball_radius_px
    all_ = bool(steepest) and float(np.median(list(steepest.values()))) >= STEEPEST_RING
    return [
        f"contact radius {press.found.radius_px / press.ball_radius_px:.2f} times the ball's, and the gel is "
        f"steepest {steepest[i]:.2f} ball radii from its center: ball diameter or mm_per_px is wrong"
        if i in steepest and (all_ or steepest[i] >= STEEPEST_RING)
        else None
        for i, press in enumerate(presses)
    ]


def why_misfits(
    presses: Sequence[PreparedPress], contacts: Sequence[ContactCircle], model: ColorModel
) -> list[str | None]:
    """For each press the reason that it does not agree with the model of all, or None."""
    agreements = [agreement(press, contact, model) for press, contact in zip(presses, contacts)]
    reasons, background = misfit_reasons(agreements), presses[0].background
    if not any(reasons) or background is None:
        return reasons
    return misfit_reasons(agreements, "".join(light_notes(background)).rstrip("."))


def misfit_reasons(agreements: Sequence[tuple[float, float]], clipped: str = "") -> list[str | None]:
    """For each (slope error, gain) the reason that such a press does not fit, or None; `clipped` is a likelier one."""
    typical = float(np.median([residual for residual, _ in agreements]))
    limit = min(0.25, max(3 * typical, 0.1))  # mm/mm
    reasons: list[str | None] = []
    for residual, gain in agreements:
        if not MISFIT <= gain <= 1 / MISFIT:
            reasons.append(
                f"its slopes are {gain:.2f} times those of a ball of this diameter, by the other presses: "
                + (clipped or "it is no ball, or its ball_diameter_mm is wrong")
            )
        elif residual > limit:
            reasons.append(
                f"slopes differ from the ball's by {residual:.2f} (the other presses: {typical:.2f}, limit {limit:.2f}): "
                + (clipped or "it is no ball, it slipped, or it is a double contact")
            )
        else:
            reasons.append(None)
    return reasons


def agreement(press: PreparedPress, contact: ContactCircle, model: ColorModel) -> tuple[float, float]:
    """Median slope error inside the contact, and the slope of model on ball (1 if they agree)."""
    rows, cols = press.pixels(contact, ZONE, PRESS_PIXELS)
    ball = press.ball_gradients(contact, rows, cols)
    seen: Numbers = press.gradients(model, rows, cols)
    error = np.linalg.norm(seen - ball, axis=1)
    return float(np.median(error)), float(np.sum(seen * ball) / max(np.sum(ball * ball), 1e-12))


def light_notes(background: Map) -> tuple[str, ...]:
    """The share of the gel where a channel is too dark or saturated, and what to do; () for less than a tenth."""
    outside = surround_of(background)
    gel = background.reshape(-1, 3) if outside is None else background[~outside]
    dark, bright = gel < DARK, gel >= SATURATED_FROM
    share = float((dark | bright).any(axis=-1).mean())
    if share <= 0.1:
        return ()
    named, remedies = [], []
    for at, said, remedy in (
        (dark, f"below {DARK} gray levels", "raise the light or exposure of the dark channels"),
        (bright, "saturated", "lower the light or exposure of the saturated channels"),
    ):
        parts = zip(CHANNELS, at.mean(axis=0))
        which = [f"{name} in {100 * part:.0f} %" for name, part in parts if part > share / 10]
        if which:
            named.append(f"{', '.join(which)} {said}")
            remedies.append(remedy)
    return (
        f"{100 * share:.0f} % of the background image is at an end of the camera's range ({'; '.join(named)}), where slopes "
        f"hardly change the color: {' and '.join(remedies)}.",
    )


def other_ball_note(
    presses: Sequence[PreparedPress], refined: Refined, excluded: Container[int] = ()
) -> str | None:
    """A note if many presses are refused, and nearly all fit a ball of another size; else None.

    Presses that were excluded before for any ball do not count.
    """
    judged = [i for i in range(len(presses)) if i not in excluded]
    presses, count = [presses[i] for i in judged], len(judged)
    if count - len(refined.accepted) < 0.3 * count:
        return None
    fits = []
    for factor in BALL_FACTORS:
        scaled = [replace(press, ball_radius_px=factor * press.ball_radius_px) for press in presses]
        other = refine(scaled)
        if other.model is not None and len(other.accepted) >= NEARLY_ALL * count:
            error = np.median(
                [agreement(scaled[i], other.contacts[i], other.model)[0] for i in other.accepted]
            )
            fits.append((float(error * factor), float(factor), len(other.accepted)))
    if not fits:
        return None
    _, factor, accepted = min(fits)
    if abs(np.log(factor)) < 2 * np.log(BALL_FACTORS[1] / BALL_FACTORS[0]):  # one step off is the stated
        return None
    return (
        f"{accepted} of {count} presses fit a ball {factor:.2f} times as large as stated. Check ball_diameter_mm and "
        "mm_per_px."
    )


def contact_radius_ratio(
    presses: Sequence[PreparedPress], contacts: Sequence[ContactCircle], *, usual: float = USUAL_EDGE
) -> float:
    """Radius, over the visible one, from which the median press reads less than 0.75 times its ball's slope.

    The reading further in counts as 1. Rings are 0.05 visible radii wide, and two of them have to be below 0.75. It is
    the usual one for fewer than 12 presses.
    """
    if not NEEDED.edge.met(len(presses)):
        return usual
    visible = [replace(press, contact_radius_ratio=1.0) for press in presses]
    gains = []
    for group in range(FOLDS):
        others = [i for i in range(len(visible)) if i % FOLDS != group]
        training = [visible[i] for i in others], [contacts[i] for i in others]
        samples = training_samples(*training, INNER, total=TRIAL_SAMPLES)
        model = COLOR_MODELS[DEFAULT_MODEL].fit(samples)
        gains += [_gains(visible[i], contacts[i], model) for i in range(group, len(visible), FOLDS)]
    return edge_of_gains(np.array(gains))


def edge_of_gains(gains: Numbers) -> float:
    """The edge from gains (presses, rings), read slopes over the ball's; NaN where a press has no pixels in a ring."""
    known = np.isfinite(gains).any(axis=0)
    median = np.full(gains.shape[1], np.nan)
    median[known] = np.nanmedian(gains[:, known], axis=0)
    middles = (RINGS[:-1] + RINGS[1:]) / 2
    inner = (RINGS[:-1] >= 0.1) & (RINGS[1:] <= 0.4 + 1e-9)  # slopes read there count as right
    relative = median / np.nanmean(median[inner])
    below = relative < LEAST_GAIN
    both = np.flatnonzero(below & np.append(below[1:], True))
    if not both.size:
        return float(RINGS[-1])
    last = max(int(both[0]), 1)
    part = (relative[last - 1] - LEAST_GAIN) / max(relative[last - 1] - relative[last], 1e-12)
    return float(np.interp(np.clip(part, 0, 1), (0, 1), middles[last - 1 : last + 1]))


def _gains(press: PreparedPress, contact: ContactCircle, model: ColorModel) -> Numbers:
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


def joint_moves(presses: Sequence[PreparedPress], contacts: Sequence[ContactCircle]) -> Numbers:
    """Moves (N, 2) of the centers, px, that agree best with one polynomial of all presses, at most 3 px at 240 rows.

    It is one Gauss-Newton step of Huber's loss of the slope errors, at pixels in the contacts and at rest. The polynomial is
    of degree 1 in position.
    """
    total = TRIAL_SAMPLES // len(presses)
    parts = [contact_samples([press], [contact], total=total) for press, contact in zip(presses, contacts)]
    counts, inside = [len(part.x_px) for part in parts], joined(parts)
    samples = with_rest_samples(inside, presses, contacts)
    rest = len(samples.x_px) - len(inside.x_px)
    owner = np.append(np.repeat(np.arange(len(presses)), counts), np.zeros(rest, dtype=np.intp))
    radius = np.repeat([press.ball_radius_px for press in presses], counts)
    jacobian = np.concatenate([center_jacobian(inside.gradients, radius), np.zeros((rest, 2, 2))])
    x, y = unit_position(samples.x_px, samples.y_px, samples.shape)
    design = polynomial_terms(samples.color_change, x, y, (1,))
    weight, moves = samples.weight, np.zeros((len(presses), 2))
    for _ in range(2):  # of Huber's weights
        coefficients, moves = _solved(design, samples.gradients, weight, owner, jacobian, len(presses))
        by_move = np.einsum("nkc,nc->nk", jacobian, moves[owner])
        error = np.linalg.norm(design @ coefficients - samples.gradients - by_move, axis=1)
        weight = samples.weight * np.minimum(1, HUBER_SLOPE / np.maximum(error, 1e-12))
    limit = JOINT_MOVE_PX * scale_of(samples.shape)
    far = np.hypot(*moves.T)[:, None]
    return moves * np.minimum(1, limit / np.maximum(far, 1e-12))


def _solved(
    design: Numbers, target: Numbers, weight: Numbers, owner: Array, jacobian: Numbers, count: int
) -> tuple[Numbers, Numbers]:
    """Coefficients (terms, 2) and moves (N, 2) that minimize `sum weight |design w - target - jacobian move|^2`."""
    normal, right = normal_equations(design, target, weight)
    # Definite by the ridge, and so is what it leaves of the moves, but for rounding: far below 1e-9.
    factor = scipy.linalg.cho_factor(normal + np.diag(1e-5 * np.diag(normal) + 1e-12))
    schur, rest = np.zeros((2 * count, 2 * count)), np.zeros(2 * count)
    cross = np.empty((2, design.shape[1], 2 * count))
    for i in range(count):
        own = np.flatnonzero(owner == i)
        by_center, part = jacobian[own], slice(2 * i, 2 * i + 2)
        scaled = by_center * weight[own, None, None]
        schur[part, part] = np.einsum("nka,nkb->ab", scaled, by_center)
        rest[part] = -np.einsum("nka,nk->a", scaled, target[own])
        cross[:, :, part] = np.einsum("nt,nka->kta", design[own], scaled)
    for k in range(2):
        schur -= cross[k].T @ scipy.linalg.cho_solve(factor, cross[k])
        rest += cross[k].T @ scipy.linalg.cho_solve(factor, right[:, k])
    moves = scipy.linalg.solve(schur + 1e-9 * np.eye(2 * count), rest, assume_a="pos")
    coefficients = np.stack(
        [scipy.linalg.cho_solve(factor, right[:, k] + cross[k] @ moves) for k in range(2)], axis=1
    )
    return coefficients, moves.reshape(count, 2)
