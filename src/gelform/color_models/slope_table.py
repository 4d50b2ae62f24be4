"""Taxim's forward table, inverted: which slope gives this colour change at this place.

The table says what colour change a slope angle in a direction gives, as a quadratic in the place (Si and Yuan,
Taxim, IEEE RA-L 7(2), 2022, section III-B). Each pixel's slope is found from a coarse search over the table,
then by Gauss-Newton steps on the squared difference of the three channels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from gelform.color_models.seam import check_image_shape

FADED_DEG = 10.0  # the table's own answer at slope 0 is subtracted there, and less and less up to this angle
SMOOTHED_BINS = 1.0
STEEPEST_DEG = 60.0
SEARCHED = (12, 24)  # slope angles, directions
STEPS = 8
NUDGE = 0.01


@dataclass(frozen=True)
class SlopeTableModel:
    """A forward model of a sensor, and its inverse.

    Attributes
    ----------
    table : (angles, directions, 3, 6) float32; of a slope angle 0-90 deg and a direction -180 to 180 deg (of the
        gradient, x right, y down), channel R, G, B and the terms u^2, v^2, u v, u, v, 1 of the place, in units
        of 255 grey levels. u and v run from 0 to 1 over the image.
    shape : (H, W) of the images
    """

    table: NDArray[np.float32]
    shape: tuple[int, int]

    name: ClassVar[str] = "slope_table"
    change_offset: ClassVar[float] = 0.0

    def __post_init__(self) -> None:
        sizes = self.table.shape
        if self.table.ndim != 4 or sizes[2:] != (3, 6) or min(sizes[:2]) < 4:
            raise ValueError(f"Expected a table of shape (angles, directions, 3, 6), got {sizes}.")
        if not np.isfinite(self.table).all():
            raise ValueError("Expected finite numbers in the table, got NaN or infinity.")

    def color_from_gradients(
        self, gradients: NDArray[Any], x_px: NDArray[Any], y_px: NDArray[Any]
    ) -> NDArray[np.float64]:
        """Expected color change (N, 3), (I - I0)/255, of gradients (N, 2) at pixel positions (N,).

        Bilinear between the table's bins, which are smoothed by one bin; 0 at slope 0.
        """
        change = np.empty((len(x_px), 3), dtype=np.float32)
        _render(self._faded(), *self._place(x_px, y_px), np.asarray(gradients, dtype=np.float32), change)
        return change.astype(np.float64)

    def gradients_at(
        self, color_change: NDArray[Any], x_px: NDArray[Any], y_px: NDArray[Any]
    ) -> NDArray[np.float64]:
        """Gradients (N, 2) of scattered pixels."""
        prepared = PreparedSlopeTable(self._faded(), *self._place(x_px, y_px))
        return prepared.gradients_from_color(np.asarray(color_change, dtype=np.float32))[0].astype(np.float64)

    def prepare(self, background: NDArray[Any], shape: tuple[int, int]) -> PreparedSlopeTable:
        """The table and each pixel's place in it."""
        check_image_shape(shape, self.shape, made="imported")
        y, x = (axis.ravel() for axis in np.mgrid[: shape[0], : shape[1]])
        return PreparedSlopeTable(self._faded(), *self._place(x, y))

    def to_arrays(self) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """The table as it was imported."""
        return {"table": self.table}, {"shape": list(self.shape)}

    @classmethod
    def from_arrays(cls, arrays: dict[str, NDArray[Any]], settings: dict[str, Any]) -> SlopeTableModel:
        """The model of `to_arrays`."""
        height, width = settings["shape"]
        return cls(arrays["table"], (height, width))

    def _faded(self) -> NDArray[np.float32]:
        """The table, its bins evened out (they were fitted apart), without its own answer at slope 0."""
        angles = np.arange(self.table.shape[0]) * 90.0 / (self.table.shape[0] - 1)
        fade = np.maximum(0, 1 - angles / FADED_DEG).astype(np.float32)
        faded = self.table - fade[:, None, None, None] * self.table[:1]
        core = gaussian_filter1d(faded[:, :-1], SMOOTHED_BINS, axis=1, mode="wrap")
        core = gaussian_filter1d(core, SMOOTHED_BINS, axis=0, mode="nearest")
        core -= fade[:, None, None, None] * core[:1]
        faded = np.concatenate([core, core[:, :1]], axis=1)
        return np.asarray(faded, dtype=np.float32)

    def _place(
        self, x_px: NDArray[Any], y_px: NDArray[Any]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        height, width = self.shape
        u, v = (np.asarray(x_px) + 0.5) / width, (np.asarray(y_px) + 0.5) / height
        return u.astype(np.float32), v.astype(np.float32)


class PreparedSlopeTable:
    """The inverse for pixels at given places; immutable, shared by threads."""

    def __init__(self, table: NDArray[np.float32], u: NDArray[np.float32], v: NDArray[np.float32]) -> None:
        self._table, self._u, self._v = table, u, v
        angles, directions = SEARCHED
        steep = np.deg2rad(STEEPEST_DEG) * (np.arange(angles) + 1) / angles
        turn = 2 * np.pi * np.arange(directions) / directions
        slopes = np.tan(steep)[:, None, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
        self._starts = np.concatenate([np.zeros((1, 2)), slopes.reshape(-1, 2)]).astype(np.float32)
        self._terms = np.stack([_blended(table, p, q) for p, q in self._starts])

    def gradients_from_color(self, color_change: NDArray[np.float32]) -> tuple[NDArray[np.float32], None]:
        """Gradients (..., 2) of a color change (..., 3), (I - I0)/255; their deviation is not known."""
        change = np.ascontiguousarray(color_change.reshape(-1, 3), dtype=np.float32)
        gradients = np.empty((len(change), 2), dtype=np.float32)
        _invert(self._table, self._u, self._v, change, self._starts, self._terms, gradients)
        return gradients.reshape(*color_change.shape[:-1], 2), None


def _blended(table: NDArray[np.float32], p: float, q: float) -> NDArray[np.float32]:
    """The coefficients (3, 6) at a slope."""
    i, j0, j1, s, t = _corners(table, np.float32(p), np.float32(q))
    near = (1 - t) * table[i, j0] + t * table[i, j1]
    return np.asarray(
        (1 - s) * near + s * ((1 - t) * table[i + 1, j0] + t * table[i + 1, j1]), dtype=np.float32
    )


@njit(cache=True, nogil=True, fastmath=True)
def _corners(table, p, q):  # type: ignore[no-untyped-def]
    """Bins around a slope, angle then direction (these go round), and how far between them it lies."""
    angles, directions = table.shape[0], table.shape[1] - 1
    i = np.arctan(np.sqrt(p * p + q * q)) * np.float32((angles - 1) / (np.pi / 2))
    i = min(max(i, np.float32(0)), np.float32(angles - 1.001))
    j = (np.arctan2(q, p) + np.float32(np.pi)) * np.float32(directions / (2 * np.pi)) - np.float32(0.5)
    i0, j0 = int(i), int(np.floor(j))
    return i0, j0 % directions, (j0 + 1) % directions, i - np.float32(i0), j - np.float32(j0)


@njit(cache=True, nogil=True, fastmath=True)
def _at(row, u, v):  # type: ignore[no-untyped-def]
    """The quadratic in the place."""
    return (row[0] * u + row[2] * v + row[3]) * u + (row[1] * v + row[4]) * v + row[5]


@njit(cache=True, nogil=True, fastmath=True)
def _color(table, p, q, u, v, out):  # type: ignore[no-untyped-def]
    """Change of the three channels at a slope and a place, bilinear between the bins."""
    i, j0, j1, s, t = _corners(table, p, q)
    for c in range(3):
        near = _at(table[i, j0, c], u, v)
        near += t * (_at(table[i, j1, c], u, v) - near)
        far = _at(table[i + 1, j0, c], u, v)
        far += t * (_at(table[i + 1, j1, c], u, v) - far)
        out[c] = near + s * (far - near)


@njit(cache=True, nogil=True)
def _render(table, u, v, gradients, out):  # type: ignore[no-untyped-def]
    for k in range(u.shape[0]):
        _color(table, gradients[k, 0], gradients[k, 1], u[k], v[k], out[k])


@njit(cache=True, nogil=True, fastmath=True)
def _distance(color, change):  # type: ignore[no-untyped-def]
    red, green, blue = color[0] - change[0], color[1] - change[1], color[2] - change[2]
    return red * red + green * green + blue * blue


@njit(cache=True, nogil=True, fastmath=True)
def _searched(terms, u, v, change, color):  # type: ignore[no-untyped-def]
    """Index of the nearest start, and of the nearest that is no neighbour of it in the list."""
    best, second = 0, 0
    least, next_least = np.float32(np.inf), np.float32(np.inf)
    for n in range(terms.shape[0]):
        for c in range(3):
            color[c] = _at(terms[n, c], u, v)
        distance = _distance(color, change)
        if distance < least:
            if n > best + 1:
                second, next_least = best, least
            best, least = n, distance
        elif distance < next_least and n > best + 1:
            second, next_least = n, distance
    return best, second


@njit(cache=True, nogil=True)
def _invert(table, u, v, change, starts, start_terms, out):  # type: ignore[no-untyped-def]
    """For each pixel the two nearest of the searched slopes, each improved; the better one."""
    color = np.empty((3, 3), np.float32)
    for k in range(u.shape[0]):
        one, other = _searched(start_terms, u[k], v[k], change[k], color[0])
        p, q, least = _improved(table, u[k], v[k], change[k], starts[one], color)
        if other != one and least > 0:
            p2, q2, now = _improved(table, u[k], v[k], change[k], starts[other], color)
            if now < least:
                p, q = p2, q2
        out[k, 0], out[k, 1] = p, q


@njit(cache=True, nogil=True)
def _improved(table, u, v, change, start, color):  # type: ignore[no-untyped-def]
    """Gauss-Newton steps, each halved until it improves; the slope and its squared distance."""
    p, q = start[0], start[1]
    here, right, down = color[0], color[1], color[2]
    _color(table, p, q, u, v, here)
    least = _distance(here, change)
    for _ in range(STEPS):
        if least == 0:
            break
        _color(table, p + np.float32(NUDGE), q, u, v, right)
        _color(table, p, q + np.float32(NUDGE), u, v, down)
        step_p, step_q = _step(here, right, down, change)
        better = False
        for _ in range(4):
            _color(table, p + np.float32(step_p), q + np.float32(step_q), u, v, right)
            better = _distance(right, change) < least
            if better:
                break
            step_p, step_q = step_p / 2, step_q / 2
        if not better:
            break
        p, q = p + np.float32(step_p), q + np.float32(step_q)
        _color(table, p, q, u, v, here)
        least = _distance(here, change)
    return p, q, least


@njit(cache=True, nogil=True)
def _step(here, right, down, change):  # type: ignore[no-untyped-def]
    """The Gauss-Newton step, slightly damped where the colours do not tell a direction."""
    a, b, c, d, e = 0.0, 0.0, 0.0, 0.0, 0.0
    for n in range(3):
        jp, jq = (right[n] - here[n]) / NUDGE, (down[n] - here[n]) / NUDGE
        r = change[n] - here[n]
        a, b, c, d, e = a + jp * jp, b + jp * jq, c + jq * jq, d + jp * r, e + jq * r
    damping = 1e-3 * (a + c) + 1e-9
    a, c = a + damping, c + damping
    determinant = a * c - b * b
    return (c * d - b * e) / determinant, (a * e - b * d) / determinant
