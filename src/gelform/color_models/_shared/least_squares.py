"""Ridge regression with Huber weights, and polynomial terms that vary over the image."""

from __future__ import annotations

from itertools import combinations_with_replacement
from typing import Any

import numpy as np
from numpy.typing import NDArray

HUBER_SLOPE = 0.05
Normal = tuple[NDArray[np.float64], NDArray[np.float64]]


def monomials(channels: int, degree: int) -> list[tuple[int, ...]]:
    """Channel indices of every monomial of degree 1 to `degree`, lower degrees first.

    Each monomial of degree n is one of degree n - 1 times a last channel: (0, 0, 2) means c0 c0 c2.
    """
    terms: list[tuple[int, ...]] = []
    for n in range(1, degree + 1):
        terms += combinations_with_replacement(range(channels), n)
    return terms


def monomial_parents(terms: list[tuple[int, ...]]) -> NDArray[np.int32]:
    """Which monomial, times which channel, each one is: (terms, 2), as the kernels take it; -1 stands for 1."""
    number = {term: t for t, term in enumerate(terms)}
    return np.array([[number.get(term[:-1], -1), term[-1]] for term in terms], dtype=np.int32)


def position_powers(degree: int) -> list[tuple[int, int]]:
    """Exponents (i, j) of x^i y^j with i + j <= degree."""
    return [(i, j) for j in range(degree + 1) for i in range(degree + 1 - j)]


def term_count(channels: int, position_degrees: tuple[int, ...]) -> int:
    """How many columns `polynomial_terms` has."""
    terms = monomials(channels, len(position_degrees))
    return sum(len(position_powers(position_degrees[len(term) - 1])) for term in terms)


def unit_position(x_px: NDArray[Any], y_px: NDArray[Any], shape: tuple[int, int]) -> tuple[Any, Any]:
    """Positions about the image's centre in units of half its larger side."""
    height, width = shape
    half = max(height, width) / 2
    x = (np.asarray(x_px, dtype=np.float64) - (width - 1) / 2) / half
    y = (np.asarray(y_px, dtype=np.float64) - (height - 1) / 2) / half
    return x, y


def polynomial_terms(
    values: NDArray[Any], x: NDArray[Any], y: NDArray[Any], position_degrees: tuple[int, ...]
) -> NDArray[np.float64]:
    """Design matrix (N, terms): each monomial of degree n of the values, times the position terms of its degree.

    There is no constant term: values of zero give zero.
    """
    channels = np.asarray(values, dtype=np.float64).T
    place = position_terms(np.asarray(x), np.asarray(y), max(position_degrees))
    columns = np.empty((term_count(len(channels), position_degrees), channels.shape[1]))
    filled = 0
    terms = monomials(len(channels), len(position_degrees))
    for term, product in zip(terms, monomial_products(channels, terms)):
        for power in position_powers(position_degrees[len(term) - 1]):
            np.multiply(product, place[power], out=columns[filled])
            filled += 1
    return columns.T


def monomial_products(channels: NDArray[Any], terms: list[tuple[int, ...]]) -> list[NDArray[Any]]:
    """Each monomial (N,) of channels (C, N), a product of its parent's with one channel."""
    products: list[NDArray[Any]] = []
    for parent, channel in monomial_parents(terms):
        products.append(channels[channel] if parent < 0 else products[parent] * channels[channel])
    return products


def position_terms(
    x: NDArray[Any], y: NDArray[Any], degree: int
) -> dict[tuple[int, int], NDArray[np.float64]]:
    """x^i y^j by its exponents, each a product of one before it: powers take ten times as long."""
    place = {(0, 0): np.ones(len(x))}
    for i, j in position_powers(degree)[1:]:
        place[i, j] = place[i - 1, j] * x if i else place[i, j - 1] * y
    return place


def robust_ridge(
    design: NDArray[np.float64],
    target: NDArray[np.float64],
    weight: NDArray[np.float64],
    *,
    ridge: float,
    huber: float,
    rounds: int = 3,
) -> NDArray[np.float64]:
    """Coefficients (terms, outputs) of a ridge regression, reweighted by Huber's loss of the residual's length.

    The ridge is relative to the size of each column, so it means the same for every term.
    """
    whole = normal_equations(design, target, weight)
    total = float(weight.sum())
    size = np.sqrt(np.diag(whole[0]) / total) + 1e-12
    return _reweighted(design, target, weight, whole, np.diag(ridge * total * size**2), huber, rounds)


def penalised_huber(
    design: NDArray[Any],
    target: NDArray[np.float64],
    weight: NDArray[np.float64],
    penalties: NDArray[np.float64],
    *,
    huber: float,
    rounds: int = 3,
    whole: Normal | None = None,
) -> NDArray[np.float64]:
    """Coefficients (terms, outputs) of a regression with a ridge of its own for each column, in samples' mean weight.

    Reweighted by Huber's loss of the residual's length; the columns are taken as they are. `whole` are their normal
    equations, where they are known already.
    """
    prior = np.diag(penalties * float(weight.sum()))
    columns = np.asarray(design, dtype=np.float32)  # sums of squares; the ridge is far above their rounding
    whole = normal_equations(columns, target, weight) if whole is None else whole
    return _reweighted(columns, target, weight, whole, prior, huber, rounds)


def _reweighted(
    design: NDArray[Any],
    target: NDArray[np.float64],
    weight: NDArray[np.float64],
    whole: Normal,
    prior: NDArray[np.float64],
    huber: float,
    rounds: int,
) -> NDArray[np.float64]:
    """Coefficients (terms, outputs) that Huber's loss of the residual's length finds in so many rounds.

    Only samples beyond `huber` count less than at first, so what they lose is subtracted from `whole`, the normal
    equations of the first round.
    """
    normal, right = whole
    for done in range(1, rounds + 1):
        coefficients = np.linalg.solve(normal + prior, right)
        if done == rounds:
            break
        residual = np.linalg.norm(design @ coefficients.astype(design.dtype) - target, axis=1)
        beyond = np.flatnonzero(residual > huber)
        lost = weight[beyond] * (1 - huber / residual[beyond])
        less = normal_equations(_rows(design, beyond), target[beyond], lost)
        normal, right = whole[0] - less[0], whole[1] - less[1]
    return np.asarray(coefficients, dtype=np.float64)


def _rows(design: NDArray[Any], chosen: NDArray[np.intp]) -> NDArray[Any]:
    """Some rows of a design, in its own order in memory: gathered across it they take ten times as long."""
    return design[chosen] if design.flags.c_contiguous else np.take(design.T, chosen, axis=1).T


def normal_equations(
    design: NDArray[Any], target: NDArray[np.float64], weight: NDArray[np.float64]
) -> Normal:
    """Weighted sums of products: terms by terms, and terms by outputs."""
    root = np.sqrt(weight).astype(design.dtype)[:, None]
    weighted = design * root
    normal = (weighted.T @ weighted).astype(np.float64)  # of an array with itself: half the work
    return normal, weighted.T @ (root * target)
