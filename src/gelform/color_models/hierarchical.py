"""Gradients as a polynomial in the colour change, its coefficients shrunk the more they vary over the image.

A press shows few slopes at few places, so a free polynomial in (colour, x, y) invents the rest. Here each
coefficient is a sum of Legendre polynomials of the place and of the light that falls there (the logarithm of the
untouched image, which tells how near the lamps are), and a ridge grows with the degree: what the presses do not
show stays as simple as it can be (A. E. Hoerl and R. W. Kennard, Technometrics 12(1), 1970, with a prior variance
per term).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, ClassVar

import cv2
import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.color_models._shared.least_squares import (
    HUBER_SLOPE,
    monomial_parents,
    monomial_products,
    monomials,
    penalised_huber,
    position_powers,
)
from gelform.color_models.seam import PendingChange, Samples, Variant, check_image_shape

NODE_PX = 16
LIGHT_BLUR_PX = 8.0
PLACE_GROWTH = 4.0
COLOR_GROWTH = 3.0
LIGHT_RIDGE = (3.0, 10.0)
DARKEST = 1.0
MAX_SAMPLES = 20_000
# Ridges that calibration tries, and the coefficients that each leaves free (the trace of the regression's hat matrix) on
# ten presses of a GelSight Mini.
RIDGES = {3e-4: 95.0, 1e-4: 114.0}
RIDGES_OF_FEW = {1e-3: 77.0, 3e-4: 95.0}
ENOUGH_PRESSES = 18

_hierarchical_gradients = Kernel(
    "hierarchical_gradients",
    "f32[h,w,3] change, f32[r,c,t,2] nodes, i32[t,2] parents, out f32[n] work, out f32[h,w,2] gradients",
)
_hierarchical_from_image = Kernel(
    "hierarchical_from_image",
    "u8[h,w,3]? image, f32[h,w,3]? light, f32[s] scale, f32[h,w,3] untouched, f32[h,w,3] gain, f32[k] taps, "
    "f32[r,c,t,2] nodes, i32[t,2] parents, out f32[n] work, out f32[h,w,3] change, out f32[h,w,2] gradients",
)


@dataclass(frozen=True)
class HierarchicalModel:
    """Polynomial in (R, G, B) without a constant, its coefficients given at nodes and bilinear between them.

    Attributes
    ----------
    nodes : (rows, columns, terms, 2) float64, coefficients at every 16th pixel, the last beyond the border
    degree : of the polynomial in colour
    shape : (H, W) of the images it was fitted on
    """

    nodes: NDArray[np.float64]
    degree: int
    shape: tuple[int, int]

    name: ClassVar[str] = "hierarchical"
    change_offset: ClassVar[float] = 10.0
    slow: ClassVar[bool] = False

    @classmethod
    def fit(
        cls,
        samples: Samples,
        *,
        position_degrees: tuple[int, ...] = (5, 4, 3),
        ridge: float = 3e-4,
        start: HierarchicalModel | None = None,
    ) -> HierarchicalModel:
        """Penalised Huber regression.

        Parameters
        ----------
        samples : with `background` the light at each place counts too
        position_degrees : degree in (x, y) of the linear, quadratic, cubic colour terms; each may be large,
            since the ridge is 4 times stronger per degree in place and 3 times per degree in colour
        ridge : > 0, of a coefficient that is the same everywhere, relative to one sample
        start : the model of another unit of the same sensor; the coefficients are drawn to its own instead of to 0
        """
        if not position_degrees or min(position_degrees) < 0 or not ridge > 0:
            raise ValueError(
                f"Expected position degrees >= 0 and ridge > 0, got {position_degrees} and {ridge}."
            )
        target = samples.gradients
        if start is not None:
            start.check_like(len(position_degrees), samples.shape)
            target = target - start.gradients_at(samples.color_change, samples.x_px, samples.y_px)
        nodes, _ = fitted_nodes(replace(samples, gradients=target), position_degrees, ridge)
        return cls(nodes if start is None else nodes + start.nodes, len(position_degrees), samples.shape)

    @classmethod
    def variants(cls, presses: int) -> list[Variant]:
        """Two ridges, the stiffer first; both are stiffer where presses are few."""
        ridges = RIDGES if presses >= ENOUGH_PRESSES else RIDGES_OF_FEW
        return [Variant(coefficients, {"ridge": ridge}) for ridge, coefficients in ridges.items()]

    def check_like(self, degree: int, shape: tuple[int, int]) -> None:
        """Raise a ValueError where a model of a degree and an image shape could not start from this one."""
        if (self.degree, tuple(self.shape)) != (degree, tuple(shape)):
            raise ValueError(
                f"Expected to start from a model of degree {degree} for images of {shape[0]}x{shape[1]} px, got one of "
                f"degree {self.degree} for {self.shape[0]}x{self.shape[1]} px."
            )

    def gradients_at(
        self, color_change: NDArray[Any], x_px: NDArray[Any], y_px: NDArray[Any]
    ) -> NDArray[np.float64]:
        """Gradients (N, 2) of scattered pixels."""
        products = _products(np.asarray(color_change, dtype=np.float64), monomials(3, self.degree))
        gradients: NDArray[np.float64] = np.einsum("tn,ntk->nk", products, self.coefficients_at(x_px, y_px))
        return gradients

    def coefficients_at(self, x_px: NDArray[Any], y_px: NDArray[Any]) -> NDArray[np.float64]:
        """Coefficients (N, terms, 2) of each monomial of the color change at pixels."""
        return _at_pixels(self.nodes, *_interpolation(x_px, y_px, self.shape))

    def prepare(self, background: NDArray[Any], shape: tuple[int, int]) -> PreparedHierarchical:
        """The coefficients of every row of pixels at every 16th column."""
        check_image_shape(shape, self.shape)
        return PreparedHierarchical(self)

    def to_arrays(self) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """The coefficients at the nodes."""
        return {"nodes": self.nodes}, {"degree": self.degree, "shape": list(self.shape)}

    @classmethod
    def from_arrays(cls, arrays: dict[str, NDArray[Any]], settings: dict[str, Any]) -> HierarchicalModel:
        """The model of `to_arrays`."""
        height, width = settings["shape"]
        return cls(arrays["nodes"], settings["degree"], (height, width))


def fitted_nodes(
    samples: Samples,
    position_degrees: tuple[int, ...],
    ridge: float,
    beside: NDArray[Any] | None = None,
    beside_penalties: NDArray[Any] | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The regression of `HierarchicalModel.fit`, where wanted with columns (N, K) of another kind beside its own.

    Returns
    -------
    nodes : (rows, columns, terms, 2), as `HierarchicalModel.nodes`
    coefficients : (K, 2), of the columns beside; their ridge is `ridge` times `beside_penalties` (K,)
    """
    step = max(1, round(len(samples.x_px) / MAX_SAMPLES))  # neighbours in a press are copies of each other
    change, weight = np.asarray(samples.color_change[::step], dtype=np.float64), samples.weight[::step]
    terms = monomials(3, len(position_degrees))
    light = None if samples.background is None else _light_at_nodes(samples.background)
    degrees = range(1, len(position_degrees) + 1)
    orders = [_places(order, position_degrees, samples.shape, light) for order in degrees]
    places, penalties = zip(*(orders[len(term) - 1] for term in terms))
    scale = float(np.sqrt(np.average(np.mean(change**2, axis=1), weights=weight))) + 1e-12
    at = _interpolation(samples.x_px[::step], samples.y_px[::step], samples.shape)
    there = [_at_pixels(place, *at) for place, _ in orders]
    extra = np.empty((len(change), 0)) if beside is None else beside[::step]
    penalties = (*penalties, np.empty(0) if beside_penalties is None else beside_penalties)
    ends = np.cumsum([len(p) for p in penalties])
    design = np.empty((len(change), ends[-1]), dtype=np.float32)
    *parts, last = np.split(design, ends[:-1], axis=1)
    for term, product, part in zip(terms, _products(change / scale, terms), parts):
        np.multiply(there[len(term) - 1], product[:, None], out=part, casting="same_kind")
    last[...] = extra
    ridges = ridge * np.concatenate(penalties)
    found = penalised_huber(design, samples.gradients[::step], weight, ridges, huber=HUBER_SLOPE)
    *split, others = np.split(found, ends[:-1])
    own = [place @ found / scale ** len(term) for place, found, term in zip(places, split, terms)]
    return np.stack(own, axis=2), others


def _node_positions(shape: tuple[int, int]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of the nodes, px; the last is at the border or beyond."""
    rows, columns = (np.arange(-(-(n - 1) // NODE_PX) + 1 + (n == 1)) * NODE_PX for n in shape)
    return rows, columns


def _places(
    order: int, position_degrees: tuple[int, ...], shape: tuple[int, int], light: NDArray[Any] | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What a coefficient of a colour term of an order is a sum of, (rows, columns, functions), and their penalties."""
    degree = position_degrees[order - 1]
    unit = [
        2 * nodes / (n - 1) - 1 if n > 1 else 0.0 * nodes for nodes, n in zip(_node_positions(shape), shape)
    ]
    size = np.sqrt(2 * np.arange(degree + 1) + 1)
    along_y, along_x = (legvander(u, degree) * size for u in unit)
    powers = position_powers(degree)
    functions = [along_y[:, None, j] * along_x[None, :, i] for i, j in powers]
    penalties = [COLOR_GROWTH ** (order - 1) * PLACE_GROWTH ** (i + j) for i, j in powers]
    if light is not None and order <= len(LIGHT_RIDGE):
        functions += list(light)
        penalties += [LIGHT_RIDGE[order - 1]] * 3
    return np.stack(functions, axis=-1), np.array(penalties)


def _light_at_nodes(background: NDArray[Any]) -> NDArray[np.float64]:
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
        np.minimum(n, limit - 1) for n, limit in zip(_node_positions(light.shape[:2]), light.shape)
    )
    values = logarithm[np.ix_(rows, columns)] / np.maximum(deviation, 0.01)  # even light tells nothing
    return np.moveaxis(values, -1, 0)


def _products(change: NDArray[np.float64], terms: list[tuple[int, ...]]) -> NDArray[np.float64]:
    """Monomials (terms, N) of a colour change (N, 3)."""
    return np.stack(monomial_products(np.ascontiguousarray(change.T), terms))


def _interpolation(x_px: NDArray[Any], y_px: NDArray[Any], shape: tuple[int, int]) -> tuple[Any, ...]:
    """The node above left of each pixel, and how far on towards the next it lies, 0-1."""
    found: list[Any] = []
    for position, nodes in zip((y_px, x_px), _node_positions(shape)):
        along = np.asarray(position, dtype=np.float64) / NODE_PX
        before = np.clip(along.astype(np.intp), 0, len(nodes) - 2)
        found += [before, along - before]
    return tuple(found)


def _at_pixels(nodes: NDArray[Any], row: Any, v: Any, column: Any, u: Any) -> NDArray[np.float64]:
    """Values (N, ...) between the nodes, bilinear."""
    v, u = (part.reshape(-1, *[1] * (nodes.ndim - 2)) for part in (v, u))
    above = nodes[row, column] * (1 - u) + nodes[row, column + 1] * u
    below = nodes[row + 1, column] * (1 - u) + nodes[row + 1, column + 1] * u
    values: NDArray[np.float64] = above * (1 - v) + below * v
    return values


class PreparedHierarchical:
    """The coefficients at the nodes, as the kernels take them; immutable, shared by threads."""

    def __init__(self, model: HierarchicalModel) -> None:
        self._nodes = np.ascontiguousarray(model.nodes, dtype=np.float32)
        self._parents = monomial_parents(monomials(3, model.degree))
        _, columns, terms, _ = self._nodes.shape
        self._work_size = 2 * columns * terms + 4 * terms + 5 * -(-model.shape[1] // NODE_PX) * NODE_PX

    def gradients_from_color(self, color_change: NDArray[np.float32]) -> tuple[NDArray[np.float32], None]:
        """Gradients (H, W, 2) of a color change (H, W, 3); their deviation is the calibration's."""
        gradients = np.empty((*color_change.shape[:2], 2), dtype=np.float32)
        work = np.empty(self._work_size, dtype=np.float32)
        _hierarchical_gradients(color_change, self._nodes, self._parents, work, gradients)
        return gradients, None

    def gradients_in_one_pass(
        self, pending: PendingChange, out: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], None]:
        """The same of an image whose color change is still to be computed: that is written to `out` (H, W, 3)."""
        gradients = np.empty((*out.shape[:2], 2), dtype=np.float32)
        work = np.empty(pending.work_size + self._work_size, dtype=np.float32)
        _hierarchical_from_image(*pending.arguments, self._nodes, self._parents, work, out, gradients)
        return gradients, None
