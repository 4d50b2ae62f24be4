"""Taxim's forward table, inverted: the slope for a color change at a place.

The table has the color change of a slope angle in a direction, as a quadratic in the place (Si and Yuan,
Taxim, IEEE RA-L 7(2), 2022, section III-B). Each pixel's slope comes from a coarse search over the table,
then from Gauss-Newton steps on the squared difference of the three channels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import scipy  # its parts load at first use
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.color_models.seam import check_image_shape
from gelform.view.resample import pixel_positions

FADED_DEG = (
    10.0  # degrees; the table's value at slope 0 is subtracted there, and less and less up to this angle
)
SMOOTHED_BINS = (
    1.0  # bins, standard deviation of the smoothing; bins were fitted separately from their neighbors
)
STEEPEST_SEARCHED_DEG = 60.0  # degrees, slope angle beyond those of a gel
SEARCHED = (12, 24)  # slope angles and directions; Gauss-Newton converges from the nearest of them

_slope_table_color = Kernel(
    "slope_table_color",
    "f32[angles,directions,3,6] values, f32[n] u, f32[n] v, finite f32[n,2] gradients, out f32[n,3] change",
)
_slope_table_gradients = Kernel(
    "slope_table_gradients",
    "f32[angles,directions,3,6] values, f32[n] u, f32[n] v, finite f32[n,3] change, f32[count,2] starts, "
    "f32[3,6,count] terms, out f32[n,2] gradients",
)


@dataclass(frozen=True)
class SlopeTableModel:
    """A forward model of a sensor, and its inverse.

    Attributes
    ----------
    table : (angles, directions, 3, 6) float32; of a slope angle 0-90 deg and a direction -180 to 180 deg (of the
        gradient, x right, y down), channel R, G, B and the terms u^2, v^2, u v, u, v, 1 of the place, in units
        of 255 gray levels. u and v run from 0 to 1 over the image.
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
        slopes = np.ascontiguousarray(gradients, dtype=np.float32)
        _slope_table_color(self._faded(), *self._place(x_px, y_px), slopes, change)
        return change.astype(np.float64)

    def gradients_at(
        self, color_change: NDArray[Any], x_px: NDArray[Any], y_px: NDArray[Any]
    ) -> NDArray[np.float64]:
        """Gradients (N, 2) of scattered pixels."""
        prepared = PreparedSlopeTable(self._faded(), *self._place(x_px, y_px))
        return prepared.gradients_from_color(np.asarray(color_change, dtype=np.float32))[0].astype(np.float64)

    def prepare(self, background: NDArray[Any], shape: tuple[int, int]) -> PreparedSlopeTable:
        """Prepare the table and each pixel's position in it."""
        check_image_shape(shape, self.shape, made="imported")
        return PreparedSlopeTable(self._faded(), *self._place(*pixel_positions(shape).T))

    def to_arrays(self) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """The table as it was imported."""
        return {"table": self.table}, {"shape": list(self.shape)}

    @classmethod
    def from_arrays(cls, arrays: dict[str, NDArray[Any]], settings: dict[str, Any]) -> SlopeTableModel:
        """The model of `to_arrays`."""
        height, width = settings["shape"]
        return cls(arrays["table"], (height, width))

    def _faded(self) -> NDArray[np.float32]:
        """The table with smoothed bins (they were fitted separately), without its own value at slope 0."""
        angles = np.arange(self.table.shape[0]) * 90.0 / (self.table.shape[0] - 1)
        fade = np.maximum(0, 1 - angles / FADED_DEG).astype(np.float32)
        faded = self.table - fade[:, None, None, None] * self.table[:1]
        core = scipy.ndimage.gaussian_filter1d(faded[:, :-1], SMOOTHED_BINS, axis=1, mode="wrap")
        core = scipy.ndimage.gaussian_filter1d(core, SMOOTHED_BINS, axis=0, mode="nearest")
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
    """The inverse for pixels at given places. It is immutable; threads can share it."""

    def __init__(self, table: NDArray[np.float32], u: NDArray[np.float32], v: NDArray[np.float32]) -> None:
        self._table, self._u, self._v = table, u, v
        angles, directions = SEARCHED
        steep = np.deg2rad(STEEPEST_SEARCHED_DEG) * (np.arange(angles) + 1) / angles
        turn = 2 * np.pi * np.arange(directions) / directions
        slopes = np.tan(steep)[:, None, None] * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
        self._starts = np.concatenate([np.zeros((1, 2)), slopes.reshape(-1, 2)]).astype(np.float32)
        self._terms = _searched_terms(table, self._starts)

    def gradients_from_color(self, color_change: NDArray[np.float32]) -> tuple[NDArray[np.float32], None]:
        """Gradients (..., 2) of a color change (..., 3), (I - I0)/255; their deviation is unknown."""
        change = np.ascontiguousarray(color_change.reshape(-1, 3), dtype=np.float32)
        gradients = np.empty((len(change), 2), dtype=np.float32)
        _slope_table_gradients(self._table, self._u, self._v, change, self._starts, self._terms, gradients)
        return gradients.reshape(*color_change.shape[:-1], 2), None


def _searched_terms(table: NDArray[np.float32], slopes: NDArray[np.float32]) -> NDArray[np.float32]:
    """Coefficients (3, 6, N) of the quadratic in the place at slopes (N, 2), bilinear between the table's bins."""
    angles, directions = table.shape[0], table.shape[1] - 1  # the last direction is the first again
    steep = np.arctan(np.hypot(slopes[:, 0], slopes[:, 1])) * np.float32((angles - 1) / (np.pi / 2))
    turn = np.arctan2(slopes[:, 1], slopes[:, 0]) + np.float32(np.pi)
    turn = turn * np.float32(directions / (2 * np.pi)) - np.float32(0.5)
    i, j = np.clip(steep, 0, angles - 2).astype(int), np.floor(turn).astype(int)
    s, t = (part.astype(np.float32)[:, None, None] for part in (steep - i, turn - j))
    near, far = ((1 - t) * table[k, j % directions] + t * table[k, (j + 1) % directions] for k in (i, i + 1))
    return np.ascontiguousarray(np.moveaxis((1 - s) * near + s * far, 0, -1))
