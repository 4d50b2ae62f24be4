"""Coefficients at nodes of a coarse grid, bilinear between them: fitted to samples, and looked up at pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.color_models._shared.least_squares import (
    Normal,
    monomial_products,
    normal_equations,
    penalised_huber,
    position_powers,
)
from gelform.color_models.seam import Samples

NODE_PX = 16
LIGHT_BLUR_PX = 8.0  # of the untouched image: lamps are broad
PLACE_GROWTH = 4.0  # of the ridge, per degree in place
ORDER_GROWTH = 3.0  # of the ridge, per degree of the term
LIGHT_RIDGE = 4.0  # of the untouched image's logarithm, which only terms of the first two orders vary with
LIGHT_ORDERS = 2
DARKEST = 1.0  # grey level
MAX_SAMPLES = 20_000


@dataclass(frozen=True, eq=False)
class Term:
    """A column of a regression whose coefficient varies over the image.

    Attributes
    ----------
    values : (N,)
    place_degree : of the Legendre polynomials of the place that its coefficient is a sum of
    ridge : of a coefficient that is the same everywhere, relative to the regression's
    varies_with_light : whether the coefficient is a sum of the untouched image's logarithm too
    """

    values: NDArray[Any]
    place_degree: int
    ridge: float
    varies_with_light: bool = False


def terms_of_orders(
    products: Sequence[NDArray[Any]], orders: Sequence[int], place_degrees: Sequence[int]
) -> list[Term]:
    """Terms of products (N,) of so many factors, the stiffer the higher their order; `place_degrees` by order."""
    return [
        Term(product, place_degrees[order - 1], ORDER_GROWTH ** (order - 1), order <= LIGHT_ORDERS)
        for product, order in zip(products, orders)
    ]


@dataclass(frozen=True, eq=False)
class VaryingRegression:
    """Penalised Huber regression on terms whose coefficients vary over the image; one set of columns, any ridge.

    Attributes
    ----------
    columns : (N, columns) float32
    target : (N, K) float64
    weight : (N,)
    penalties : (columns,), of their ridges
    ends : where each term's columns end
    places : of each term: its functions at the nodes, (rows, columns, functions)
    huber : residual from which a sample counts less
    """

    columns: NDArray[np.float32]
    target: NDArray[np.float64]
    weight: NDArray[np.float64]
    penalties: NDArray[np.float64]
    ends: NDArray[np.intp]
    places: tuple[NDArray[np.float64], ...]
    huber: float

    @classmethod
    def of(
        cls, terms: Sequence[Term], target: NDArray[Any], samples: Samples, *, huber: float
    ) -> VaryingRegression:
        """Terms (N,) and target (N, K) of samples; at most some 20,000 of them: neighbours in a press are copies."""
        step = max(1, round(len(samples.x_px) / MAX_SAMPLES))
        light = None if samples.background is None else light_at_nodes(samples.background)
        at = interpolation(samples.x_px[::step], samples.y_px[::step], samples.shape)
        made: dict[Any, tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]] = {}
        for term in terms:
            kind = term.place_degree, term.varies_with_light
            if kind not in made:
                functions, growth = _places(*kind, samples.shape, light)
                made[kind] = functions, growth, at_pixels(functions, *at)
        kinds = [made[term.place_degree, term.varies_with_light] for term in terms]
        ends = np.cumsum([len(growth) for _, growth, _ in kinds])
        columns = np.empty((len(samples.x_px[::step]), ends[-1]), dtype=np.float32)
        for term, (_, _, there), part in zip(terms, kinds, np.split(columns, ends[:-1], axis=1)):
            np.multiply(there, np.asarray(term.values)[::step, None], out=part, casting="same_kind")
        penalties = np.concatenate([term.ridge * growth for term, (_, growth, _) in zip(terms, kinds)])
        own_target, weight = np.asarray(target, dtype=np.float64)[::step], samples.weight[::step]
        return cls(columns, own_target, weight, penalties, ends, tuple(kind[0] for kind in kinds), huber)

    @cached_property
    def _normal(self) -> Normal:
        return normal_equations(self.columns, self.target, self.weight)

    def coefficients(self, ridge: float) -> NDArray[np.float64]:
        """Coefficients (columns, K) that a ridge finds."""
        return penalised_huber(
            self.columns,
            self.target,
            self.weight,
            ridge * self.penalties,
            huber=self.huber,
            whole=self._normal,
        )

    def nodes(self, coefficients: NDArray[np.float64]) -> NDArray[np.float64]:
        """The terms' coefficients at the nodes, (rows, columns, terms, K)."""
        split = np.split(coefficients, self.ends[:-1])
        return np.stack([place @ part for place, part in zip(self.places, split)], axis=2)

    def residual(self, coefficients: NDArray[np.float64]) -> NDArray[np.float64]:
        """Target minus what the coefficients give, (N, K)."""
        return np.asarray(self.target - self.columns @ coefficients.astype(np.float32), dtype=np.float64)


def node_positions(shape: tuple[int, int]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of the nodes, px; the last is at the border or beyond."""
    rows, columns = (np.arange(-(-(n - 1) // NODE_PX) + 1 + (n == 1)) * NODE_PX for n in shape)
    return rows, columns


def _places(
    degree: int, with_light: bool, shape: tuple[int, int], light: NDArray[Any] | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What a coefficient is a sum of at the nodes, (rows, columns, functions), and by how much each is penalised."""
    unit = [
        2 * nodes / (n - 1) - 1 if n > 1 else 0.0 * nodes for nodes, n in zip(node_positions(shape), shape)
    ]
    size = np.sqrt(2 * np.arange(degree + 1) + 1)
    along_y, along_x = (np.polynomial.legendre.legvander(u, degree) * size for u in unit)
    powers = position_powers(degree)
    functions = [along_y[:, None, j] * along_x[None, :, i] for i, j in powers]
    growth = [PLACE_GROWTH ** (i + j) for i, j in powers]
    if with_light and light is not None:
        functions += list(light)
        growth += [LIGHT_RIDGE] * 3
    return np.stack(functions, axis=-1), np.array(growth)


def light_at_nodes(background: NDArray[Any]) -> NDArray[np.float64]:
    """Logarithm of the untouched image at the nodes, (3, rows, columns), of mean 0 and deviation 1."""
    pixels = np.asarray(background, dtype=np.float32)
    return _light_of_pixels(pixels.tobytes(), pixels.shape)


@lru_cache(maxsize=4)  # a calibration fits a hundred models on one background
def _light_of_pixels(pixels: bytes, shape: tuple[int, ...]) -> NDArray[np.float64]:
    light = np.maximum(np.frombuffer(pixels, dtype=np.float32).reshape(shape), DARKEST)
    smooth = cv2.GaussianBlur(light, (0, 0), LIGHT_BLUR_PX, borderType=cv2.BORDER_REFLECT_101)
    logarithm = np.log(smooth.astype(np.float64))
    logarithm -= logarithm.mean(axis=(0, 1))
    deviation = logarithm.std(axis=(0, 1))
    rows, columns = (
        np.minimum(n, limit - 1) for n, limit in zip(node_positions(light.shape[:2]), light.shape)
    )
    values = logarithm[np.ix_(rows, columns)] / np.maximum(deviation, 0.01)  # even light tells nothing
    return np.moveaxis(values, -1, 0)


def colour_products(change: NDArray[np.float64], terms: list[tuple[int, ...]]) -> NDArray[np.float64]:
    """Monomials (terms, N) of a colour change (N, 3)."""
    return np.stack(monomial_products(np.ascontiguousarray(change.T), terms))


def interpolation(x_px: NDArray[Any], y_px: NDArray[Any], shape: tuple[int, int]) -> tuple[Any, ...]:
    """The node above left of each pixel, and how far on towards the next it lies, 0-1."""
    found: list[Any] = []
    for position, nodes in zip((y_px, x_px), node_positions(shape)):
        along = np.asarray(position, dtype=np.float64) / NODE_PX
        before = np.clip(along.astype(np.intp), 0, len(nodes) - 2)
        found += [before, along - before]
    return tuple(found)


def at_pixels(nodes: NDArray[Any], row: Any, v: Any, column: Any, u: Any) -> NDArray[np.float64]:
    """Values (N, ...) between the nodes, bilinear."""
    v, u = (part.reshape(-1, *[1] * (nodes.ndim - 2)) for part in (v, u))
    above = nodes[row, column] * (1 - u) + nodes[row, column + 1] * u
    below = nodes[row + 1, column] * (1 - u) + nodes[row + 1, column + 1] * u
    values: NDArray[np.float64] = above * (1 - v) + below * v
    return values
