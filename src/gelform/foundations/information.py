"""Symmetric information matrices: their inverses, and the directions that nothing determines."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gelform.arrays import Mask, Numbers

# Eigenvalue over the largest, of a matrix in units that make its entries alike. Sums of float32 products are right to
# 1e-7 of the largest; singular ones leave 1e-16 on one kind of processor and exactly 0 on the next.
LEAST_INFORMATION = 1e-10


def check_condition(matrices: Numbers, limit: float, expected: str, remedy: str) -> None:
    """Refuse matrices (..., n, n) of which one is singular or nearly so; ValueError with its condition number."""
    worst = float(np.linalg.cond(matrices).max())
    if not worst < limit:
        raise ValueError(
            f"Expected {expected}, got a matrix of condition number {worst:.3g} (limit {limit:g}). {remedy}"
        )


class Determined(NamedTuple):
    """What an information matrix (n, n) determines, from the least to the most determined direction."""

    covariance: Numbers  # (n, n) in the determined directions, 0 in the others
    directions: Numbers  # (n, n), a column each
    # (n,) bool, the directions with less than `LEAST_INFORMATION` of the largest information
    undetermined: Mask


def determined_by(information: Numbers, scale: Numbers | None = None) -> Determined:
    """The covariance of an information matrix (n, n), and its directions in units (n,), by default its own.

    The own unit of a parameter is its standard deviation if all the others are known.
    """
    if scale is None:
        own = np.diag(information)
        scale = 1 / np.sqrt(np.where(own > 0, own, 1.0))
    values, directions = np.linalg.eigh(scale[:, None] * information * scale)
    undetermined = ~(values > LEAST_INFORMATION * np.max(values, initial=0.0))
    directions = scale[:, None] * directions
    known = directions[:, ~undetermined]
    return Determined(known / values[~undetermined] @ known.T, directions, undetermined)
