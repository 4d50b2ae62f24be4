"""Color models that keep colors in tables: one for all places, and one interpolated between the presses.

The first is fitted by lattice regression and read by multilinear interpolation. Each sample pulls the corners of its grid
cell; nodes without samples follow their neighbors, because second differences are kept small (E. Garcia, R. Arora,
M. R. Gupta, Optimized regression for efficient function evaluation, IEEE Trans. Image Processing 21(9), 2012, section III).

The second takes the nearest samples in (R, G, B, x, y): a line through the origin of color, fitted at each pixel. It is
local linear regression (W. S. Cleveland, J. Am. Stat. Assoc. 74, 1979) without a constant, pulled to the line of all samples
where the neighbors do not determine it. Unlike parametric models, it measures the distance of a pixel from its samples. It
is slow: seconds for a frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any, ClassVar, Literal

import numpy as np
import scipy  # its parts load at first use
from numpy.typing import NDArray

from gelform.arrays import Array, Floats, Map, Numbers, Slopes
from gelform.foundations.filters import CHANGE_OFFSET
from gelform.image.view import pixel_positions
from gelform.slopes.color_models.networks import BLOCK_PX, blocks_of
from gelform.slopes.color_models.seam import (
    HUBER_SLOPE,
    Samples,
    Stored,
    Untuned,
    check_image_shape,
    robust_ridge,
    unit_position,
)
from gelform.slopes.gradients import STEEPEST_GEL


def corner_weights(coordinates: list[Numbers], sizes: tuple[int, ...]) -> scipy.sparse.csr_matrix:
    """Multilinear weights (N, nodes) at positions (N,) along each axis, in nodes; constant beyond the grid."""
    count = len(coordinates[0])
    cells = [_node_and_fraction(at, size) for at, size in zip(coordinates, sizes)]
    columns, values = [], []
    for corner in product(*[(0, 1) if size > 1 else (0,) for size in sizes]):
        node, fraction = np.zeros(count, dtype=int), np.ones(count)
        for (index, between), up, size in zip(cells, corner, sizes):
            node = node * size + index + up
            fraction = fraction * (between if up else 1 - between)
        columns.append(node)
        values.append(fraction)
    rows = np.tile(np.arange(count), len(columns))
    entries = np.concatenate(values), (rows, np.concatenate(columns))
    return scipy.sparse.csr_matrix(entries, shape=(count, int(np.prod(sizes))))


class Lattice:
    """Least squares on the nodes of a grid over (y, x, R, G, B), for slopes that are 0 without a change of color.

    `zero` is the node of no change on the color axes, `smoothness` the weight of second differences relative to the
    samples.
    """

    def __init__(self, sizes: tuple[int, ...], zero: tuple[int, ...], smoothness: float) -> None:
        self.smoothness = smoothness
        self.roughness = scipy.sparse.csr_matrix((int(np.prod(sizes)),) * 2)
        for axis, size in enumerate(sizes):
            if size > 1:  # D^T D of second differences along the axis, first ones for two nodes
                order = [1.0, -2.0, 1.0] if size > 2 else [-1.0, 1.0]
                rows = size - len(order) + 1
                line = scipy.sparse.diags(order, list(range(len(order))), shape=(rows, size))
                before, after = (scipy.sparse.eye(int(np.prod(n))) for n in (sizes[:axis], sizes[axis + 1 :]))
                along = scipy.sparse.kron(scipy.sparse.kron(before, line.T @ line), after)
                self.roughness = self.roughness + scipy.sparse.csr_matrix(along)
        free = np.ones(sizes, dtype=bool)
        free[:, :, zero[0], zero[1], zero[2]] = False
        self.free = np.flatnonzero(free)

    def fitted(self, corners: scipy.sparse.csr_matrix, target: Numbers, weight: Numbers) -> Numbers:
        """Slopes (nodes, 2) of samples (N, 2) at `corner_weights`, by conjugate gradients, reweighted by Huber's loss."""
        slopes, current = np.zeros((corners.shape[1], 2)), weight
        scale = self.smoothness * float(weight.sum()) / len(self.free)
        part = corners[:, self.free]
        stiff = self.roughness[self.free][:, self.free] * scale
        for _ in range(2):
            normal = (part.T @ scipy.sparse.diags(current) @ part + stiff).tocsr()
            precondition = scipy.sparse.diags(1 / (normal.diagonal() + 1e-12))
            right = part.T @ (current[:, None] * target)
            for c in (0, 1):
                enough = 1e-3 * float(np.linalg.norm(right[:, c]))
                start = slopes[self.free, c]
                slopes[self.free, c] = scipy.sparse.linalg.cg(
                    normal, right[:, c], x0=start, atol=enough, M=precondition
                )[0]
            residual = np.linalg.norm(corners @ slopes - target, axis=1)
            current = weight * np.minimum(1, HUBER_SLOPE / np.maximum(residual, 1e-12))
        return slopes


def held_out_residuals(
    lattice: Lattice, corners: scipy.sparse.csr_matrix, target: Numbers, weight: Numbers
) -> Numbers:
    """Residuals (N, 2) of held-out samples; 24 stretches of them are left out in two folds.

    Samples are in the order of presses, so a stretch is about one press, and its neighbors in the list are no copies of it.
    """
    fold = (np.arange(len(target)) * 24 // max(len(target), 1)) % 2
    residual = np.empty_like(target)
    for out in (fold == 0, fold == 1):
        slopes = lattice.fitted(corners[~out], target[~out], weight[~out])
        residual[out] = corners[out] @ slopes - target[out]
    return residual


@dataclass(frozen=True)
class LookupModel(Stored, Untuned):
    """Slopes at the nodes of a grid over (y, x, R, G, B).

    The gain "mean_over_background" is for tables of gray levels times 1 + 2 (mean(I0)/I0 - 1).
    """

    # (rows, columns, reds, greens, blues, 3): two slopes and their standard deviation, which is STEEPEST_GEL without
    # samples; 0 everywhere if unknown.
    table: Floats
    low: Numbers  # (3,), color change of the first node, per channel
    step: Numbers  # (3,), between nodes
    shape: tuple[int, int]  # (H, W) of the images
    gain: Literal["none", "mean_over_background"] = "none"
    background: Map | None = None  # (H, W, 3), with that gain: the image that it was imported with

    name: ClassVar[str] = "lookup"
    change_offset: ClassVar[float] = CHANGE_OFFSET

    @classmethod
    def fit(
        cls,
        samples: Samples,
        *,
        nodes: int = 11,  # per channel: about one for each tenth of the range
        positions: tuple[int, int] = (3, 4),  # over (rows, columns); (1, 1): over color alone
        smoothness: float = 0.02,  # weight of the second differences, relative to the samples
    ) -> LookupModel:
        """Fit on the samples, in seconds. They are in the order of their presses, so that residuals are of other presses."""
        if nodes < 4 or min(positions) < 1:
            raise ValueError(f"Expected at least 4 nodes and 1 position, got {nodes} and {positions}.")
        change = np.asarray(samples.color_change, dtype=np.float64)
        # The table spans nearly all of the samples' color change, with a node at no change.
        lowest, highest = np.percentile(change, (0.2, 99.8), axis=0)
        lowest, highest = np.minimum(lowest, -LEAST_CHANGE), np.maximum(highest, LEAST_CHANGE)
        step = (highest - lowest) / (nodes - 2)
        low = -np.ceil(-lowest / step) * step
        sizes = (*positions, nodes, nodes, nodes)
        grid = cls(np.zeros((*sizes, 3), np.float32), low, step, samples.shape)
        corners = corner_weights(grid._coordinates(change, samples.x_px, samples.y_px), sizes)
        weight = np.asarray(samples.weight, dtype=np.float64)
        target = np.asarray(samples.gradients, dtype=np.float64)
        no_change = tuple(np.rint(-low / step).astype(int).tolist())  # its node on the color axes
        lattice = Lattice(sizes, no_change, smoothness)
        slopes = lattice.fitted(corners, target, weight)
        residual = held_out_residuals(lattice, corners, target, weight)
        sigma = _deviation(corners, residual, weight, sizes)
        table = np.concatenate([slopes, sigma[:, None]], axis=1).reshape(*sizes, 3)
        return cls(table.astype(np.float32), low, step, samples.shape)

    def gradients_at(self, color_change: Array, x_px: Array, y_px: Array) -> Numbers:
        """Gradients (N, 2) of scattered pixels."""
        change = np.asarray(color_change, dtype=np.float64)
        if self.background is not None:
            gain = _gain(self.background)
            change = change * gain[np.asarray(y_px, dtype=int), np.asarray(x_px, dtype=int)]
        sizes = self.table.shape[:-1]
        corners = corner_weights(self._coordinates(change, x_px, y_px), sizes)
        at_rest = corner_weights(self._coordinates(0 * change, x_px, y_px), sizes)
        slopes: Numbers = (corners - at_rest) @ self.table.reshape(-1, 3)[:, :2].astype(np.float64)
        return slopes

    def prepare(self, background: Array, shape: tuple[int, int]) -> PreparedLookup:
        """Prepare the gain of each pixel and its position in the table."""
        check_image_shape(shape, self.shape)
        gain = None if self.gain == "none" else _gain(np.asarray(background, dtype=np.float32))
        return PreparedLookup(self, gain)

    def _coordinates(self, change: Array, x_px: Array, y_px: Array) -> list[Numbers]:
        """Position of samples on the five axes, in nodes."""
        rows, columns = self.table.shape[:2]
        height, width = self.shape
        places = [
            np.asarray(y_px, dtype=np.float64) * ((rows - 1) / max(height - 1, 1)),
            np.asarray(x_px, dtype=np.float64) * ((columns - 1) / max(width - 1, 1)),
        ]
        return places + [(change[:, c] - self.low[c]) / self.step[c] for c in range(3)]


class PreparedLookup:
    """A table for frames of one shape. It is immutable; threads can share it."""

    def __init__(self, model: LookupModel, gain: Map | None) -> None:
        rows, columns, *colors, _ = model.table.shape
        self._gain = gain
        self._measured = bool(model.table[..., 2].any())
        self._low, self._step = model.low.astype(np.float32), model.step.astype(np.float32)
        self._colors, self._columns = np.array(colors), columns
        top, down = _node_and_fraction(np.linspace(0, rows - 1, model.shape[0], dtype=np.float32), rows)
        across = np.linspace(0, columns - 1, model.shape[1], dtype=np.float32)
        left, self._right = _node_and_fraction(across, columns)
        below = model.table[np.minimum(top + 1, rows - 1)]
        by_row = model.table[top] + down[:, None, None, None, None, None] * (below - model.table[top])
        self._values = np.ascontiguousarray(by_row.reshape(-1, 3))  # (image row, column, R, G, B) -> 3 values
        self._first = (np.arange(model.shape[0])[:, None] * columns + left) * int(np.prod(colors))
        rest = np.zeros((*model.shape, 3), dtype=np.float32)
        self._rest = np.zeros((*model.shape, 2), dtype=np.float32)
        self._rest = self.gradients_from_color(rest)[0]

    def gradients_from_color(self, color_change: Map) -> tuple[Slopes, Slopes | None]:
        """Gradients (H, W, 2) of a color change (H, W, 3), and their standard deviation if the table has one."""
        change = color_change if self._gain is None else color_change * self._gain
        out = np.empty((*change.shape[:2], 3), dtype=np.float32)
        for rows in blocks_of(*change.shape[:2]):
            out[rows] = self._read(change[rows], self._first[rows])
        sigma = np.repeat(out[..., 2:], 2, axis=-1) if self._measured else None
        return out[..., :2] - self._rest, sigma

    def _read(self, change: Map, first: NDArray[np.intp]) -> Map:
        """Multilinear values (h, w, 3), from 8 corners of color in the one or two columns of nodes next to each pixel."""
        node, fraction = _node_and_fraction((change - self._low) / self._step, self._colors)
        _, greens, blues = self._colors
        strides = np.array([greens * blues, blues, 1])
        lowest = first + node @ strides
        fractions = [(1 - up, up) for up in np.moveaxis(fraction, -1, 0)]
        total = np.zeros((*change.shape[:2], 3), dtype=np.float32)
        for right in (0, 1) if self._columns > 1 else (0,):
            column = self._right if right else 1 - self._right
            for r, g, b in product((0, 1), repeat=3):
                weight = column * fractions[0][r] * fractions[1][g] * fractions[2][b]
                at = lowest + right * int(np.prod(self._colors)) + int(strides @ (r, g, b))
                total += weight[..., None] * self._values.take(at, axis=0)
        return total


def _node_and_fraction(at: Array, sizes: int | NDArray[np.intp]) -> tuple[NDArray[np.intp], Array]:
    """The node below a position in nodes, and the fraction of the way to the next, 0-1; inside the grid."""
    clipped = np.clip(at, 0, np.asarray(sizes - 1, dtype=at.dtype))
    node = np.minimum(clipped.astype(np.intp), np.maximum(sizes - 2, 0))
    return node, (clipped - node).astype(at.dtype)


def _gain(background: Map) -> Map:
    """Factor from (I - I0)/255 to the gray levels of tables in the tradition of Dong and Yuan."""
    level = background + np.float32(1)
    return np.asarray(255 * (1 + 2 * (level.mean() / level - 1)), dtype=np.float32)


def _deviation(
    corners: scipy.sparse.csr_matrix, residual: Numbers, weight: Numbers, sizes: tuple[int, ...]
) -> Numbers:
    """Standard deviation (nodes,) of a slope component: the residuals about a node and its neighbors.

    Corners with samples of a weight below 1 around them are off the gamut. The typical deviation counts for 20 samples: a
    node with fewer has no reliable one of its own.
    """
    used = (weight > 0).astype(np.float64)
    size = np.minimum(np.sum(residual**2, axis=1) / 2, STEEPEST_GEL**2)
    count, sums = (np.asarray(corners.T @ values).reshape(sizes) for values in (used, used * size))
    for axis, length in enumerate(sizes):
        if length > 1:
            count, sums = (
                scipy.ndimage.uniform_filter1d(v, 3, axis=axis, mode="constant") * 3 for v in (count, sums)
            )
    typical = float(np.average(size, weights=used))
    prior = 20  # samples
    variance = (sums + prior * typical) / (count + prior)
    return np.where(count >= 1, np.sqrt(variance), STEEPEST_GEL).ravel()


NEIGHBORS = 16  # neighbors of a pixel: five times the unknowns of its line
LEAST_CHANGE = 0.02  # a table spans at least this change either way


@dataclass(frozen=True, eq=False)
class InterpolationModel(Stored, Untuned):
    """Thinned samples and the line of all of them. It is its own prepared model: its search tree is built once."""

    color: Numbers  # (M, 3), color changes of the samples that are kept
    x_px: Numbers  # (M,)
    y_px: Numbers  # (M,)
    gradients: Numbers  # (M, 2)
    line: Numbers  # (3, 2), gradients = color @ line over all samples
    color_scale: float  # size of a color change that is as far as `place_scale`
    place_scale: float  # in half the image's larger side
    spacing: float  # typical distance between samples, in these units
    shape: tuple[int, int]  # (H, W) of the images they come from

    name: ClassVar[str] = "interpolation"
    change_offset: ClassVar[float] = CHANGE_OFFSET

    @classmethod
    def fit(cls, samples: Samples, *, points: int = 4000, place_scale: float = 0.5) -> InterpolationModel:
        """Keep every n-th sample, about `points`; `place_scale` is the distance of neighbors in the image."""
        if points < NEIGHBORS or not place_scale > 0:
            raise ValueError(f"Expected points >= {NEIGHBORS}, place_scale > 0, got {points}, {place_scale}.")
        color = np.asarray(samples.color_change, dtype=np.float64)
        line = robust_ridge(color, samples.gradients, samples.weight, ridge=1e-4, huber=HUBER_SLOPE)
        scale = float(np.sqrt(np.mean(color**2))) + 1e-12
        step = max(1, round(len(color) / points))
        columns = (color, samples.x_px, samples.y_px, samples.gradients)
        kept = [np.ascontiguousarray(column[::step], dtype=np.float64) for column in columns]
        draft = cls(kept[0], kept[1], kept[2], kept[3], line, scale, place_scale, 1.0, samples.shape)
        if len(kept[0]) < NEIGHBORS:
            raise ValueError(f"Expected at least {NEIGHBORS} samples, got {len(kept[0])}.")
        apart = draft._tree.query(draft._tree.data, k=[NEIGHBORS // 4])[0]
        return replace(draft, spacing=float(np.median(apart)) + 1e-9)

    def gradients_at(self, color_change: Array, x_px: Array, y_px: Array) -> Numbers:
        """Gradients (N, 2) of scattered pixels."""
        return self.gradients_and_sigma_at(color_change, x_px, y_px)[0]

    def gradients_and_sigma_at(
        self, color_change: Array, x_px: Array, y_px: Array
    ) -> tuple[Numbers, Numbers]:
        """Gradients (N, 2) and their standard deviation (N, 2).

        The deviation is that of the neighbors about their line. For each typical spacing that a pixel is further
        away from its neighbors than they are from each other, it grows by a tenth of the slope.
        """
        color = np.asarray(color_change, dtype=np.float64)
        where = self._features(color, x_px, y_px)
        gradients, sigma = np.empty((len(color), 2)), np.empty((len(color), 2))
        for start in range(0, len(color), BLOCK_PX):
            part = slice(start, start + BLOCK_PX)
            gradients[part], sigma[part] = self._local(color[part], where[part])
        return gradients, sigma

    def prepare(self, background: Array, shape: tuple[int, int]) -> InterpolationModel:
        """Return the model itself."""
        check_image_shape(shape, self.shape)
        return self

    def gradients_from_color(self, color_change: Map) -> tuple[Slopes, Slopes]:
        """Gradients (H, W, 2) of a color change (H, W, 3), and their standard deviation."""
        found = self.gradients_and_sigma_at(color_change.reshape(-1, 3), *pixel_positions(self.shape).T)
        gradients, sigma = (part.reshape(*self.shape, 2).astype(np.float32) for part in found)
        return gradients, sigma

    def at_size(self, shape: tuple[int, int], wider: float) -> InterpolationModel:
        """As `ColorModel.at_size`."""
        x, y = ((at + 0.5) / wider - 0.5 for at in (self.x_px, self.y_px))
        return replace(self, x_px=x, y_px=y, shape=shape)

    @cached_property
    def _tree(self) -> Any:
        return scipy.spatial.cKDTree(self._features(self.color, self.x_px, self.y_px))

    def _features(self, color: Array, x_px: Array, y_px: Array) -> Numbers:
        """Coordinates (N, 5): color and place, each in its scale."""
        x, y = unit_position(x_px, y_px, self.shape)
        place = np.stack([x, y], axis=1) / self.place_scale
        return np.concatenate([color / self.color_scale, place], axis=1)

    def _local(self, color: Numbers, where: Numbers) -> tuple[Numbers, Numbers]:
        """One ridge regression per pixel on its neighbors, weighted by a Gaussian of the distance."""
        distance, near = self._tree.query(where, k=NEIGHBORS)
        width = np.maximum(distance[:, NEIGHBORS // 2], self.spacing)[:, None]
        weight = np.exp(-0.5 * (distance / width) ** 2)
        weight /= weight.sum(axis=1, keepdims=True)
        c, rest = self.color[near], self.gradients[near] - self.color[near] @ self.line
        weighted = c * weight[..., None]
        # Definite by what neighbors with larger color changes count more than: the line of all.
        normal = weighted.transpose(0, 2, 1) @ c + (0.3 * self.color_scale) ** 2 * np.eye(3)
        change = np.linalg.solve(normal, weighted.transpose(0, 2, 1) @ rest)
        gradients = color @ self.line + np.einsum("nc,nck->nk", color, change)
        spread = np.einsum("nm,nmk->nk", weight, (rest - c @ change) ** 2)
        extra = np.maximum(distance[:, NEIGHBORS // 4] / self.spacing - 1, 0)[:, None]
        doubt = 0.1 * extra * np.linalg.norm(gradients, axis=1, keepdims=True)
        return gradients, np.sqrt(spread + doubt**2)
