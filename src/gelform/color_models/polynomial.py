"""Gradients as a polynomial in the colour change whose coefficients vary over the image.

The lights are near, so the effective light direction differs from place to place: each linear, quadratic and
cubic colour term carries a polynomial in (x, y) of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gelform.color_models._shared.least_squares import (
    HUBER_SLOPE,
    monomials,
    polynomial_terms,
    position_powers,
    robust_ridge,
    term_count,
    unit_position,
)
from gelform.color_models.seam import Samples, Variant, check_image_shape

MAX_POSITION_DEGREE = 5
# Position degrees that calibration tries, and the training presses that each needs.
DEGREES = (((1,), 3), ((2, 1), 6), ((3, 2, 0), 9), ((4, 3, 1), 18), ((5, 4, 3), 30))
MIN_PRESSES_FOR_LARGEST = 18


@dataclass(frozen=True)
class PolynomialModel:
    """Polynomial in (R, G, B, x, y) without a constant: no colour change, no slope.

    Attributes
    ----------
    coefficients : (terms, 2) float64
    position_degrees : degree in (x, y) of the linear, quadratic, cubic ... colour terms, such as (4, 3, 1)
    shape : (H, W) of the images it was fitted on
    """

    coefficients: NDArray[np.float64]
    position_degrees: tuple[int, ...]
    shape: tuple[int, int]

    name: ClassVar[str] = "polynomial"
    change_offset: ClassVar[float] = 10.0
    slow: ClassVar[bool] = False

    @classmethod
    def fit(
        cls, samples: Samples, *, position_degrees: tuple[int, ...] = (4, 3, 1), ridge: float = 1e-5
    ) -> PolynomialModel:
        """Robust ridge regression of the gradients on the colour terms; position degrees up to 5."""
        if not position_degrees or not all(0 <= degree <= MAX_POSITION_DEGREE for degree in position_degrees):
            raise ValueError(f"Expected position degrees of 0-{MAX_POSITION_DEGREE}, got {position_degrees}.")
        x, y = unit_position(samples.x_px, samples.y_px, samples.shape)
        design = polynomial_terms(samples.color_change, x, y, position_degrees)
        coefficients = robust_ridge(design, samples.gradients, samples.weight, ridge=ridge, huber=HUBER_SLOPE)
        return cls(coefficients, tuple(position_degrees), samples.shape)

    @classmethod
    def variants(cls, presses: int) -> list[Variant]:
        """Each set of degrees that so many presses can carry.

        `auto` tries the plainest, and the largest from 18 presses on; those between are left to `hierarchical`,
        which is as stiff where they have few terms.
        """
        carried = [degrees for degrees, needed in DEGREES if presses >= needed] or [DEGREES[0][0]]
        in_auto = [carried[0], carried[-1]] if presses >= MIN_PRESSES_FOR_LARGEST else [carried[0]]
        return [
            Variant(term_count(3, degrees), {"position_degrees": degrees}, degrees in in_auto)
            for degrees in carried
        ]

    def gradients_at(
        self, color_change: NDArray[Any], x_px: NDArray[Any], y_px: NDArray[Any]
    ) -> NDArray[np.float64]:
        """Gradients (N, 2) of scattered pixels."""
        x, y = unit_position(x_px, y_px, self.shape)
        gradients: NDArray[np.float64] = (
            polynomial_terms(color_change, x, y, self.position_degrees) @ self.coefficients
        )
        return gradients

    def prepare(self, background: NDArray[Any], shape: tuple[int, int]) -> PreparedPolynomial:
        """Coefficients of each row as polynomials in x, so that a frame is a few products per pixel."""
        check_image_shape(shape, self.shape)
        return PreparedPolynomial(self)

    def to_arrays(self) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Coefficients, and the degrees that order them."""
        settings = {"position_degrees": list(self.position_degrees), "shape": list(self.shape)}
        return {"coefficients": self.coefficients}, settings

    @classmethod
    def from_arrays(cls, arrays: dict[str, NDArray[Any]], settings: dict[str, Any]) -> PolynomialModel:
        """The model of `to_arrays`."""
        height, width = settings["shape"]
        return cls(arrays["coefficients"], tuple(settings["position_degrees"]), (height, width))


class PreparedPolynomial:
    """The polynomial with its position terms worked out per row; immutable, shared by threads."""

    def __init__(self, model: PolynomialModel) -> None:
        height, width = model.shape
        terms = monomials(3, len(model.position_degrees))
        columns = 3 * (max(model.position_degrees) // 3 + 1)  # _add_powers takes three at a time
        x, y = unit_position(np.arange(width), np.arange(height), model.shape)
        table = np.zeros((height, 2, len(terms), columns))
        row = 0
        for t, term in enumerate(terms):
            for i, j in position_powers(model.position_degrees[len(term) - 1]):
                table[:, :, t, i] += y[:, None] ** j * model.coefficients[row]
                row += 1
        self._x = x.astype(np.float32)
        self._table = table.astype(np.float32)
        self._degrees = np.array([model.position_degrees[len(t) - 1] for t in terms])
        index = {term: t for t, term in enumerate(terms)}
        self._parents = np.array([[index.get(term[:-1], -1), term[-1]] for term in terms])

    def gradients_from_color(self, color_change: NDArray[np.float32]) -> tuple[NDArray[np.float32], None]:
        """Gradients (H, W, 2) of a color change (H, W, 3); their deviation is the calibration's."""
        gradients = np.empty((*color_change.shape[:2], 2), dtype=np.float32)
        _evaluate(color_change, self._x, self._table, self._degrees, self._parents, gradients)
        return gradients, None


@njit(cache=True, fastmath=True, nogil=True)
def _evaluate(change, x, table, degrees, parents, out):  # type: ignore[no-untyped-def]
    """Row by row: monomials of the colour, each times a Horner polynomial in x, summed into both slopes."""
    height, width, _ = change.shape
    color = np.empty((3, width), np.float32)
    products = np.empty((degrees.shape[0], width), np.float32)
    p = np.empty(width, np.float32)
    q = np.empty(width, np.float32)
    for y in range(height):
        for k in range(width):
            color[0, k], color[1, k], color[2, k] = change[y, k, 0], change[y, k, 1], change[y, k, 2]
            p[k] = 0
            q[k] = 0
        for t in range(degrees.shape[0]):
            _multiply(products, parents[t, 0], color, parents[t, 1], t)
            for a in range(0, degrees[t] + 1, 3):
                _add_powers(table[y, 0, t], table[y, 1, t], a, x, products[t], p, q)
        for k in range(width):
            out[y, k, 0] = p[k]
            out[y, k, 1] = q[k]


@njit(cache=True, fastmath=True, nogil=True, inline="always")
def _multiply(products, parent, color, channel, t):  # type: ignore[no-untyped-def]
    """products[t] = products[parent] * color[channel], or the colour itself."""
    for k in range(color.shape[1]):
        products[t, k] = color[channel, k] if parent < 0 else products[parent, k] * color[channel, k]


@njit(cache=True, fastmath=True, nogil=True)
def _add_powers(cp, cq, start, x, m, p, q):  # type: ignore[no-untyped-def]
    """p, q += m * x^start (c0 + c1 x + c2 x^2): three powers at a time keep the loop unrolled and vectorised."""
    p0, p1, p2 = cp[start], cp[start + 1], cp[start + 2]
    q0, q1, q2 = cq[start], cq[start + 1], cq[start + 2]
    for k in range(x.shape[0]):
        v = x[k]
        base = m[k] if start == 0 else m[k] * v * v * v
        p[k] += base * (p0 + v * (p1 + v * p2))
        q[k] += base * (q0 + v * (q1 + v * q2))
