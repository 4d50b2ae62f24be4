"""All centres and the color model at once: the step that alternating between them takes in many small ones.

A color model whose coefficients vary over the image follows much of a wrong centre, so moving centres to agree with
it and fitting it again converges slowly. Here the labels are linear in small moves of their centres, and model and moves
are solved together (variable projection, G. Golub and V. Pereyra, SIAM J. Numer. Anal. 10, 1973), the model eliminated.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy  # its parts load at first use
from numpy.typing import NDArray

from gelform.ball import center_jacobian
from gelform.calibration.circles.find import ContactCircle, scale_of
from gelform.calibration.circles.samples import PreparedPress, contact_samples, with_rest_samples
from gelform.color_models import Samples
from gelform.color_models._shared.least_squares import (
    HUBER_SLOPE,
    normal_equations,
    polynomial_terms,
    unit_position,
)

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
