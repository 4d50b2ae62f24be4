"""Coefficients at nodes of a coarse grid, bilinear between them: fitted to samples, and looked up at pixels."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any
from weakref import finalize, ref

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.color_models._shared.least_squares import (
    HUBER_SLOPE,
    Normal,
    monomial_products,
    monomials,
    normal_equations,
    penalised_huber,
    position_powers,
)
from gelform.color_models.seam import Samples

NODE_PX = 16
LIGHT_BLUR_PX = 8.0
PLACE_GROWTH = 4.0
COLOR_GROWTH = 3.0
LIGHT_RIDGE = (3.0, 10.0)
DARKEST = 1.0
MAX_SAMPLES = 20_000


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
    own = _columns_of(samples, position_degrees, step)
    columns, penalties, whole = own.columns, own.penalties, None
    weight, target = samples.weight[::step], samples.gradients[::step]
    if beside is not None and beside_penalties is not None:
        columns = np.concatenate([columns, beside[::step].astype(np.float32)], axis=1)
        penalties = np.concatenate([penalties, beside_penalties])
    else:
        whole = own.normal_equations(samples.gradients, step, weight)
    found = penalised_huber(columns, target, weight, ridge * penalties, huber=HUBER_SLOPE, whole=whole)
    *split, others = np.split(found, own.ends)
    nodes = [place @ part / scale for place, part, scale in zip(own.places, split, own.scales)]
    return np.stack(nodes, axis=2), others


@dataclass(frozen=True, eq=False)
class _Columns:
    """The columns of a regression: of each colour term, times each function of the place.

    Attributes
    ----------
    columns : (N, columns) float32
    penalties : (columns,), of their ridges
    ends : where each term's columns end
    places, scales : of each term: its functions at the nodes, and what its colours were divided by
    solved : the normal equations of the last gradients (N, 2), and those
    """

    columns: NDArray[np.float32]
    penalties: NDArray[np.float64]
    ends: NDArray[np.intp]
    places: tuple[NDArray[np.float64], ...]
    scales: tuple[float, ...]
    solved: list[Any] = field(default_factory=list)

    def normal_equations(
        self, gradients: NDArray[np.float64], step: int, weight: NDArray[np.float64]
    ) -> Normal:
        """Of every `step`-th of some gradients; remembered for the next ridge."""
        if not (self.solved and self.solved[0] is gradients):
            self.solved[:] = gradients, normal_equations(self.columns, gradients[::step], weight)
        normal: Normal = self.solved[1]
        return normal


_kept: dict[str, Any] = {}  # the last columns, until the samples that they are of are gone


def _columns_of(samples: Samples, position_degrees: tuple[int, ...], step: int) -> _Columns:
    """Those of every `step`-th sample; the last are kept: calibration fits them with one ridge after the other."""
    made = _remembered(samples, position_degrees, step)
    if made is not None:
        return made
    change, weight = np.asarray(samples.color_change[::step], dtype=np.float64), samples.weight[::step]
    terms = monomials(3, len(position_degrees))
    light = None if samples.background is None else light_at_nodes(samples.background)
    orders = [_places(n, position_degrees, samples.shape, light) for n in range(1, len(position_degrees) + 1)]
    places, penalties = zip(*(orders[len(term) - 1] for term in terms))
    scale = float(np.sqrt(np.average(np.mean(change**2, axis=1), weights=weight))) + 1e-12
    at = interpolation(samples.x_px[::step], samples.y_px[::step], samples.shape)
    there = [at_pixels(place, *at) for place, _ in orders]
    ends = np.cumsum([len(p) for p in penalties])
    columns = np.empty((len(change), ends[-1]), dtype=np.float32)
    for term, product, part in zip(
        terms, colour_products(change / scale, terms), np.split(columns, ends[:-1], axis=1)
    ):
        np.multiply(there[len(term) - 1], product[:, None], out=part, casting="same_kind")
    scales = tuple(scale ** len(term) for term in terms)
    made = _Columns(columns, np.concatenate(penalties), ends, places, scales)
    _kept["last"] = ref(samples.color_change), _beside(samples), (position_degrees, step), made
    finalize(samples.color_change, _kept.clear)
    return made


def _beside(samples: Samples) -> tuple[Any, ...]:
    return samples.x_px, samples.y_px, samples.weight, samples.background


def _remembered(samples: Samples, position_degrees: tuple[int, ...], step: int) -> _Columns | None:
    """The last columns, where they are of the very same arrays and degrees."""
    change, beside, settings, made = _kept.get("last", (lambda: None, (), None, None))
    same = change() is samples.color_change and settings == (position_degrees, step)
    return made if same and all(a is b for a, b in zip(beside, _beside(samples))) else None


def node_positions(shape: tuple[int, int]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of the nodes, px; the last is at the border or beyond."""
    rows, columns = (np.arange(-(-(n - 1) // NODE_PX) + 1 + (n == 1)) * NODE_PX for n in shape)
    return rows, columns


def _places(
    order: int, position_degrees: tuple[int, ...], shape: tuple[int, int], light: NDArray[Any] | None
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What a coefficient of a colour term of an order is a sum of, (rows, columns, functions), and their penalties."""
    degree = position_degrees[order - 1]
    unit = [
        2 * nodes / (n - 1) - 1 if n > 1 else 0.0 * nodes for nodes, n in zip(node_positions(shape), shape)
    ]
    size = np.sqrt(2 * np.arange(degree + 1) + 1)
    along_y, along_x = (np.polynomial.legendre.legvander(u, degree) * size for u in unit)
    powers = position_powers(degree)
    functions = [along_y[:, None, j] * along_x[None, :, i] for i, j in powers]
    penalties = [COLOR_GROWTH ** (order - 1) * PLACE_GROWTH ** (i + j) for i, j in powers]
    if light is not None and order <= len(LIGHT_RIDGE):
        functions += list(light)
        penalties += [LIGHT_RIDGE[order - 1]] * 3
    return np.stack(functions, axis=-1), np.array(penalties)


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
