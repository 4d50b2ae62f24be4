"""Gradients as a polynomial in the color change whose coefficients vary over the image, freely or hierarchically.

The lights are near, so the effective light direction differs from place to place. Therefore each linear, quadratic and
cubic color term has its own polynomial in (x, y): free in `PolynomialModel`.

A press shows few slopes at few places, so a free polynomial in (color, x, y) invents the rest. In `HierarchicalModel` each
coefficient is a sum of Legendre polynomials of the place and of the light there (the logarithm of the background image,
which shows how near the lamps are). A ridge grows with the degree, so that the model stays simple where presses show
nothing (A. E. Hoerl and R. W. Kennard, Technometrics 12(1), 1970, with a prior variance per term).

Beyond the colors of the presses a cubic soon gives any slope. So slopes are bounded by the steepest of the training, with a
margin, and what lies beyond is their standard deviation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from gelform._native import Kernel
from gelform.arrays import Array, Map, Numbers, Slopes
from gelform.foundations.checks import HIGHEST_SLOPE, check_within
from gelform.foundations.filters import CHANGE_OFFSET
from gelform.image.background import PendingChange
from gelform.slopes.color_models.seam import (
    HUBER_SLOPE,
    NODE_PX,
    Samples,
    Stored,
    VaryingRegression,
    at_pixels,
    check_image_shape,
    interpolation,
    monomial_parents,
    monomial_products,
    monomials,
    nodes_at_scale,
    polynomial_terms,
    position_powers,
    position_terms,
    robust_ridge,
    terms_of_orders,
    unit_position,
)

# Position degrees that calibration tries, and the accepted presses that each needs.
DEGREES = (((1,), 3), ((2, 1), 6), ((3, 2, 0), 9), ((4, 3, 1), 18), ((5, 4, 3), 30))
MAX_POSITION_DEGREE = DEGREES[-1][0][0]

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


RIDGES = (3e-3, 1e-3, 3e-4, 1e-4, 3e-5, 1e-5)  # ridges that calibration tries, the stiffest first

_hierarchical_gradients = Kernel(
    "hierarchical_gradients",
    "f32[h,w,3] change, f32[r,c,t,2] nodes, i32[t,2] parents, out f32[n] work, out f32[h,w,2] gradients, f32 most",
)
_hierarchical_from_image = Kernel(
    "hierarchical_from_image",
    "u8[h,w,3]? image, f32[h,w,3]? light, f32[s] scale, f32[h,w,3] untouched, f32[h,w,3] gain, f32[k] taps, "
    "f32[r,c,t,2] nodes, i32[t,2] parents, out f32[n] work, out f32[h,w,3] change, out f32[h,w,2] gradients, f32 most",
)


@dataclass(frozen=True)
class HierarchicalModel(Stored):
    """Polynomial in (R, G, B) without a constant; its coefficients are given at nodes and bilinear between them."""

    nodes: Numbers  # (rows, columns, terms, 2), coefficients at every 16th pixel, the last beyond the border
    degree: int  # of the polynomial in color
    shape: tuple[int, int]  # (H, W) of the images it was fitted on
    steepest: float = HIGHEST_SLOPE  # mm/mm, the size that slopes are bounded to, if at all

    name: ClassVar[str] = "hierarchical"
    change_offset: ClassVar[float] = CHANGE_OFFSET

    def __post_init__(self) -> None:
        check_within(self.steepest, "steepest", 1e-12, HIGHEST_SLOPE)

    @classmethod
    def fit(
        cls,
        samples: Samples,
        *,
        position_degrees: tuple[int, ...] = DEGREES[-1][0],
        ridge: float = RIDGES[2],
        start: HierarchicalModel | None = None,
    ) -> HierarchicalModel:
        """Penalized least squares; of samples with `background`, the light at each place is used too.

        `position_degrees` are those in (x, y) of the linear, quadratic, cubic color terms. They may be large, since the
        ridge is 4 times stronger per degree in place and 3 times per degree in color. `ridge` > 0 is that of a coefficient
        which is the same everywhere, relative to the samples' weight, for a color change of RMS 1. With the `start` of
        another unit of the sensor, the coefficients are pulled to its own instead of to 0.
        """
        if not position_degrees or min(position_degrees) < 0 or not ridge > 0:
            raise ValueError(f"Expected position degrees >= 0, ridge > 0, got {position_degrees}, {ridge}.")
        if start is not None:
            start.check_like(len(position_degrees), samples.shape)
        regression, scales = _regression(samples, tuple(position_degrees), start)
        nodes = regression.nodes(regression.coefficients(ridge)) / scales[:, None]
        # On a wedge with three presses, whose border was read with slopes of 47, bounds of 2-2.5 times the steepest training
        # slope leave 69-71 of 93 frames one contact, 1.25-1.5 46-53, none 32. On six other sensors errors stay or fall at 2.
        steepest = 2 * float(np.linalg.norm(samples.gradients, axis=1).max()) + 1e-12
        if start is not None:
            nodes, steepest = nodes + start.nodes, max(steepest, start.steepest)
        return cls(nodes, len(position_degrees), samples.shape, steepest)

    @classmethod
    def average(cls, models: Sequence[HierarchicalModel], shares: Sequence[float]) -> HierarchicalModel:
        """As `StartableModel.average`."""
        first = models[0]
        for model in models:
            model.check_like(first.degree, first.shape)
        nodes = np.average([model.nodes for model in models], axis=0, weights=shares)
        return cls(nodes, first.degree, first.shape, max(model.steepest for model in models))

    @classmethod
    def variants(cls, presses: int) -> list[dict[str, Any]]:
        """One variant for each ridge, the stiffest first."""
        return [{"ridge": ridge} for ridge in RIDGES]

    def of_other_unit(self, gain: Numbers, wider: float) -> HierarchicalModel:
        """As `StartableModel.of_other_unit`."""
        factors = [gain[..., list(term)].prod(axis=-1) for term in monomials(3, self.degree)]
        nodes = nodes_at_scale(self.nodes, self.shape, wider)
        return replace(self, nodes=nodes * np.stack(factors, axis=-1)[..., None])

    def at_size(self, shape: tuple[int, int], wider: float) -> HierarchicalModel:
        """As `ColorModel.at_size`."""
        return replace(self, nodes=nodes_at_scale(self.nodes, self.shape, wider, shape), shape=shape)

    def check_like(self, degree: int, shape: tuple[int, int]) -> None:
        """Raise a ValueError if a model of a degree and an image shape cannot start from this one."""
        if (self.degree, tuple(self.shape)) != (degree, tuple(shape)):
            raise ValueError(
                f"Expected to start from a model of degree {degree} for images of {shape[0]}x{shape[1]} px, got one of "
                f"degree {self.degree} for {self.shape[0]}x{self.shape[1]} px."
            )

    def gradients_at(self, color_change: Array, x_px: Array, y_px: Array) -> Numbers:
        """Gradients (N, 2) of scattered pixels."""
        change = np.asarray(color_change, dtype=np.float64)
        products = np.stack(monomial_products(change.T, monomials(3, self.degree)))
        gradients: Numbers = np.einsum("tn,ntk->nk", products, self.coefficients_at(x_px, y_px))
        bounded(gradients, self.steepest)
        return gradients

    def coefficients_at(self, x_px: Array, y_px: Array) -> Numbers:
        """Coefficients (N, terms, 2) of each monomial of the color change at pixels."""
        return at_pixels(self.nodes, *interpolation(x_px, y_px, self.shape))

    def prepare(self, background: Array, shape: tuple[int, int]) -> PreparedHierarchical:
        """Prepare the coefficients of every row of pixels at every 16th column."""
        check_image_shape(shape, self.shape)
        return PreparedHierarchical(self)


def bounded(gradients: Array, steepest: float) -> Map | None:
    """Shorten gradients (..., 2) to a size, in place; returns what was cut off, (..., 2) for both components, or None."""
    square = np.einsum("...c,...c->...", gradients, gradients)
    if square.max() <= steepest**2:
        return None
    size = np.sqrt(square)[..., np.newaxis]
    gradients *= np.minimum(1, steepest / np.maximum(size, steepest))
    return np.repeat(np.maximum(size - steepest, 0).astype(np.float32), 2, axis=-1)


def _regression(
    samples: Samples, position_degrees: tuple[int, ...], start: HierarchicalModel | None
) -> tuple[VaryingRegression, Numbers]:
    """The regression of samples on the monomials of their color change, and the divisor of each monomial (terms,).

    The samples keep the last one, because calibration tries one ridge after the other.
    """
    kept = samples.shared.get(HierarchicalModel.name)
    if kept is not None and kept[0] is start and kept[1] == position_degrees:
        regression, scales = kept[2:]
        return regression, scales
    change = np.asarray(samples.color_change, dtype=np.float64)
    terms = monomials(3, len(position_degrees))
    scale = float(np.sqrt(np.average(np.mean(change**2, axis=1), weights=samples.weight))) + 1e-12
    orders = [len(term) for term in terms]
    products = terms_of_orders(monomial_products((change / scale).T, terms), orders, position_degrees)
    target = np.asarray(samples.gradients, dtype=np.float64)
    if start is not None:
        target = target - start.gradients_at(samples.color_change, samples.x_px, samples.y_px)
    regression = VaryingRegression.of(products, target, samples)
    scales = scale ** np.array(orders, dtype=np.float64)
    samples.shared[HierarchicalModel.name] = start, position_degrees, regression, scales
    return regression, scales


class PreparedHierarchical:
    """The coefficients at the nodes, in the form of the kernels. It is immutable; threads can share it."""

    def __init__(self, model: HierarchicalModel) -> None:
        self._nodes, self._steepest = np.ascontiguousarray(model.nodes, dtype=np.float32), model.steepest
        self._parents = monomial_parents(monomials(3, model.degree))
        # Nearly always no component exceeds it, so that no slope is too steep.
        self._small = model.steepest / 2**0.5
        _, columns, terms, _ = self._nodes.shape
        self._work_size = 2 * columns * terms + 4 * terms + 3 * -(-model.shape[1] // NODE_PX) * NODE_PX

    def gradients_from_color(self, color_change: Map) -> tuple[Slopes, Slopes | None]:
        """Gradients (H, W, 2) of a color change (H, W, 3), and the deviation of bounded ones, or None."""
        gradients = np.empty((*color_change.shape[:2], 2), dtype=np.float32)
        work = np.empty(self._work_size, dtype=np.float32)
        beyond = _hierarchical_gradients(
            color_change, self._nodes, self._parents, work, gradients, self._small
        )
        return gradients, bounded(gradients, self._steepest) if beyond else None

    def gradients_in_one_pass(self, pending: PendingChange, out: Map) -> tuple[Slopes, Slopes | None]:
        """The same of an image, whose color change is computed in the same pass and written to `out` (H, W, 3)."""
        gradients = np.empty((*out.shape[:2], 2), dtype=np.float32)
        work = np.empty(pending.work_size + self._work_size, dtype=np.float32)
        beyond = _hierarchical_from_image(
            *pending.arguments, self._nodes, self._parents, work, out, gradients, self._small
        )
        return gradients, bounded(gradients, self._steepest) if beyond else None
