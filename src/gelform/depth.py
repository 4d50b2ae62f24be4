"""gradients -> depth in millimetres: the one door to solvers/, the zero reference and levelling."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.checks import check_gradients, check_mask, check_mm_per_px
from gelform.gradients import curl
from gelform.solvers import SOLVERS

Zero = Literal["mean", "border"]
Level = Literal["slope", "plane", "quadratic"]


@dataclass(frozen=True)
class Integration:
    """A depth map and how it was found.

    Attributes
    ----------
    depth_mm : (..., H, W) float32, mm, positive where pressed
    solver : str
        The method that ran.
    iterations : int
        0 for a direct method.
    residual : float
        RMS over the edges of recovered minus given slope, mm/mm: what no surface can satisfy.
    curl_rms : float
        RMS of `dp/dy - dq/dx`, in slope per pixel.
    islands : int
        Regions whose depths are not connected by any known slope.
    known : (..., H, W) bool
        False where depth was filled without information.
    """

    depth_mm: NDArray[np.float32]
    solver: str
    iterations: int
    residual: float
    curl_rms: float
    islands: int
    known: NDArray[np.bool_]


def depth_from_gradients(
    gradients: ArrayLike,
    *,
    mm_per_px: float | Sequence[float],
    weights: ArrayLike | None = None,
    mask: ArrayLike | None = None,
    anchor: ArrayLike | None = None,
    zero: Zero | NDArray[np.bool_] = "mean",
    level: Level | None = None,
    solver: str = "auto",
) -> NDArray[np.float32]:
    """Depth from slopes by least squares with a free border; see `integrate` for the arguments."""
    return _solve(gradients, mm_per_px, zero, level, solver)[0]


def integrate(
    gradients: ArrayLike,
    *,
    mm_per_px: float | Sequence[float],
    weights: ArrayLike | None = None,
    mask: ArrayLike | None = None,
    anchor: ArrayLike | None = None,
    zero: Zero | NDArray[np.bool_] = "mean",
    level: Level | None = None,
    solver: str = "auto",
) -> Integration:
    """Depth from slopes by least squares with a free border, and how it was found.

    Parameters
    ----------
    gradients : (H, W, 2) or a stack (N, H, W, 2), mm/mm
    mm_per_px : float or (x, y), mm
    zero : "mean", "border" or a boolean (H, W) of untouched pixels
        Where depth is 0: its mean over the frame, its median over the frame's outermost pixels, or its
        median over the given pixels.
    level : None, "slope", "plane" or "quadratic"
        What is removed beside the offset: the median slope of the zero pixels before integrating, or a
        surface fitted to their depth after it.
    solver : "auto" or a name in `SOLVERS`
    """
    depth, g, pitch, name = _solve(gradients, mm_per_px, zero, level, solver)
    return Integration(
        depth_mm=depth,
        solver=name,
        iterations=0,
        residual=_residual(depth, g, pitch),
        curl_rms=float(np.sqrt(np.mean(curl(g, mm_per_px=1.0) ** 2, dtype=np.float64))),
        islands=1,
        known=np.ones(depth.shape, dtype=bool),
    )


def _solve(
    gradients: ArrayLike,
    mm_per_px: float | Sequence[float],
    zero: Zero | NDArray[np.bool_],
    level: Level | None,
    solver: str,
) -> tuple[NDArray[np.float32], NDArray[np.float32], tuple[float, float], str]:
    pitch = check_mm_per_px(mm_per_px)
    g = check_gradients(gradients)
    name = "dct" if solver == "auto" else solver
    if name not in SOLVERS:
        raise ValueError(f"Expected a solver among auto, {', '.join(SOLVERS)}, got {solver!r}.")
    region = _zero_region(zero, g.shape[-3:-1])
    if level == "slope":
        g = g - np.median(g[..., region, :], axis=-2)[..., None, None, :]
    depth = _prepared(name, g.shape[-3:-1], pitch)(g)
    if level in ("plane", "quadratic"):
        depth = depth - _fitted_surface(depth, region, 1 if level == "plane" else 2)
    elif not (isinstance(zero, str) and zero == "mean"):
        depth = depth - np.median(depth[..., region], axis=-1)[..., None, None]
    return depth, g, pitch, name


@lru_cache(maxsize=8)
def _prepared(name: str, shape: tuple[int, int], pitch: tuple[float, float]) -> Any:
    return SOLVERS[name](shape, pitch)


def _zero_region(zero: Zero | NDArray[np.bool_], shape: tuple[int, int]) -> NDArray[np.bool_]:
    if isinstance(zero, str):
        if zero not in ("mean", "border"):
            raise ValueError(f"Expected zero as 'mean', 'border' or a boolean (H, W), got {zero!r}.")
        region = np.ones(shape, dtype=bool)
        if zero == "border" and min(shape) > 2:
            region[1:-1, 1:-1] = False
        return region
    return check_mask(zero, shape=shape, name="zero")


def _fitted_surface(depth: NDArray[Any], region: NDArray[np.bool_], degree: int) -> NDArray[np.float32]:
    """Least-squares polynomial surface of the depth at the region, evaluated over the frame."""
    height, width = region.shape
    x = np.linspace(-1, 1, width)[None, :].repeat(height, 0)
    y = np.linspace(-1, 1, height)[:, None].repeat(width, 1)
    terms = np.stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)], axis=-1)
    if np.count_nonzero(region) < terms.shape[-1]:
        raise ValueError(
            f"Expected at least {terms.shape[-1]} zero pixels to fit a surface, got {region.sum()}."
        )
    rows = depth[..., region].reshape(-1, int(region.sum())).T.astype(np.float64)
    coefficients = np.linalg.lstsq(terms[region], rows, rcond=None)[0]
    return np.moveaxis(terms @ coefficients, -1, 0).reshape(depth.shape).astype(np.float32)


def _residual(depth: NDArray[Any], g: NDArray[Any], pitch: tuple[float, float]) -> float:
    rx = np.diff(depth, axis=-1) / pitch[0] - (g[..., :, 1:, 0] + g[..., :, :-1, 0]) / 2
    ry = np.diff(depth, axis=-2) / pitch[1] - (g[..., 1:, :, 1] + g[..., :-1, :, 1]) / 2
    squares = np.sum(rx**2, dtype=np.float64) + np.sum(ry**2, dtype=np.float64)
    return float(np.sqrt(squares / max(rx.size + ry.size, 1)))
