"""Steps that move circles: the common color model, the best place of each press in it, and the presses that do not fit.

Steps that move circles: the common color model, the best place of each press in it, and the presses that do not fit.

A circle found in one image is off by a pixel or two. A model fitted on all presses averages that out. So each press moves
to the place where its ball agrees best with the model, and the model is fitted again (`circles.locate`).

If most presses are deep, all centers and the model move at once. A color model whose coefficients vary over the image
follows much of a wrong center, so alternating converges slowly. The labels are linear in small moves of their centers;
model and moves are solved together, with the model eliminated (variable projection, G. Golub and V. Pereyra,
SIAM J. Numer. Anal. 10, 1973).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy  # its parts load at first use
from numpy.typing import NDArray

from gelform.calibration.circles.find import (
    PRESS_PIXELS,
    TRIAL_SAMPLES,
    ZONE,
    ContactCircle,
    PreparedPress,
    contact_samples,
    joined,
    moved,
    scale_of,
    steepest_radius,
    why_no_contact,
    with_rest_samples,
)
from gelform.calibration.coverage import REFINING
from gelform.image.background import surround_of
from gelform.image.frame import DARK
from gelform.image.health import CHANNELS
from gelform.result.metrics import ball_center, center_jacobian, followed_radius
from gelform.slopes.color_models import COLOR_MODELS, PLAIN_MODEL, ColorModel, Samples, StartableModel
from gelform.slopes.color_models.least_squares import (
    HUBER_SLOPE,
    normal_equations,
    polynomial_terms,
    unit_position,
)
from gelform.slopes.sigma import SATURATED_FROM

MOST_UNUSABLE = 0.1  # of the pixels of the background image


def light_notes(background: NDArray[np.float32]) -> tuple[str, ...]:
    """The share of the gel where a channel is too dark or saturated, and what to do; () for less than a tenth."""
    outside = surround_of(background)
    gel = background.reshape(-1, 3) if outside is None else background[~outside]
    dark, bright = gel < DARK, gel >= SATURATED_FROM
    share = float((dark | bright).any(axis=-1).mean())
    if share <= MOST_UNUSABLE:
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


MAX_MOVE_PX = 8.0  # px at 240 rows; usual presses are found within 2, deep ones within 10
MAX_MOVE_RADII = 0.25  # of the found circle; more is another place than that of a small press
MAX_RESIDUAL = 0.25  # mm/mm, largest median slope error of a press that fits
RESIDUAL_OVER_MEDIAN = 3.0  # times the other presses' median slope error
START_RIDGE = 1e-2  # ridge of the model that follows another unit's
STEEPEST_RING = 0.95  # of the ball's radius; a deep press is steepest further in
MANY_BALLS = 3.0  # radii of the stated ball; no press makes so wide a contact
GAIN_RANGE = (0.7, 1.45)  # slopes over those of the stated ball
JOINT_RIDGE = 1e-5  # ridge of the polynomial, relative to its normal equations' diagonal
JOINT_MOVE_PX = 3.0  # px at 240 rows, in one step; labels are linear in such moves
JOINT_REWEIGHTED = 2  # rounds of Huber's weights in one step


def is_deep(press: PreparedPress, contact: ContactCircle) -> bool:
    """Whether the visible circle is at least as wide as the ball; then the gel leaves the ball inside of it."""
    return followed_radius(contact.radius_px, press.ball_radius_px) < contact.radius_px


def fit_model(
    presses: Sequence[PreparedPress],
    contacts: Sequence[ContactCircle],
    start: StartableModel | None = None,
) -> ColorModel:
    """The model that refines circles: a polynomial, or one that follows a start closely."""
    samples = contact_samples(presses, contacts, total=TRIAL_SAMPLES)
    samples = with_rest_samples(samples, presses, contacts)
    if start is not None:
        return COLOR_MODELS[start.name].fit(samples, ridge=START_RIDGE, start=start)
    degrees = [degrees for least, degrees in REFINING if len(presses) >= least][-1]
    return COLOR_MODELS[PLAIN_MODEL].fit(samples, position_degrees=degrees)


def why_impossible(press: PreparedPress, contact: ContactCircle) -> str | None:
    """The reason that a circle found in one image cannot be a press of this ball, or None."""
    reason = press.refused or _why_outside(press) or why_no_contact(contact)
    if reason is None and len(press.pixels(contact, ZONE)[0]) < 30:
        reason = "contact lies outside the frame"
        if contact.radius_px > MANY_BALLS * press.ball_radius_px:
            reason = (
                f"contact radius {contact.radius_px:.1f} px, the ball's {press.ball_radius_px:.1f} px: ball_diameter_mm is "
                "in inches (25.4 mm each) or mm_per_px is wrong"
            )
    return reason


def _why_outside(press: PreparedPress) -> str | None:
    """The reason that a circle by hand or a stage's center lies outside the image, or None."""
    if press.mark is None:
        return None
    (x, y, radius), (height, width) = press.mark, press.size.shape
    beyond = radius or press.ball_radius_px
    if -beyond < x < width + beyond and -beyond < y < height + beyond:
        return None
    return (
        f"its circle by hand or stage's center ({x:.0f}, {y:.0f}) lies outside the image of {width} px by {height} px: give "
        "px of the image, after crop and view"
    )


def why_too_wide(presses: Sequence[PreparedPress], found: Sequence[ContactCircle]) -> list[str | None]:
    """For each press the reason that its visible circle is too wide for the stated ball, or None.

    A circle at least as wide as the ball belongs to a deep press, which draws the gel down around the ball. The gel is
    then steepest where it leaves the ball, nearer to the center than 0.95 of the ball's radius. If it is steepest further
    out in half of such presses, the ball is larger than stated, and all of them are refused.
    """
    deep = [i for i, (press, contact) in enumerate(zip(presses, found)) if is_deep(press, contact)]
    steepest = {i: steepest_radius(presses[i].size, found[i]) / presses[i].ball_radius_px for i in deep}
    all_ = bool(deep) and float(np.median(list(steepest.values()))) >= STEEPEST_RING
    return [
        f"contact radius {found[i].radius_px:.1f} px is that of the ball ({press.ball_radius_px:.1f} px) or more, and the "
        f"gel is steepest {steepest[i]:.2f} ball radii from its center: ball diameter or mm_per_px is wrong"
        if i in steepest and (all_ or steepest[i] >= STEEPEST_RING)
        else None
        for i, press in enumerate(presses)
    ]


def recentered(
    press: PreparedPress, contact: ContactCircle, found: ContactCircle, model: ColorModel
) -> ContactCircle:
    """The contact moved to the place near its found one where the ball agrees best with the model."""
    rows, cols = press.pixels(contact, ZONE, PRESS_PIXELS)
    if len(rows) < 30:
        return contact
    gradients = press.gradients(model, rows, cols)
    x, y = ball_center(gradients, cols, rows, (contact.x_px, contact.y_px), press.ball_radius_px, rounds=8)
    far = np.hypot(x - found.x_px, y - found.y_px)
    limit = min(1.5 * MAX_MOVE_PX * scale_of(press.size.shape), MAX_MOVE_RADII * found.radius_px)
    if far > limit:
        x, y = found.x_px + (x - found.x_px) * limit / far, found.y_px + (y - found.y_px) * limit / far
    return moved(found, press.size, x, y)


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
    limit = min(MAX_RESIDUAL, max(RESIDUAL_OVER_MEDIAN * typical, 0.1))
    reasons: list[str | None] = []
    for residual, gain in agreements:
        if not GAIN_RANGE[0] <= gain <= GAIN_RANGE[1]:
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
    seen: NDArray[np.float64] = press.gradients(model, rows, cols)
    error = np.linalg.norm(seen - ball, axis=1)
    return float(np.median(error)), float(np.sum(seen * ball) / max(np.sum(ball * ball), 1e-12))


def joint_moves(
    presses: Sequence[PreparedPress],
    contacts: Sequence[ContactCircle],
    zone: float,
    position_degrees: tuple[int, ...],
    *,
    total: int,
) -> NDArray[np.float64]:
    """Moves (N, 2) of the centers, px, that agree best with one polynomial of all presses, at most 3 px at 240 rows.

    It is one Gauss-Newton step of Huber's loss of the slope errors, at about `total` pixels inside `zone` of the contacts.
    """
    samples, owner, jacobian = _labeled(presses, contacts, zone, total)
    x, y = unit_position(samples.x_px, samples.y_px, samples.shape)
    design = polynomial_terms(samples.color_change, x, y, position_degrees)
    weight, moves = samples.weight, np.zeros((len(presses), 2))
    for _ in range(JOINT_REWEIGHTED):
        coefficients, moves = _solved(design, samples.gradients, weight, owner, jacobian, len(presses))
        moved = np.einsum("nkc,nc->nk", jacobian, moves[owner])
        error = np.linalg.norm(design @ coefficients - samples.gradients - moved, axis=1)
        weight = samples.weight * np.minimum(1, HUBER_SLOPE / np.maximum(error, 1e-12))
    limit = JOINT_MOVE_PX * scale_of(samples.shape)
    far = np.hypot(*moves.T)[:, None]
    return moves * np.minimum(1, limit / np.maximum(far, 1e-12))


def _labeled(
    presses: Sequence[PreparedPress], contacts: Sequence[ContactCircle], zone: float, total: int
) -> tuple[Samples, NDArray[np.intp], NDArray[np.float64]]:
    """Samples in the contacts and at rest, the press of each, and the derivative (N, 2, 2) of its label."""
    parts = [contact_samples([p], [c], zone, total=total // len(presses)) for p, c in zip(presses, contacts)]
    counts = [len(part.x_px) for part in parts]
    inside = joined(parts)
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
    """Coefficients (terms, 2) and moves (N, 2) that minimize `sum weight |design w - target - jacobian move|^2`."""
    normal, right = normal_equations(design, target, weight)
    # Definite by the ridge, and so is what it leaves of the moves, but for rounding: far below 1e-9.
    factor = scipy.linalg.cho_factor(normal + np.diag(JOINT_RIDGE * np.diag(normal) + 1e-12))
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
