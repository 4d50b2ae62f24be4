"""Gradients from the nearest samples in (R, G, B, x, y): a line through the origin of color, fitted at each pixel.

It is local linear regression (W. S. Cleveland, J. Am. Stat. Assoc. 74, 1979) without a constant, pulled to the line of
all samples where the neighbors do not determine it. Unlike parametric models, it measures the distance of a pixel from
its samples. It is slow: seconds for a frame.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import scipy  # its parts load at first use
from numpy.typing import NDArray

from gelform.foundations.filters import CHANGE_OFFSET
from gelform.image.view.resample import pixel_positions
from gelform.slopes.color_models._shared.least_squares import HUBER_SLOPE, robust_ridge, unit_position
from gelform.slopes.color_models.seam import Samples, Stored, Untuned, check_image_shape

NEIGHBORS = 16  # neighbors of a pixel: five times the unknowns of its line
POINTS = 4000  # samples that are kept, for speed
CHUNK = 20_000  # pixels at a time, to limit memory
PRIOR = 0.3  # of the color change's size; neighbors with larger changes count more than the line of all


@dataclass(frozen=True, eq=False)
class InterpolationModel(Stored, Untuned):
    """Thinned samples and the line of all of them.

    Attributes
    ----------
    color : (M, 3) float64, color changes of the samples that are kept
    x_px, y_px : (M,) float64
    gradients : (M, 2) float64
    line : (3, 2) float64, gradients = color @ line over all samples
    color_scale : size of a color change that is as far as `place_scale`
    place_scale : in half the image's larger side
    spacing : typical distance between samples, in these units
    shape : (H, W) of the images they come from
    """

    color: NDArray[np.float64]
    x_px: NDArray[np.float64]
    y_px: NDArray[np.float64]
    gradients: NDArray[np.float64]
    line: NDArray[np.float64]
    color_scale: float
    place_scale: float
    spacing: float
    shape: tuple[int, int]

    name: ClassVar[str] = "interpolation"
    change_offset: ClassVar[float] = CHANGE_OFFSET

    @classmethod
    def fit(cls, samples: Samples, *, points: int = POINTS, place_scale: float = 0.5) -> InterpolationModel:
        """Keep every n-th sample, about `points`; `place_scale` is the distance of neighbors in the image."""
        if points < NEIGHBORS or not place_scale > 0:
            raise ValueError(
                f"Expected points >= {NEIGHBORS} and place_scale > 0, got {points}, {place_scale}."
            )
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

    def gradients_at(
        self, color_change: NDArray[Any], x_px: NDArray[Any], y_px: NDArray[Any]
    ) -> NDArray[np.float64]:
        """Gradients (N, 2) of scattered pixels."""
        return self.gradients_and_sigma_at(color_change, x_px, y_px)[0]

    def gradients_and_sigma_at(
        self, color_change: NDArray[Any], x_px: NDArray[Any], y_px: NDArray[Any]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Gradients (N, 2) and their standard deviation (N, 2).

        The deviation is that of the neighbors about their line. For each typical spacing that a pixel is further
        away from its neighbors than they are from each other, it grows by a tenth of the slope.
        """
        color = np.asarray(color_change, dtype=np.float64)
        where = self._features(color, x_px, y_px)
        gradients, sigma = np.empty((len(color), 2)), np.empty((len(color), 2))
        for start in range(0, len(color), CHUNK):
            part = slice(start, start + CHUNK)
            gradients[part], sigma[part] = self._local(color[part], where[part])
        return gradients, sigma

    def prepare(self, background: NDArray[Any], shape: tuple[int, int]) -> PreparedInterpolation:
        """Return the model itself, whose search tree is built once."""
        check_image_shape(shape, self.shape)
        return PreparedInterpolation(self)

    @cached_property
    def _tree(self) -> Any:
        return scipy.spatial.cKDTree(self._features(self.color, self.x_px, self.y_px))

    def _features(self, color: NDArray[Any], x_px: NDArray[Any], y_px: NDArray[Any]) -> NDArray[np.float64]:
        """Coordinates (N, 5): color and place, each in its scale."""
        x, y = unit_position(x_px, y_px, self.shape)
        place = np.stack([x, y], axis=1) / self.place_scale
        return np.concatenate([color / self.color_scale, place], axis=1)

    def _local(
        self, color: NDArray[np.float64], where: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """One ridge regression per pixel on its neighbors, weighted by a Gaussian of the distance."""
        distance, near = self._tree.query(where, k=NEIGHBORS)
        width = np.maximum(distance[:, NEIGHBORS // 2], self.spacing)[:, None]
        weight = np.exp(-0.5 * (distance / width) ** 2)
        weight /= weight.sum(axis=1, keepdims=True)
        c, rest = self.color[near], self.gradients[near] - self.color[near] @ self.line
        weighted = c * weight[..., None]
        normal = weighted.transpose(0, 2, 1) @ c + (PRIOR * self.color_scale) ** 2 * np.eye(3)
        # definite by PRIOR
        change = np.linalg.solve(normal, weighted.transpose(0, 2, 1) @ rest)
        gradients = color @ self.line + np.einsum("nc,nck->nk", color, change)
        spread = np.einsum("nm,nmk->nk", weight, (rest - c @ change) ** 2)
        extra = np.maximum(distance[:, NEIGHBORS // 4] / self.spacing - 1, 0)[:, None]
        doubt = 0.1 * extra * np.linalg.norm(gradients, axis=1, keepdims=True)
        return gradients, np.sqrt(spread + doubt**2)


@dataclass(frozen=True)
class PreparedInterpolation:
    """An interpolation and the positions of all pixels."""

    model: InterpolationModel

    def gradients_from_color(
        self, color_change: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Gradients (H, W, 2) of a color change (H, W, 3), and their standard deviation."""
        shape = color_change.shape[:2]
        found = self.model.gradients_and_sigma_at(color_change.reshape(-1, 3), *pixel_positions(shape).T)
        gradients, sigma = (part.reshape(*shape, 2).astype(np.float32) for part in found)
        return gradients, sigma
