"""ColorModel: the protocol of all color models, the samples of their fit, and the least squares that they share.

This is ridge regression with Huber weights on polynomial terms. Their coefficients vary over the image: they are polynomials
in the place, or lie at the nodes of a coarse grid and are bilinear between them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from functools import cached_property, lru_cache
from itertools import combinations_with_replacement
from types import NoneType
from typing import Any, ClassVar, Protocol, TypeVar, get_args, get_origin, get_type_hints, runtime_checkable

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.arrays import Array, Floats, Map, Numbers, Slopes

T = TypeVar("T")


@dataclass(frozen=True)
class Samples:
    """Pixels whose gradient is known."""

    color_change: Array  # (N, 3) float32
    x_px: Array  # (N,) float32, pixel positions
    y_px: Array
    gradients: Array  # (N, 2) float64, mm/mm
    weight: Array  # (N,) float64, >= 0
    shape: tuple[int, int]  # (H, W) of the images they come from
    background: Array | None = None  # (H, W, 3) float32, for models that use the light at a place
    depth_px: Array | None = None  # (N,) float32, >= 0, from a plain model, for models that use it
    # What fits on these samples have in common, by the model; a model writes it here for its next fit.
    shared: dict[str, Any] = field(default_factory=dict, init=False, repr=False, compare=False)


class PreparedColorModel(Protocol):
    """A color model ready for frames of one shape over one background.

    It may also have `gradients_in_one_pass(pending, out)`, as `gradients_from_color`, whose kernel computes the color change
    too and writes it to `out` (H, W, 3); and `albedo_from_color(color_change)`, the albedo (H, W) relative to rest.
    """

    def gradients_from_color(self, color_change: Map) -> tuple[Slopes, Slopes | None]:
        """Gradients (H, W, 2) of a color change (H, W, 3), and their standard deviation or None."""
        ...


class ColorModel(Protocol):
    """A fitted color model; immutable."""

    name: ClassVar[str]  # for users and calibration files
    change_offset: ClassVar[float]  # gray levels c of `(I - I0)/(I0 + c)`; 0 for laws of physics

    def gradients_at(self, color_change: Array, x_px: Array, y_px: Array) -> Numbers:
        """Gradients (N, 2) of scattered pixels."""
        ...

    def prepare(self, background: Array, shape: tuple[int, int]) -> PreparedColorModel:
        """Everything that does not depend on the frame, computed once."""
        ...

    def at_size(self, shape: tuple[int, int], wider: float) -> ColorModel:
        """The model for images (H, W) of the same gel, whose pixels are `wider` times as wide."""
        ...

    def to_arrays(self) -> tuple[dict[str, Array], dict[str, Any]]:
        """Arrays and JSON-able settings, from which `from_arrays` makes the model again."""
        ...

    @classmethod
    def from_arrays(cls, arrays: dict[str, Array], settings: dict[str, Any]) -> ColorModel:
        """The model from `to_arrays`. Later additions have a default here, because older files stay readable."""
        ...


class Stored:
    """A dataclass that a file holds as arrays, and as settings that JSON has.

    Its fields are arrays, records of arrays (such as `Layers`), numbers, texts and tuples of them. A file lacks arrays that
    are None. A field with a default may be missing: older files stay readable.
    """

    def to_arrays(self) -> tuple[dict[str, Array], dict[str, Any]]:
        """Arrays and settings, from which `from_arrays` makes the record again."""
        arrays: dict[str, Array] = {}
        settings: dict[str, Any] = {}
        for name, hint, _ in _fields(type(self)):
            value = getattr(self, name)
            if hasattr(hint, "to_arrays"):
                arrays |= value.to_arrays()
            elif not _is_array(hint):
                settings[name] = list(value) if isinstance(value, tuple) else value
            elif value is not None:
                arrays[name] = value
        return arrays, settings

    @classmethod
    def from_arrays(cls: type[T], arrays: dict[str, Array], settings: dict[str, Any]) -> T:
        """The record of `to_arrays`; KeyError, TypeError or ValueError: they make none."""
        values: dict[str, Any] = {}
        for name, hint, needed in _fields(cls):
            stored = arrays if _is_array(hint) else settings
            if hasattr(hint, "from_arrays"):
                values[name] = hint.from_arrays(arrays)
            elif needed or stored.get(name) is not None:
                value, kinds = stored[name], get_args(hint)
                if get_origin(hint) is tuple:
                    if not isinstance(value, list) or (... not in kinds and len(value) != len(kinds)):
                        raise TypeError(f"Expected {name} as a list of {len(kinds)}, got {value!r}.")
                    value = tuple(value)
                values[name] = value
        return cls(**values)

    def at_size(self: T, shape: tuple[int, int], wider: float) -> T:
        """As `ColorModel.at_size`, of a record without other fields in pixels."""
        own = {"shape": shape} if any(name == "shape" for name, *_ in _fields(type(self))) else {}
        return replace(self, **own)  # type: ignore[type-var]  # a dataclass, as all of them


def _fields(record: type) -> Iterator[tuple[str, Any, bool]]:
    """Name and type of each field, X for `X | None`, and whether a file must have it."""
    hints = get_type_hints(record)
    for one in fields(record):
        kinds = get_args(hints[one.name])
        yield one.name, kinds[0] if NoneType in kinds else hints[one.name], one.default is MISSING


def _is_array(hint: Any) -> bool:
    """Whether a type is that of an array; from numpy 2.5 on, `NDArray[...]` is an alias of it."""
    origin = get_origin(hint)
    return np.ndarray in (origin, get_origin(getattr(origin, "__value__", None)))


class FittableColorModel(ColorModel, Protocol):
    """The additional methods of the classes in `COLOR_MODELS`: the fit, and the settings that calibration tries."""

    @classmethod
    def fit(cls, *samples: Any, **settings: Any) -> FittableColorModel:
        """`fit(samples, **settings)`, deterministic; the settings are the model's own, each with a default."""
        ...

    @classmethod
    def variants(cls, presses: int) -> Sequence[Mapping[str, Any]]:
        """Keywords of `fit` to try with a number of accepted presses, the simplest first; at least one."""
        ...


class Untuned:
    """A color model without settings to try, whatever the number of presses."""

    @classmethod
    def variants(cls, presses: int) -> list[dict[str, Any]]:
        """The class's only variant."""
        return [{}]


@runtime_checkable
class StartableModel(ColorModel, Protocol):
    """Addition to `ColorModel`: a fit can start from another unit's; `fit` takes it as `start`, and a `ridge`."""

    @property
    def degree(self) -> int:
        """Degree of the polynomial in color."""
        ...

    def of_other_unit(self, gain: Numbers, wider: float) -> StartableModel:
        """The model of a unit whose color changes are smaller by a gain (rows, columns, 3) at its nodes.

        Its pixels are `wider` times as wide on the gel.
        """
        ...

    def at_size(self, shape: tuple[int, int], wider: float) -> StartableModel:
        """As `ColorModel.at_size`."""
        ...

    @classmethod
    def average(cls, models: Sequence[Any], shares: Sequence[float]) -> StartableModel:
        """The model that reads the mean of the slopes that models of this kind read, in these shares."""
        ...

    def check_like(self, degree: int, shape: tuple[int, int]) -> None:
        """Raise a ValueError if a model of a degree and an image shape cannot start from this one."""
        ...


def check_image_shape(shape: tuple[int, int], own: tuple[int, int], *, made: str = "calibrated") -> None:
    """Raise a ValueError if a model is prepared for images of another size than its own."""
    if tuple(shape) != tuple(own):
        raise ValueError(f"Expected images of {own[0]}x{own[1]} px, as {made}, got {shape[0]}x{shape[1]}.")


HUBER_SLOPE = 0.05  # mm/mm, about the usual error of a slope; samples with larger errors count less
Normal = tuple[Numbers, Numbers]


def monomials(channels: int, degree: int) -> list[tuple[int, ...]]:
    """Channel indices of every monomial of degree 1 to `degree`, lower degrees first.

    Each monomial of degree n is one of degree n - 1 times a last channel: (0, 0, 2) means c0 c0 c2.
    """
    terms: list[tuple[int, ...]] = []
    for n in range(1, degree + 1):
        terms += combinations_with_replacement(range(channels), n)
    return terms


def monomial_parents(terms: list[tuple[int, ...]]) -> NDArray[np.int32]:
    """The parent monomial and the channel of each monomial, (terms, 2), for the kernels; -1 stands for 1."""
    number = {term: t for t, term in enumerate(terms)}
    return np.array([[number.get(term[:-1], -1), term[-1]] for term in terms], dtype=np.int32)


def position_powers(degree: int) -> list[tuple[int, int]]:
    """Exponents (i, j) of x^i y^j with i + j <= degree."""
    return [(i, j) for j in range(degree + 1) for i in range(degree + 1 - j)]


def term_count(channels: int, position_degrees: tuple[int, ...]) -> int:
    """The number of columns of `polynomial_terms`."""
    terms = monomials(channels, len(position_degrees))
    return sum(len(position_powers(position_degrees[len(term) - 1])) for term in terms)


def unit_position(x_px: Array, y_px: Array, shape: tuple[int, int]) -> tuple[Any, Any]:
    """Positions about the image's center in units of half its larger side."""
    height, width = shape
    half = max(height, width) / 2
    x = (np.asarray(x_px, dtype=np.float64) - (width - 1) / 2) / half
    y = (np.asarray(y_px, dtype=np.float64) - (height - 1) / 2) / half
    return x, y


def polynomial_terms(values: Array, x: Array, y: Array, position_degrees: tuple[int, ...]) -> Numbers:
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


def monomial_products(channels: Array, terms: list[tuple[int, ...]]) -> list[Array]:
    """Each monomial (N,) of channels (C, N), a product of its parent's with one channel."""
    products: list[Array] = []
    channels = np.ascontiguousarray(channels)
    for parent, channel in monomial_parents(terms):
        products.append(channels[channel] if parent < 0 else products[parent] * channels[channel])
    return products


def position_terms(x: Array, y: Array, degree: int) -> dict[tuple[int, int], Numbers]:
    """x^i y^j by its exponents, each the product of an earlier one; powers take ten times as long."""
    place = {(0, 0): np.ones(len(x))}
    for i, j in position_powers(degree)[1:]:
        place[i, j] = place[i - 1, j] * x if i else place[i, j - 1] * y
    return place


def robust_ridge(
    design: Numbers, target: Numbers, weight: Numbers, *, ridge: float, huber: float, rounds: int = 3
) -> Numbers:
    """Coefficients (terms, outputs) of a ridge regression, reweighted by Huber's loss of the residual's length.

    The ridge is relative to the size of each column, so it means the same for every term.
    """
    normal, right = whole = normal_equations(design, target, weight)
    total = float(weight.sum())
    size = np.sqrt(np.diag(normal) / total) + 1e-12
    prior = np.diag(ridge * total * size**2)
    coefficients = np.linalg.solve(normal + prior, right)  # definite by the ridge
    for _ in range(rounds - 1):
        residual = np.linalg.norm(design @ coefficients.astype(design.dtype) - target, axis=1)
        # Only samples beyond `huber` lose weight, so the loss is subtracted from the equations of the first round.
        beyond = np.flatnonzero(residual > huber)
        lost = weight[beyond] * (1 - huber / residual[beyond])
        # In the design's own order in memory: gathering across it takes ten times as long.
        rows = design[beyond] if design.flags.c_contiguous else np.take(design.T, beyond, axis=1).T
        less = normal_equations(rows, target[beyond], lost)
        coefficients = np.linalg.solve(whole[0] - less[0] + prior, whole[1] - less[1])
    return np.asarray(coefficients, dtype=np.float64)


def normal_equations(design: Array, target: Numbers, weight: Numbers) -> Normal:
    """Weighted sums of products: terms by terms, and terms by outputs."""
    root = np.sqrt(weight).astype(design.dtype)[:, None]
    weighted = design * root
    normal = (weighted.T @ weighted).astype(np.float64)  # an array with itself takes half the work
    return normal, weighted.T @ (root * target)


NODE_PX = 16  # px between nodes, as in native/slopes/color_models/nodes.h
# Growth of the ridge, per degree in place (and for the light) and per order of the term.
PLACE_GROWTH, ORDER_GROWTH = 4.0, 3.0
MAX_SAMPLES = 20_000  # samples of a regression; neighbors in a press are copies


@dataclass(frozen=True, eq=False)
class Term:
    """A column of a regression whose coefficient varies over the image."""

    values: Array  # (N,)
    place_degree: int  # degree of the Legendre polynomials of the place in its coefficient
    ridge: float  # ridge of a coefficient that is the same everywhere, relative to the regression's
    varies_with_light: bool = False  # whether the coefficient also depends on the background's logarithm


def terms_of_orders(
    products: Sequence[Array], orders: Sequence[int], place_degrees: Sequence[int]
) -> list[Term]:
    """Terms of products (N,) of a number of factors, stiffer at higher orders; `place_degrees` by order."""
    return [
        Term(product, place_degrees[order - 1], ORDER_GROWTH ** (order - 1), order <= 2)
        for product, order in zip(products, orders)
    ]


@dataclass(frozen=True, eq=False)
class VaryingRegression:
    """Penalized least squares on terms whose coefficients vary over the image; one set of columns for all ridges."""

    columns: Floats  # (N, columns) float32
    target: Numbers  # (N, K) float64
    weight: Numbers  # (N,)
    penalties: Numbers  # (columns,), of their ridges
    ends: NDArray[np.intp]  # the end of each term's columns
    places: tuple[Numbers, ...]  # of each term: its functions at the nodes, (rows, columns, functions)

    @classmethod
    def of(cls, terms: Sequence[Term], target: Array, samples: Samples) -> VaryingRegression:
        """Terms (N,) and target (N, K) of at most some 20,000 samples, because neighbors in a press are copies."""
        step = max(1, round(len(samples.x_px) / MAX_SAMPLES))
        light = None if samples.background is None else light_at_nodes(samples.background)
        at = interpolation(samples.x_px[::step], samples.y_px[::step], samples.shape)
        made: dict[Any, tuple[Numbers, Numbers, Numbers]] = {}
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
        return cls(columns, own_target, weight, penalties, ends, tuple(kind[0] for kind in kinds))

    @cached_property
    def _normal(self) -> Normal:
        # In float32: they are sums of squares, and the ridge is far above their rounding.
        return normal_equations(self.columns, self.target, self.weight)

    def coefficients(self, ridge: float) -> Numbers:
        """Coefficients (columns, K) for a ridge, which is relative to the samples' weight."""
        normal, right = self._normal
        prior = np.diag(ridge * float(self.weight.sum()) * self.penalties)
        return np.asarray(np.linalg.solve(normal + prior, right), dtype=np.float64)  # definite by the ridge

    def nodes(self, coefficients: Numbers) -> Numbers:
        """The terms' coefficients at the nodes, (rows, columns, terms, K)."""
        split = np.split(coefficients, self.ends[:-1])
        return np.stack([place @ part for place, part in zip(self.places, split)], axis=2)

    def residual(self, coefficients: Numbers) -> Numbers:
        """Target minus the prediction of the coefficients, (N, K)."""
        return np.asarray(self.target - self.columns @ coefficients.astype(np.float32), dtype=np.float64)


def node_positions(shape: tuple[int, int]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns of the nodes, px; the last is at the border or beyond."""
    rows, columns = (np.arange(-(-(n - 1) // NODE_PX) + 1 + (n == 1)) * NODE_PX for n in shape)
    return rows, columns


def _places(
    degree: int, with_light: bool, shape: tuple[int, int], light: Array | None
) -> tuple[Numbers, Numbers]:
    """The functions in a coefficient's sum at the nodes, (rows, columns, functions), and the penalty of each."""
    positions = zip(node_positions(shape), shape)
    unit = [2 * nodes / (n - 1) - 1 if n > 1 else 0.0 * nodes for nodes, n in positions]
    size = np.sqrt(2 * np.arange(degree + 1) + 1)
    along_y, along_x = (np.polynomial.legendre.legvander(u, degree) * size for u in unit)
    powers = position_powers(degree)
    functions = [along_y[:, None, j] * along_x[None, :, i] for i, j in powers]
    growth = [PLACE_GROWTH ** (i + j) for i, j in powers]
    if with_light and light is not None:
        functions += list(light)
        growth += [PLACE_GROWTH] * 3
    return np.stack(functions, axis=-1), np.array(growth)


def light_at_nodes(background: Array) -> Numbers:
    """Logarithm of the background image at the nodes, (3, rows, columns), with mean 0 and deviation 1."""
    pixels = np.asarray(background, dtype=np.float32)
    return _light_of_pixels(pixels.tobytes(), pixels.shape)


@lru_cache(maxsize=4)  # a calibration fits a hundred models on one background
def _light_of_pixels(pixels: bytes, shape: tuple[int, ...]) -> Numbers:
    # The logarithm of less than a gray level is noise; lamps are broad.
    light = np.maximum(np.frombuffer(pixels, dtype=np.float32).reshape(shape), np.float32(1))
    smooth = cv2.GaussianBlur(light, (0, 0), 8.0, borderType=cv2.BORDER_REFLECT_101)
    logarithm = np.log(smooth.astype(np.float64))
    logarithm -= logarithm.mean(axis=(0, 1))
    deviation = logarithm.std(axis=(0, 1))
    places = zip(node_positions(light.shape[:2]), light.shape)
    rows, columns = (np.minimum(nodes, n - 1) for nodes, n in places)
    values = logarithm[np.ix_(rows, columns)] / np.maximum(deviation, 0.01)  # even light has no information
    return np.moveaxis(values, -1, 0)


def interpolation(x_px: Array, y_px: Array, shape: tuple[int, int]) -> tuple[Any, ...]:
    """The node at the upper left of each pixel, and the fraction of the way to the next node, 0-1."""
    found: list[Any] = []
    for position, nodes in zip((y_px, x_px), node_positions(shape)):
        along = np.asarray(position, dtype=np.float64) / NODE_PX
        before = np.clip(along.astype(np.intp), 0, len(nodes) - 2)
        found += [before, along - before]
    return tuple(found)


def nodes_at_scale(
    nodes: Array, shape: tuple[int, int], wider: float, new: tuple[int, int] | None = None
) -> Numbers:
    """Nodes (rows, columns, ...) of images (H, W), for images of that or a new shape with pixels `wider` times as wide.

    Each place is read where it lies in mm from the image's center; places outside the first image are read at its border.
    """
    new = shape if new is None else new
    rows, columns = (
        np.clip((n - 1) / 2 + wider * (at - (m - 1) / 2), 0, own[-1])
        for at, own, n, m in zip(node_positions(new), node_positions(shape), shape, new)
    )
    y, x = (axis.ravel() for axis in np.meshgrid(rows, columns, indexing="ij"))
    found = at_pixels(nodes, *interpolation(x, y, shape))
    return found.reshape(len(rows), len(columns), *np.shape(nodes)[2:])


def at_pixels(nodes: Array, row: Any, v: Any, column: Any, u: Any) -> Numbers:
    """Values (N, ...) between the nodes, bilinear."""
    v, u = (part.reshape(-1, *[1] * (nodes.ndim - 2)) for part in (v, u))
    above = nodes[row, column] * (1 - u) + nodes[row, column + 1] * u
    below = nodes[row + 1, column] * (1 - u) + nodes[row + 1, column + 1] * u
    values: Numbers = above * (1 - v) + below * v
    return values
