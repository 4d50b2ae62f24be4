"""Gradients as a polynomial in the color change whose coefficients vary over the image.

The lights are near, so the effective light direction differs from place to place. Therefore each linear, quadratic and
cubic color term has its own polynomial in (x, y).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from gelform._native import Kernel
from gelform.arrays import Array, Map, Numbers, Slopes
from gelform.foundations.filters import CHANGE_OFFSET
from gelform.slopes.color_models.least_squares import (
    HUBER_SLOPE,
    monomial_parents,
    monomials,
    polynomial_terms,
    position_powers,
    position_terms,
    robust_ridge,
    unit_position,
)
from gelform.slopes.color_models.seam import Samples, Stored, check_image_shape

MAX_POSITION_DEGREE = 5  # 21 functions of the place
# Position degrees that calibration tries, and the accepted presses that each needs.
DEGREES = (((1,), 3), ((2, 1), 6), ((3, 2, 0), 9), ((4, 3, 1), 18), ((5, 4, 3), 30))

_polynomial_gradients = Kernel(
    "polynomial_gradients",
    "f32[h,w,3] change, f32[w] x, f32[h,2,t,c] table, i32[t] degrees, i32[t,2] parents, out f32[n] work, "
    "out f32[h,w,2] gradients",
)


@dataclass(frozen=True)
class PolynomialModel(Stored):
    """Polynomial in (R, G, B, x, y) without a constant: no color change, no slope."""

    coefficients: Numbers  # (terms, 2)
    position_degrees: tuple[int, ...]  # in (x, y), of the linear, quadratic, cubic ... color terms
    shape: tuple[int, int]  # (H, W) of the images it was fitted on

    name: ClassVar[str] = "polynomial"
    change_offset: ClassVar[float] = CHANGE_OFFSET

    @classmethod
    def fit(
        cls, samples: Samples, *, position_degrees: tuple[int, ...] = (4, 3, 1), ridge: float = 1e-5
    ) -> PolynomialModel:
        """Robust ridge regression of the gradients on the color terms; position degrees up to 5."""
        if not position_degrees or not all(0 <= degree <= MAX_POSITION_DEGREE for degree in position_degrees):
            raise ValueError(f"Expected position degrees of 0-{MAX_POSITION_DEGREE}, got {position_degrees}.")
        x, y = unit_position(samples.x_px, samples.y_px, samples.shape)
        design = polynomial_terms(samples.color_change, x, y, position_degrees)
        coefficients = robust_ridge(design, samples.gradients, samples.weight, ridge=ridge, huber=HUBER_SLOPE)
        return cls(coefficients, tuple(position_degrees), samples.shape)

    @classmethod
    def variants(cls, presses: int) -> list[dict[str, Any]]:
        """Each set of degrees that a number of presses can support, the smallest first."""
        carried = [degrees for degrees, needed in DEGREES if presses >= needed] or [DEGREES[0][0]]
        return [{"position_degrees": degrees} for degrees in carried]

    def gradients_at(self, color_change: Array, x_px: Array, y_px: Array) -> Numbers:
        """Gradients (N, 2) of scattered pixels."""
        x, y = unit_position(x_px, y_px, self.shape)
        gradients: Numbers = polynomial_terms(color_change, x, y, self.position_degrees) @ self.coefficients
        return gradients

    @property
    def degree(self) -> int:
        """Degree of the polynomial in color."""
        return len(self.position_degrees)

    def coefficients_at(self, x_px: Array, y_px: Array) -> Numbers:
        """Coefficients (N, terms, 2) of each monomial of the color change at pixels."""
        x, y = unit_position(x_px, y_px, self.shape)
        place = position_terms(x, y, max(self.position_degrees))
        degrees = [self.position_degrees[len(term) - 1] for term in monomials(3, self.degree)]
        own = np.split(self.coefficients, np.cumsum([len(position_powers(d)) for d in degrees])[:-1])
        maps = [
            np.stack([place[power] for power in position_powers(degree)], axis=1) @ part
            for degree, part in zip(degrees, own)
        ]
        return np.stack(maps, axis=1)

    def prepare(self, background: Array, shape: tuple[int, int]) -> PreparedPolynomial:
        """Prepare the coefficients of each row as polynomials in x, so that a frame takes a few products per pixel."""
        check_image_shape(shape, self.shape)
        return PreparedPolynomial(self)


class PreparedPolynomial:
    """The polynomial with its position terms computed per row. It is immutable; threads can share it."""

    def __init__(self, model: PolynomialModel) -> None:
        height, width = model.shape
        terms = monomials(3, len(model.position_degrees))
        columns = max(model.position_degrees) + 1
        x, y = unit_position(np.arange(width), np.arange(height), model.shape)
        table = np.zeros((height, 2, len(terms), columns))
        row = 0
        for t, term in enumerate(terms):
            for i, j in position_powers(model.position_degrees[len(term) - 1]):
                table[:, :, t, i] += y[:, None] ** j * model.coefficients[row]
                row += 1
        self._x = x.astype(np.float32)
        self._table = table.astype(np.float32)
        self._degrees = np.array([model.position_degrees[len(t) - 1] for t in terms], dtype=np.int32)
        self._parents = monomial_parents(terms)

    def gradients_from_color(self, color_change: Map) -> tuple[Slopes, None]:
        """Gradients (H, W, 2) of a color change (H, W, 3); their deviation is in the calibration."""
        height, width, _ = color_change.shape
        gradients = np.empty((height, width, 2), dtype=np.float32)
        # For 16 pixels of a row at a time, as in native/slopes/color_models/polynomial.c.
        work = np.empty(6 * (width + 16), dtype=np.float32)
        tables = self._x, self._table, self._degrees, self._parents
        _polynomial_gradients(color_change, *tables, work, gradients)
        return gradients, None
