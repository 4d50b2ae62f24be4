"""Triangles: a closed mesh as an indenter, and the height of triangles viewed from above."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform._native import Kernel
from gelform.foundations.checks import check_finite
from gelform.simulate.indenters.faces import MAX_SIZE_MM

MAX_TRIANGLES = 5_000_000  # of a mesh; a larger file was meant for something else
MIN_SIZE_MM = 0.01  # mm, of a mesh; a smaller number is in another unit

_rasterise = Kernel(
    "rasterise",
    "f64[count,3] vertices, i64[faces,3] triangles, out f64[h,w] height, f64 x0, f64 y0, f64 hx, f64 hy",
)


@dataclass(frozen=True, eq=False)
class Mesh:
    """A closed triangle mesh; its side toward +z faces the gel.

    Its origin is the middle of its extent in x and y, at its highest point.

    Attributes
    ----------
    vertices_mm : (V, 3), x to the right, y down, z toward the camera
    triangles : (T, 3) int, indices into the vertices

    Raises
    ------
    ValueError
        No triangles, indices out of range, more than 5 million triangles, a mesh that is open (an edge
        without its two triangles), or a size that suggests another unit.
    """

    vertices_mm: ArrayLike
    triangles: ArrayLike

    def __post_init__(self) -> None:
        vertices = check_finite(np.ascontiguousarray(self.vertices_mm, dtype=np.float64), "vertices_mm")
        triangles = np.ascontiguousarray(self.triangles, dtype=np.int64)
        check_mesh(vertices, triangles)
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        shift = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, high[2]])
        object.__setattr__(self, "vertices_mm", vertices - shift)
        object.__setattr__(self, "triangles", triangles)

    def face_mm(self, x_mm: NDArray[Any], y_mm: NDArray[Any]) -> NDArray[np.float64]:
        return height_of_triangles(np.asarray(self.vertices_mm), np.asarray(self.triangles), x_mm, y_mm)


def check_mesh(vertices: NDArray[Any], triangles: NDArray[Any]) -> None:
    """Refuse a mesh that cannot be pressed; see `Mesh`."""
    if vertices.ndim != 2 or vertices.shape[1] != 3 or triangles.ndim != 2 or triangles.shape[1] != 3:
        raise ValueError(
            f"Expected vertices_mm (V, 3) and triangles (T, 3), got {vertices.shape} and {triangles.shape}."
        )
    if len(triangles) == 0:
        raise ValueError("Expected a mesh with triangles, got an empty one.")
    if len(triangles) > MAX_TRIANGLES:
        raise ValueError(
            f"Expected at most {MAX_TRIANGLES} triangles, got {len(triangles)}. Simplify the mesh first."
        )
    if triangles.min() < 0 or triangles.max() >= len(vertices):
        raise ValueError(f"Expected triangles with indices in 0-{len(vertices) - 1}.")
    size = float(np.ptp(vertices, axis=0).max())
    if not MIN_SIZE_MM <= size <= MAX_SIZE_MM:
        raise ValueError(
            f"Expected a mesh of {MIN_SIZE_MM}-{MAX_SIZE_MM:g} mm, got {size:.4g} mm. Is it in another unit? "
            "Scale it: meters x 1000, inches x 25.4."
        )
    _check_closed(vertices, triangles)


def _check_closed(vertices: NDArray[Any], triangles: NDArray[Any]) -> None:
    _, merged = np.unique(vertices, axis=0, return_inverse=True)  # an STL repeats its vertices
    corners = merged.reshape(-1)[triangles]
    edges = np.sort(np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]), axis=1)
    edges = edges[edges[:, 0] != edges[:, 1]]
    _, count = np.unique(edges, axis=0, return_counts=True)
    open_edges = int(np.count_nonzero(count % 2))
    if open_edges:
        raise ValueError(
            f"Expected a closed mesh, got one with {open_edges} edges that border only one triangle. "
            "Close its holes first (in trimesh: mesh.fill_holes())."
        )


def height_of_triangles(
    vertices: NDArray[np.float64], triangles: NDArray[np.int64], x_mm: NDArray[Any], y_mm: NDArray[Any]
) -> NDArray[np.float64]:
    """Height of the topmost triangle over each point of a regular grid; -inf where there is none.

    Parameters
    ----------
    vertices : (V, 3), triangles : (T, 3)
    x_mm, y_mm : (1, W) and (H, 1), evenly spaced
    """
    x, y = np.ravel(x_mm).astype(np.float64), np.ravel(y_mm).astype(np.float64)
    if np.shape(x_mm) != (1, x.size) or np.shape(y_mm) != (y.size, 1):
        raise ValueError(
            f"Expected a regular grid (1, W) and (H, 1), got {np.shape(x_mm)} and {np.shape(y_mm)}."
        )
    out = np.full((y.size, x.size), -np.inf)
    pitch_x, pitch_y = (x[-1] - x[0]) / (x.size - 1), (y[-1] - y[0]) / (y.size - 1)
    _rasterise(vertices, triangles, out, x[0], y[0], pitch_x, pitch_y)
    return out
