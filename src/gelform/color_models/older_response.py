"""Forward responses of calibrations before format 3, translated: polynomials of the slopes, or of normal and depth."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.color_models._shared.least_squares import (
    monomial_products,
    monomials,
    position_powers,
    term_count,
    unit_position,
)
from gelform.color_models._shared.nodes import node_positions
from gelform.color_models.forward_response import (
    DEPTH_UNIT_PX,
    NORMAL_UNIT,
    TERMS,
    ForwardResponse,
    normal_terms,
)

DEPTH_DEGREE = 3  # in place, of the depth's terms
STEEPEST = 0.7  # mm/mm, to which polynomials of slopes are translated: what presses of balls show


def older_response(
    arrays: dict[str, NDArray[Any]], settings: dict[str, Any], shape: tuple[int, int], mm_per_px: float | None
) -> ForwardResponse:
    """The response without a step: it renders, says what a fault is, and reads no slopes.

    Parameters
    ----------
    arrays : `coefficients` (terms, 3), of the slopes and, behind them, of normal and depth; `noise` (3,)
    settings : `position_degrees`, and `held_out_noise`, the RMS of the channels' noise on held-out presses, if known
    shape : (H, W)
    mm_per_px : of the calibration; depths were in mm
    """
    coefficients, degrees = np.asarray(arrays["coefficients"]), tuple(settings["position_degrees"])
    noise = np.maximum(np.asarray(arrays["noise"], dtype=np.float64), 1e-6)
    count, terms = term_count(2, degrees), monomials(2, len(degrees))
    knows_depth = len(coefficients) > count and mm_per_px is not None
    rows, columns = node_positions(shape)
    x, y = unit_position(columns[None, :], rows[:, None], shape)

    def at_nodes(first: int, degree: int) -> NDArray[np.float64]:
        powers = position_powers(degree)
        return np.asarray(
            sum((x**i * y**j)[..., None] * c for (i, j), c in zip(powers, coefficients[first:]))
        )

    nodes, first = np.zeros((len(rows), len(columns), TERMS, 3)), count if knows_depth else 0
    for t, term in enumerate(terms):
        degree = degrees[len(term) - 1]
        nodes[:, :, t] = at_nodes(first, degree) * (NORMAL_UNIT ** len(term) if knows_depth else 1)
        first += len(position_powers(degree))
    if knows_depth and mm_per_px is not None:
        nodes[:, :, -3] = at_nodes(first, DEPTH_DEGREE) * DEPTH_UNIT_PX * mm_per_px
    else:
        of_slopes = nodes[:, :, : len(terms)].copy()
        nodes[:, :, : TERMS - 3] = np.einsum("ts,rcsk->rctk", _normal_from_slope_terms(terms), of_slopes)
    usual = float(np.sqrt(np.mean(noise**2)))
    scale = max(float(settings.get("held_out_noise") or 0.0) / usual, 1.0) ** 2
    return ForwardResponse(nodes, np.diag(noise**2), shape, residual_scale=scale)


def _normal_from_slope_terms(terms: list[tuple[int, ...]]) -> NDArray[np.float64]:
    """(14, terms): coefficients of the normal's monomials that give each monomial of the slopes best, up to `STEEPEST`."""
    p, q = (axis.ravel() for axis in np.meshgrid(*(np.linspace(-STEEPEST, STEEPEST, 21),) * 2))
    slopes = np.stack([p, q])[:, np.hypot(p, q) <= STEEPEST]
    of_normal = np.stack(monomial_products(normal_terms(slopes.T).T, monomials(2, 4)), axis=1)
    return np.asarray(
        np.linalg.lstsq(of_normal, np.stack(monomial_products(slopes, terms), axis=1), rcond=None)[0]
    )
