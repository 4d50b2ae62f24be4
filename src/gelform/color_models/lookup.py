"""A table over colour change and place, fitted by lattice regression, read by multilinear interpolation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.sparse import csr_matrix

from gelform.color_models._shared.lattice import Lattice, corner_weights, held_out_residuals
from gelform.color_models.seam import Samples, Variant, check_image_shape

OFF_GAMUT_SIGMA = 1.0
NODES = 11  # per channel
RANGE = (0.2, 99.8)  # percentiles of the samples' colour change that the table spans
MIN_SAMPLES = 1.0  # corners with less weight of samples about them are off the gamut
PRIOR_SAMPLES = 20.0


@dataclass(frozen=True)
class LookupModel:
    """Slopes at the nodes of a grid over (y, x, R, G, B).

    Attributes
    ----------
    table : (rows, columns, reds, greens, blues, 3) float32: two slopes and their standard deviation, which is
        OFF_GAMUT_SIGMA where no samples were; 0 everywhere where nobody knows it
    low, step : (3,) colour change of the first node and between nodes, per channel
    shape : (H, W) of the images
    gain : "none", or "mean_over_background" for tables of grey levels times 1 + 2 (mean(I0)/I0 - 1)
    background : (H, W, 3) float32, with that gain: the image that it was imported with
    """

    table: NDArray[np.float32]
    low: NDArray[np.float64]
    step: NDArray[np.float64]
    shape: tuple[int, int]
    gain: Literal["none", "mean_over_background"] = "none"
    background: NDArray[np.float32] | None = None

    name: ClassVar[str] = "lookup"
    change_offset: ClassVar[float] = 10.0
    slow: ClassVar[bool] = True

    @classmethod
    def fit(
        cls,
        samples: Samples,
        *,
        nodes: int = NODES,
        positions: tuple[int, int] = (3, 4),
        smoothness: float = 0.02,
    ) -> LookupModel:
        """Fit on the samples, in seconds; in the order of their presses, so that residuals are of other presses.

        Parameters
        ----------
        nodes : per channel
        positions : nodes over (rows, columns) of the image; (1, 1) for a table over colour alone
        smoothness : weight of the second differences, relative to the samples
        """
        if nodes < 4 or min(positions) < 1:
            raise ValueError(f"Expected at least 4 nodes and 1 position, got {nodes} and {positions}.")
        change = np.asarray(samples.color_change, dtype=np.float64)
        low, step = _grid(change, nodes)
        sizes = (*positions, nodes, nodes, nodes)
        grid = cls(np.zeros((*sizes, 3), np.float32), low, step, samples.shape)
        corners = corner_weights(grid._coordinates(change, samples.x_px, samples.y_px), sizes)
        weight = np.asarray(samples.weight, dtype=np.float64)
        target = np.asarray(samples.gradients, dtype=np.float64)
        lattice = Lattice(sizes, grid._zero_node(), smoothness)
        slopes = lattice.fitted(corners, target, weight)
        residual = held_out_residuals(lattice, corners, target, weight)
        sigma = _deviation(corners, residual, weight, sizes)
        table = np.concatenate([slopes, sigma[:, None]], axis=1).reshape(*sizes, 3)
        return cls(table.astype(np.float32), low, step, samples.shape)

    @classmethod
    def variants(cls, presses: int) -> list[Variant]:
        """Itself: a number for each node of its table over colour."""
        return [Variant(complexity=NODES**3)]

    def gradients_at(
        self, color_change: NDArray[Any], x_px: NDArray[Any], y_px: NDArray[Any]
    ) -> NDArray[np.float64]:
        """Gradients (N, 2) of scattered pixels."""
        change = np.asarray(color_change, dtype=np.float64)
        if self.background is not None:
            gain = _gain(self.background)
            change = change * gain[np.asarray(y_px, dtype=int), np.asarray(x_px, dtype=int)]
        sizes = self.table.shape[:-1]
        corners = corner_weights(self._coordinates(change, x_px, y_px), sizes)
        at_rest = corner_weights(self._coordinates(0 * change, x_px, y_px), sizes)
        slopes: NDArray[np.float64] = (corners - at_rest) @ self.table.reshape(-1, 3)[:, :2].astype(
            np.float64
        )
        return slopes

    def prepare(self, background: NDArray[Any], shape: tuple[int, int]) -> PreparedLookup:
        """The gain of each pixel and its place in the table."""
        check_image_shape(shape, self.shape)
        gain = None if self.gain == "none" else _gain(np.asarray(background, dtype=np.float32))
        return PreparedLookup(self, gain)

    def to_arrays(self) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """The table, its axes, and the background that an imported gain needs."""
        arrays: dict[str, NDArray[Any]] = {"table": self.table, "low": self.low, "step": self.step}
        if self.background is not None:
            arrays["background"] = self.background
        return arrays, {"shape": list(self.shape), "gain": self.gain}

    @classmethod
    def from_arrays(cls, arrays: dict[str, NDArray[Any]], settings: dict[str, Any]) -> LookupModel:
        """The model of `to_arrays`."""
        height, width = settings["shape"]
        axes = arrays["low"], arrays["step"]
        return cls(arrays["table"], *axes, (height, width), settings["gain"], arrays.get("background"))

    def _coordinates(
        self, change: NDArray[Any], x_px: NDArray[Any], y_px: NDArray[Any]
    ) -> list[NDArray[np.float64]]:
        """Position of samples on the five axes, in nodes."""
        rows, columns = self.table.shape[:2]
        height, width = self.shape
        places = [
            np.asarray(y_px, dtype=np.float64) * ((rows - 1) / max(height - 1, 1)),
            np.asarray(x_px, dtype=np.float64) * ((columns - 1) / max(width - 1, 1)),
        ]
        return places + [(change[:, c] - self.low[c]) / self.step[c] for c in range(3)]

    def _zero_node(self) -> tuple[int, ...]:
        """Indices of the node of no change on the color axes."""
        return tuple(np.rint(-self.low / self.step).astype(int).tolist())


class PreparedLookup:
    """A table over frames of one shape; immutable, shared by threads."""

    def __init__(self, model: LookupModel, gain: NDArray[np.float32] | None) -> None:
        rows, columns = model.table.shape[:2]
        self._table, self._gain = model.table, gain
        self._measured = bool(model.table[..., 2].any())
        self._low, self._step = model.low.astype(np.float32), model.step.astype(np.float32)
        self._y = np.linspace(0, rows - 1, model.shape[0]).astype(np.float32)
        self._x = np.linspace(0, columns - 1, model.shape[1]).astype(np.float32)
        rest = np.zeros((*model.shape, 3), dtype=np.float32)
        self._rest = np.zeros((*model.shape, 2), dtype=np.float32)
        self._rest = self.gradients_from_color(rest)[0]

    def gradients_from_color(
        self, color_change: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        """Gradients (H, W, 2) of a color change (H, W, 3), and their standard deviation where the table holds one."""
        change = color_change if self._gain is None else color_change * self._gain
        out = np.empty((*change.shape[:2], 3), dtype=np.float32)
        _read(self._table, self._low, self._step, self._y, self._x, change, out)
        sigma = np.repeat(out[..., 2:], 2, axis=-1) if self._measured else None
        return out[..., :2] - self._rest, sigma


def _gain(background: NDArray[np.float32]) -> NDArray[np.float32]:
    """From (I - I0)/255 to the grey levels of tables in the tradition of Dong and Yuan."""
    level = background + np.float32(1)
    return np.asarray(255 * (1 + 2 * (level.mean() / level - 1)), dtype=np.float32)


def _grid(change: NDArray[np.float64], nodes: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """First node and spacing per channel: the samples' range, with a node at no change."""
    low, high = np.percentile(change, RANGE, axis=0)
    low, high = np.minimum(low, -0.02), np.maximum(high, 0.02)
    step = (high - low) / (nodes - 2)
    return -np.ceil(-low / step) * step, step


def _deviation(
    corners: csr_matrix, residual: NDArray[np.float64], weight: NDArray[np.float64], sizes: tuple[int, ...]
) -> NDArray[np.float64]:
    """Standard deviation (nodes,) of a slope component: the residuals about a node and its neighbours."""
    used = (weight > 0).astype(np.float64)
    size = np.minimum(np.sum(residual**2, axis=1) / 2, OFF_GAMUT_SIGMA**2)
    count, sums = (np.asarray(corners.T @ values).reshape(sizes) for values in (used, used * size))
    for axis, length in enumerate(sizes):
        if length > 1:
            count, sums = (uniform_filter1d(v, 3, axis=axis, mode="constant") * 3 for v in (count, sums))
    typical = float(np.average(size, weights=used))
    variance = (sums + PRIOR_SAMPLES * typical) / (count + PRIOR_SAMPLES)
    return np.where(count >= MIN_SAMPLES, np.sqrt(variance), OFF_GAMUT_SIGMA).ravel()


@njit(cache=True, fastmath=True, nogil=True)
def _read(table, low, step, ys, xs, change, out):  # type: ignore[no-untyped-def]
    """Each row: the table between its two rows of places; each pixel: 2 x 8 corners of three values."""
    height, width, _ = change.shape
    rows, columns, reds, greens, blues, _ = table.shape
    row = np.empty(table.shape[1:], np.float32)
    for y in range(height):
        top = min(int(ys[y]), max(rows - 2, 0))
        part = ys[y] - np.float32(top)
        row[:] = table[top]
        if rows > 1:
            row += part * (table[top + 1] - table[top])
        for x in range(width):
            left = min(int(xs[x]), max(columns - 2, 0))
            share = xs[x] - np.float32(left)
            r, a = _cell((change[y, x, 0] - low[0]) / step[0], reds)
            g, b = _cell((change[y, x, 1] - low[1]) / step[1], greens)
            k, c = _cell((change[y, x, 2] - low[2]) / step[2], blues)
            for n in range(3):
                value = _corner_mean(row[left], r, g, k, a, b, c, n)
                if columns > 1:
                    value += share * (_corner_mean(row[left + 1], r, g, k, a, b, c, n) - value)
                out[y, x, n] = value


@njit(cache=True, fastmath=True, nogil=True, inline="always")
def _cell(at, size):  # type: ignore[no-untyped-def]
    """The node below and the share of the one above, inside the grid."""
    clipped = min(max(at, np.float32(0)), np.float32(size - 1))
    index = min(int(clipped), size - 2)
    return index, clipped - np.float32(index)


@njit(cache=True, fastmath=True, nogil=True, inline="always")
def _corner_mean(cube, r, g, k, a, b, c, n):  # type: ignore[no-untyped-def]
    """Trilinear value n of a (reds, greens, blues, 3) cube."""
    one = np.float32(1)
    near = (one - b) * ((one - c) * cube[r, g, k, n] + c * cube[r, g, k + 1, n])
    near += b * ((one - c) * cube[r, g + 1, k, n] + c * cube[r, g + 1, k + 1, n])
    far = (one - b) * ((one - c) * cube[r + 1, g, k, n] + c * cube[r + 1, g, k + 1, n])
    far += b * ((one - c) * cube[r + 1, g + 1, k, n] + c * cube[r + 1, g + 1, k + 1, n])
    return (one - a) * near + a * far
