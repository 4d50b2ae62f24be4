"""Joint refinement: the color model and the contact circles of all presses, fitted to each other.

A circle found in one image is off by a pixel or two. A model fitted on all presses averages that out, so each
press is moved to where its ball agrees best with the model, and the model is fitted again. Presses that do not
agree are left out, with the reason.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # its parts load at first use
from numpy.typing import NDArray

from gelform.ball import ball_center, center_jacobian, followed_radius
from gelform.calibration.circles.find import ContactCircle, moved, scale_of, steepest_radius, why_no_contact
from gelform.calibration.circles.samples import ZONE, PreparedPress, contact_samples, with_rest_samples
from gelform.color_models import ColorModel, HierarchicalModel, PolynomialModel, Samples
from gelform.color_models._shared.least_squares import (
    HUBER_SLOPE,
    normal_equations,
    polynomial_terms,
    unit_position,
)
from gelform.progress import Progress, no_progress

ROUNDS = 5
WHOLE_ROUNDS = 2
MIN_WHOLE = 6
REFINING_SAMPLES = 15_000
MAX_MOVE_PX = 8.0
MAX_RESIDUAL = 0.25
RESIDUAL_OVER_MEDIAN = 3.0
START_RIDGE = 1e-2
JOINT_ROUNDS = 5
JOINT_DEGREES = (1,)
STEEPEST_RING = 0.95
GAIN_RANGE = (0.7, 1.45)


@dataclass(frozen=True)
class Refined:
    """The presses after refinement.

    Attributes
    ----------
    contacts : one per press, refined where it was accepted, as found where not
    reasons : why a press was rejected, or None
    model : what refined them
    """

    contacts: tuple[ContactCircle, ...]
    reasons: tuple[str | None, ...]
    model: ColorModel | None

    @property
    def accepted(self) -> list[int]:
        """Indices of the presses that fit."""
        return [i for i, reason in enumerate(self.reasons) if reason is None]

    def of_accepted(
        self, presses: Sequence[PreparedPress]
    ) -> tuple[list[PreparedPress], list[ContactCircle]]:
        """Those of all presses that fit, and their circles."""
        return [presses[i] for i in self.accepted], [self.contacts[i] for i in self.accepted]


def refining_degrees(count: int) -> tuple[int, ...]:
    """Position degrees that a number of presses can carry while their circles are still uncertain."""
    if count < 6:
        return (1,)
    return (2, 1) if count < 9 else (3, 2, 0)


def refine(
    presses: Sequence[PreparedPress],
    found: Sequence[ContactCircle],
    *,
    excluded: Mapping[int, str] | None = None,
    start: HierarchicalModel | None = None,
    progress: Progress = no_progress,
) -> Refined:
    """Move each circle to agree with a color model fitted on all of them; reject the presses that do not.

    Parameters
    ----------
    presses, found : what was pressed and the circle found in each image
    excluded : presses that are rejected already, with the reason
    start : what another unit of the same sensor taught
    """
    reasons = [why_impossible(press, contact) for press, contact in zip(presses, found)]
    reasons = [reason or wide for reason, wide in zip(reasons, why_too_wide(presses, found))]
    for i, reason in (excluded or {}).items():
        reasons[i] = reason
    candidates = [i for i, reason in enumerate(reasons) if reason is None]
    whole = [i for i in candidates if _is_whole(presses[i], found[i])]
    contacts, fit_on = list(found), whole if len(whole) >= MIN_WHOLE else candidates
    contacts = _jointly_centered(presses, contacts, fit_on)
    model: ColorModel | None = None
    for round_ in range(ROUNDS if len(candidates) > 1 else 0):
        model = fit_model([presses[i] for i in fit_on], [contacts[i] for i in fit_on], start)
        for i in candidates:
            contacts[i] = recentered(presses[i], contacts[i], found[i], model)
        misfits = why_misfits([presses[i] for i in candidates], [contacts[i] for i in candidates], model)
        late = {i: reason for i, reason in zip(candidates, misfits) if reason is not None}
        if round_ + 1 == WHOLE_ROUNDS:  # presses cut by the border join; only then are misfits left out
            fit_on = candidates
        elif round_ + 1 > WHOLE_ROUNDS:
            fit_on = [i for i in candidates if i not in late] or candidates
        progress(round_ + 1, ROUNDS, "fitting circles and colours together")
    if model is not None:
        for i, reason in late.items():
            reasons[i] = reason
            contacts[i] = found[i]
    return Refined(tuple(contacts), tuple(reasons), model)


def _jointly_centered(
    presses: Sequence[PreparedPress], contacts: list[ContactCircle], fit_on: Sequence[int]
) -> list[ContactCircle]:
    """The contacts, moved with a first model of all where most presses are deep: those are found 2-10 px off.

    Usual presses are found within 1-2 px, which alternating keeps, while the stiff model would move them.
    """
    deep = [is_deep(presses[i], contacts[i]) for i in fit_on]
    if len(fit_on) < MIN_WHOLE or np.mean(deep) < 0.5:
        return contacts
    chosen = [presses[i] for i in fit_on]
    for _ in range(JOINT_ROUNDS):
        moves = joint_moves(
            chosen, [contacts[i] for i in fit_on], ZONE, JOINT_DEGREES, total=REFINING_SAMPLES
        )
        for i, (dx, dy) in zip(fit_on, moves):
            x, y = contacts[i].x_px + float(dx), contacts[i].y_px + float(dy)
            contacts[i] = moved(contacts[i], presses[i].size, x, y)
    return contacts


def is_deep(press: PreparedPress, contact: ContactCircle) -> bool:
    """Whether the visible circle is as wide as the ball, or wider: the gel stands off the ball inside of it."""
    return followed_radius(contact.radius_px, press.ball_radius_px) < contact.radius_px


def _is_whole(press: PreparedPress, contact: ContactCircle) -> bool:
    """Whether the circle lies inside the frame: one that the border cuts is found too far inside."""
    height, width = press.size.shape
    margin = contact.radius_px
    return margin <= contact.x_px <= width - 1 - margin and margin <= contact.y_px <= height - 1 - margin


def fit_model(
    presses: Sequence[PreparedPress],
    contacts: Sequence[ContactCircle],
    start: HierarchicalModel | None = None,
) -> ColorModel:
    """What circles are refined with: a polynomial, or a start that is followed closely."""
    samples = contact_samples(presses, contacts, total=REFINING_SAMPLES)
    samples = with_rest_samples(samples, presses, contacts)
    if start is not None:
        return HierarchicalModel.fit(samples, ridge=START_RIDGE, start=start)
    return PolynomialModel.fit(samples, position_degrees=refining_degrees(len(presses)))


def why_impossible(press: PreparedPress, contact: ContactCircle) -> str | None:
    """The reason why a circle found in one image cannot be a press of this ball, or None."""
    reason = why_no_contact(contact)
    if reason is None and len(press.pixels(contact, ZONE)[0]) < 30:
        reason = "contact lies outside the frame"
    return reason


def why_too_wide(presses: Sequence[PreparedPress], found: Sequence[ContactCircle]) -> list[str | None]:
    """For each press the reason why its visible circle is too wide for the stated ball, or None.

    A circle as wide as the ball or wider is that of a deep press, which draws the gel down around the ball. The gel is
    steepest where it leaves the ball then, which is nearer to the centre than 0.95 of the ball's radius. If it is
    steepest further out in half of such presses, the ball is larger than stated, and all of them are refused.
    """
    deep = [i for i, (press, contact) in enumerate(zip(presses, found)) if is_deep(press, contact)]
    steepest = {i: steepest_radius(presses[i].size, found[i]) / presses[i].ball_radius_px for i in deep}
    all_ = bool(deep) and float(np.median(list(steepest.values()))) >= STEEPEST_RING
    return [
        f"contact radius {found[i].radius_px:.1f} px is that of the ball ({press.ball_radius_px:.1f} px) or more, and the "
        f"gel is steepest {steepest[i]:.2f} ball radii from its centre: ball diameter or mm_per_px is wrong"
        if i in steepest and (all_ or steepest[i] >= STEEPEST_RING)
        else None
        for i, press in enumerate(presses)
    ]


def recentered(
    press: PreparedPress, contact: ContactCircle, found: ContactCircle, model: ColorModel
) -> ContactCircle:
    """The contact moved to where the ball agrees best with the model, not far from where it was found."""
    rows, cols = press.pixels(contact, ZONE, 1000)
    if len(rows) < 30:
        return contact
    gradients = press.gradients(model, rows, cols)
    x, y = ball_center(gradients, cols, rows, (contact.x_px, contact.y_px), press.ball_radius_px, rounds=8)
    far = np.hypot(x - found.x_px, y - found.y_px)
    limit = 1.5 * MAX_MOVE_PX * scale_of(press.size.shape)
    if far > limit:
        x, y = found.x_px + (x - found.x_px) * limit / far, found.y_px + (y - found.y_px) * limit / far
    return moved(contact, press.size, x, y)


def why_misfits(
    presses: Sequence[PreparedPress], contacts: Sequence[ContactCircle], model: ColorModel
) -> list[str | None]:
    """For each press the reason why it does not agree with the model of all, or None."""
    return misfit_reasons([agreement(press, contact, model) for press, contact in zip(presses, contacts)])


def misfit_reasons(agreements: Sequence[tuple[float, float]]) -> list[str | None]:
    """For each (slope error, gain) the reason why such a press does not fit, or None."""
    typical = float(np.median([residual for residual, _ in agreements]))
    limit = min(MAX_RESIDUAL, max(RESIDUAL_OVER_MEDIAN * typical, 0.1))
    reasons: list[str | None] = []
    for residual, gain in agreements:
        if not GAIN_RANGE[0] <= gain <= GAIN_RANGE[1]:
            reasons.append(
                f"its slopes are {gain:.2f} times those of a ball of this diameter by the other presses: "
                "not a ball, or its ball_diameter_mm is wrong"
            )
        elif residual > limit:
            reasons.append(
                f"slopes differ from the ball's by {residual:.2f} (the other presses: {typical:.2f}, limit {limit:.2f}): "
                "not a ball, slipped, or a double contact"
            )
        else:
            reasons.append(None)
    return reasons


def agreement(press: PreparedPress, contact: ContactCircle, model: ColorModel) -> tuple[float, float]:
    """Median slope error inside the contact, and the slope of model on ball (1 where they agree)."""
    rows, cols = press.pixels(contact, ZONE, 1000)
    ball = press.ball_gradients(contact, rows, cols)
    seen: NDArray[np.float64] = press.gradients(model, rows, cols)
    error = np.linalg.norm(seen - ball, axis=1)
    return float(np.median(error)), float(np.sum(seen * ball) / max(np.sum(ball * ball), 1e-12))


RIDGE = 1e-5
MAX_STEP_PX = 3.0
REWEIGHTED = 2


def joint_moves(
    presses: Sequence[PreparedPress],
    contacts: Sequence[ContactCircle],
    zone: float,
    position_degrees: tuple[int, ...],
    *,
    total: int,
) -> NDArray[np.float64]:
    """Moves (N, 2) of the centres, px, that agree best with one polynomial of all presses, at most 3 px at 240 rows.

    One Gauss-Newton step of Huber's loss of the slope errors.

    Parameters
    ----------
    presses, contacts : and where they are now
    zone : part of the followed radius whose pixels count
    position_degrees : of the polynomial
    total : pixels of all presses, about
    """
    samples, owner, jacobian = _labelled(presses, contacts, zone, total)
    x, y = unit_position(samples.x_px, samples.y_px, samples.shape)
    design = polynomial_terms(samples.color_change, x, y, position_degrees)
    weight, moves = samples.weight, np.zeros((len(presses), 2))
    for _ in range(REWEIGHTED):
        coefficients, moves = _solved(design, samples.gradients, weight, owner, jacobian, len(presses))
        moved = np.einsum("nkc,nc->nk", jacobian, moves[owner])
        error = np.linalg.norm(design @ coefficients - samples.gradients - moved, axis=1)
        weight = samples.weight * np.minimum(1, HUBER_SLOPE / np.maximum(error, 1e-12))
    limit = MAX_STEP_PX * scale_of(samples.shape)
    far = np.hypot(*moves.T)[:, None]
    return moves * np.minimum(1, limit / np.maximum(far, 1e-12))


def _labelled(
    presses: Sequence[PreparedPress], contacts: Sequence[ContactCircle], zone: float, total: int
) -> tuple[Samples, NDArray[np.intp], NDArray[np.float64]]:
    """Samples in the contacts and at rest, whose press each is, and the derivative (N, 2, 2) of its label."""
    parts = [contact_samples([p], [c], zone, total=total // len(presses)) for p, c in zip(presses, contacts)]
    counts = [len(part.x_px) for part in parts]
    columns = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("color_change", "x_px", "y_px", "gradients", "weight")
    }
    inside = Samples(**columns, shape=parts[0].shape, background=parts[0].background)
    samples = with_rest_samples(inside, presses, contacts)
    owner = np.repeat(np.arange(len(presses)), counts)
    radius = np.repeat([press.ball_radius_px for press in presses], counts)
    jacobian = center_jacobian(inside.gradients, radius)
    rest = len(samples.x_px) - len(owner)
    return (
        samples,
        np.append(owner, np.zeros(rest, dtype=np.intp)),
        np.concatenate([jacobian, np.zeros((rest, 2, 2))]),
    )


def _solved(
    design: NDArray[np.float64],
    target: NDArray[np.float64],
    weight: NDArray[np.float64],
    owner: NDArray[np.intp],
    jacobian: NDArray[np.float64],
    count: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Coefficients (terms, 2) and moves (N, 2) that minimise `sum weight |design w - target - jacobian move|^2`."""
    normal, right = normal_equations(design, target, weight)
    factor = scipy.linalg.cho_factor(normal + np.diag(RIDGE * np.diag(normal) + 1e-12))
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
