"""gradients -> depth in millimeters: the only entry to solvers/, its checks, the zero reference and leveling."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Literal, get_args

import cv2
import numpy as np
from numpy.typing import ArrayLike

from gelform.arrays import Array, Map, Mask, Slopes
from gelform.depth.coarse import RestAnchor
from gelform.depth.solvers import SOLVERS, Solution, Solver, Weights
from gelform.depth.solvers.seam import residual_rms
from gelform.errors import ConvergenceError
from gelform.foundations.checks import (
    as_array,
    check_choice,
    check_gradients,
    check_map,
    check_mask,
    check_mm_per_px,
    check_slopes,
)
from gelform.foundations.filters import MEDIAN_SAMPLES, fill_unknown, lattice_step, medians_where
from gelform.foundations.pool import once
from gelform.slopes.budget import ReadSlopes
from gelform.slopes.gradients import curl_rms


@dataclass(frozen=True)
class Integration:
    """A depth map and the way to it.

    Attributes
    ----------
    depth_mm : (..., H, W) float32, mm, positive where pressed
    solver : str
        The method that ran.
    iterations : int
        0 for a direct method; for a stack, the most that a frame took.
    known : (..., H, W) bool
        False where depth was filled without information.
    tolerance : float
        Estimated largest error of the iteration, relative to the range of depth; 0 for a direct method.
    gradients : (..., H, W, 2), the given slopes
    mm_per_px : (x, y), mm

    The other figures cover known pixels only and are computed on demand.
    """

    depth_mm: Map
    solver: str
    iterations: int
    known: Mask
    tolerance: float
    gradients: Slopes = field(repr=False)
    mm_per_px: tuple[float, float]

    @once
    def residual(self) -> float:
        """RMS over the edges of recovered minus given slope, mm/mm: the part that no surface can satisfy."""
        depth, gradients, known = self._stacked()
        return residual_rms(depth, gradients, known, *self.mm_per_px)

    @once
    def curl_rms(self) -> float:
        """RMS of `dp/dy - dq/dx`, in slope per pixel."""
        _, gradients, known = self._stacked()
        return curl_rms(gradients, None if known.all() else known)

    @once
    def islands(self) -> int:
        """Number of regions that no known slope connects; for a stack, the most in a frame."""
        return max(int(_islands(known).max()) for known in self._stacked()[2])

    def _stacked(self) -> tuple[Map, Map, Mask]:
        """Depth and known (N, H, W), gradients (N, H, W, 2)."""
        shape = (-1, *self.known.shape[-2:])
        return self.depth_mm.reshape(shape), self.gradients.reshape(*shape, 2), self.known.reshape(shape)


def depth_from_gradients(
    gradients: ArrayLike,
    *,
    mm_per_px: float | Sequence[float],
    weights: ArrayLike | tuple[ArrayLike, ArrayLike] | None = None,
    mask: ArrayLike | None = None,
    anchor: ArrayLike | None = None,
    zero: Zero | Mask = "mean",
    level: Level | None = None,
    solver: str = "auto",
) -> Slopes:
    """Depth from slopes by least squares with a free border; see `integrate` for the arguments."""
    solution = integrate(
        gradients,
        mm_per_px=mm_per_px,
        weights=weights,
        mask=mask,
        anchor=anchor,
        zero=zero,
        level=level,
        solver=solver,
    )
    return solution.depth_mm


def integrate(
    gradients: ArrayLike,
    *,
    mm_per_px: float | Sequence[float],
    weights: ArrayLike | tuple[ArrayLike, ArrayLike] | None = None,
    mask: ArrayLike | None = None,
    anchor: ArrayLike | None = None,
    zero: Zero | Mask = "mean",
    level: Level | None = None,
    solver: str = "auto",
) -> Integration:
    """Depth from slopes by least squares with a free border, and how it was found.

    Minimizes `sum wx (z_x - p)^2 + wy (z_y - q)^2 + anchor z^2/(hx hy)` over the edges between pixels.

    Parameters
    ----------
    gradients : (H, W, 2) or a stack (N, H, W, 2), mm/mm
    mm_per_px : float or (x, y), mm
    weights : (H, W), a stack of them, or a pair (wx, wy) of shapes (H, W-1) and (H-1, W); >= 0
        Confidence of each pixel's slopes, or of each edge. Slopes of weight under 1e-3 of the largest are
        replaced by a fill from their neighbors: their own values have no influence.
    mask : (H, W) bool
        Pixels that belong to the surface. Each island of them has its own zero; depth beyond is filled.
    anchor : float or (H, W), >= 0
        How firmly depth is held at 0, relative to weight 1: (sigma0 mm_per_px / sigma_zero_mm)^2. An island
        with an anchor takes its offset from it; `zero` moves only the other islands.
    zero : "mean", "border" or a boolean (H, W) of pixels at rest
        Where depth is 0: its mean over the frame, its median over the frame's outermost pixels, or its
        median over the given pixels.
    level : None, "slope", "plane" or "quadratic"
        Correction beside the offset: "slope" removes the median slope of the zero pixels before integrating;
        the others remove a surface fitted to the depth of the zero pixels after it. Use "slope" with an anchor: it
        removes a bias first, and leaves 2 um of it where the anchor alone leaves 19.
    solver : "auto" or a name in `SOLVERS`
        "auto" takes `dct` if weights, mask and anchor are all missing, else `multigrid`. If that does not
        converge, such as in a mesh of channels a few pixels wide, it takes `sparse`; the result names its solver.

    Raises
    ------
    ValueError, TypeError
        An argument of the wrong shape or range; weights for a solver that takes none.
    ConvergenceError
        The solver did not reach its tolerance.
    """
    g = check_gradients(gradients)
    check_slopes(g)
    shape = (g.shape[-3], g.shape[-2])
    if level is not None and not (isinstance(level, str) and level in get_args(Level)):
        raise ValueError(f"Expected level as None, 'slope', 'plane' or 'quadratic', got {level!r:.60}.")
    region = zero_region(zero, shape)
    if level == "slope":
        g = g - np.stack([median_over(g[..., c], region) for c in (0, 1)], axis=-1)[..., None, None, :]
    return IntegrationProblem(
        gradients=g,
        mm_per_px=check_mm_per_px(mm_per_px),
        weights=None if weights is None else check_weights(weights, g.shape[:-1]),
        mask=None if mask is None else check_mask(mask, shape=shape),
        anchor=None if anchor is None else check_anchor(anchor, shape),
        zero=zero,
        level=level,
        solver=check_choice(solver, ("auto", *SOLVERS), "a solver"),
    ).solved()


@dataclass(frozen=True)
class IntegrationProblem:
    """Checked arguments of `integrate`, which explains them. A Reconstructor makes one of a frame's own values.

    All arrays are finite and in C order, slopes within what `check_slopes` allows, weights and anchor >= 0.
    """

    gradients: Slopes
    mm_per_px: tuple[float, float]
    weights: Weights = None
    mask: Mask | None = None
    anchor: Map | None = None  # (H, W), not 0 everywhere
    zero: Zero | Mask = "mean"
    level: Level | None = None
    solver: str = "auto"

    @once
    def region(self) -> Mask:
        """The pixels (H, W) that define where depth is 0, of all frames of a stack."""
        return zero_region(self.zero, self.gradients.shape[-3:-1])  # type: ignore[arg-type]

    def solved(self) -> Integration:
        """Solve each frame of the stack and set its zero.

        ConvergenceError: the solver did not reach its tolerance.
        """
        if self.solver != "auto":
            return self._solved_by(self.solver)
        if self.weights is None and self.mask is None and self.anchor is None:
            return self._solved_by("dct")
        try:
            return self._solved_by("multigrid")
        except ConvergenceError:
            height, width = self.gradients.shape[-3:-1]
            if height * width > 1_000_000:  # px; to factorize so many takes 13 s and 2.2 GB
                raise
            return self._solved_by("sparse")

    def _solved_by(self, solver: str) -> Integration:
        g, weights = self.gradients, self.weights
        if g.ndim == 3:
            depth, known, iterations, tolerance = self._frame(solver, g, weights)
        else:
            stacked = isinstance(weights, np.ndarray) and weights.ndim > 2
            frames = [
                self._frame(solver, g[index], weights[index] if stacked else weights)  # type: ignore[index,call-overload]
                for index in np.ndindex(g.shape[:-3])
            ]
            depth, known = (np.stack(maps).reshape(g.shape[:-1]) for maps in list(zip(*frames))[:2])
            iterations, tolerance = max(f.iterations for f in frames), max(f.tolerance for f in frames)
        return Integration(depth, solver, iterations, known, tolerance, g, self.mm_per_px)

    def _frame(self, solver: str, gradients: Slopes, weights: Weights) -> Solution:
        prepared = _prepared(solver, (gradients.shape[0], gradients.shape[1]), self.mm_per_px)
        frame = prepared(gradients, weights, self.mask, self.anchor)
        return frame._replace(depth_mm=self._placed(frame.depth_mm))

    def _placed(self, depth: Map) -> Map:
        """Set the zero of each island that no anchor holds, level, then fill beyond the mask."""
        mask = self.mask
        if mask is None:
            if self.anchor is None:
                depth -= zero_depth(depth, self.zero, self.region)
            return self._levelled(depth)
        held = False if self.anchor is None else self.anchor > 0
        labels = _islands(mask)
        for island in range(1, int(labels.max()) + 1):
            inside = labels == island
            if not np.any(held & inside):
                depth[inside] -= zero_depth(depth, self.zero, self.region, inside)
        depth = self._levelled(depth)
        return depth if mask.all() else fill_unknown(depth[..., None], mask)[..., 0]

    def _levelled(self, depth: Map) -> Map:
        if self.level not in ("plane", "quadratic"):
            return depth
        region = self.region if self.mask is None else self.region & self.mask
        return depth - fitted_surface(depth, region, 1 if self.level == "plane" else 2)


@lru_cache(maxsize=8)
def _prepared(name: str, shape: tuple[int, int], pitch: tuple[float, float]) -> Solver:
    return SOLVERS[name](shape, pitch)


def _islands(known: Mask) -> Array:
    """Labels of the 4-connected regions, from 1."""
    if known.all():
        return known.view(np.uint8)
    return cv2.connectedComponents(known.astype(np.uint8), connectivity=4)[1]


Zero = Literal["mean", "border"]
Level = Literal["slope", "plane", "quadratic"]


def zero_region(zero: Zero | Mask, shape: tuple[int, int]) -> Mask:
    """The pixels (H, W) bool that define where depth is 0.

    ValueError, TypeError: an unknown word, or a map that is not boolean of that shape.
    """
    if isinstance(zero, str):
        if zero not in ("mean", "border"):
            raise ValueError(f"Expected zero as 'mean', 'border' or a boolean (H, W), got {zero!r}.")
        region = np.ones(shape, dtype=bool)
        if zero == "border":
            region[1:-1, 1:-1] = False
        return region
    return check_mask(zero, shape=shape, name="zero")


def zero_depth(depth: Map, zero: str | Mask, region: Mask, inside: Mask | None = None) -> np.float32:
    """The depth that becomes 0 on one island: the median of its zero pixels, or its mean.

    It is the mean if `zero` is "mean" or the island has no zero pixel. `inside` is the island; None means the whole frame.
    """
    within = region if inside is None else region & inside
    if (isinstance(zero, str) and zero == "mean") or not within.any():
        return np.float32((depth if inside is None else depth[inside]).mean(dtype=np.float64))
    return np.float32(median_over(depth, within))


def median_over(maps: Map, region: Mask) -> Map:
    """Median (...) of maps (..., H, W) over a region; a large region is sampled on a lattice, which is exact enough."""
    if maps.ndim > 2:
        return np.stack([median_over(one, region) for one in maps])
    step = lattice_step(region.size)
    values = np.ascontiguousarray(maps, dtype=np.float32)[..., None]
    median, count = medians_where(values, region, step)
    if count < MEDIAN_SAMPLES / 20 and step > 1:
        median, _ = medians_where(values, region)
    return median.reshape(())


def fitted_surface(depth: Array, region: Mask, degree: int) -> Map:
    """Least-squares polynomial surface of the depth in the region, evaluated over the frame.

    ValueError: the region has fewer pixels than the surface has terms.
    """
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


def check_weights(weights: Any, shape: tuple[int, ...]) -> Weights:
    """Weights in the form that solvers take, for slopes of shape (H, W), or (..., H, W) for a stack.

    ValueError, TypeError: another shape, or a value that is negative or not finite.
    """
    height, width = shape[-2:]
    pair = [as_array(w, "weights") for w in weights] if isinstance(weights, (tuple, list)) else []
    if len(pair) == 2 and pair[0].ndim == pair[1].ndim == 2:
        wx, wy = pair
        if wx.shape != (height, width - 1) or wy.shape != (height - 1, width):
            raise ValueError(
                f"Expected weights per edge of shapes ({height}, {width - 1}) and ({height - 1}, {width}), "
                f"got {wx.shape} and {wy.shape}. For weights per pixel give one map ({height}, {width})."
            )
        return tuple(  # type: ignore[return-value]
            check_map(w, "weights", nonnegative=True) if w.size else w.astype(np.float32) for w in (wx, wy)
        )
    array = check_map(weights, "weights", shape=(height, width), nonnegative=True)
    if array.ndim > 2 and array.shape != shape:
        raise ValueError(f"Expected weights of shape {shape[-2:]} or {shape}, got {array.shape}.")
    return array


def check_anchor(anchor: ArrayLike, shape: tuple[int, int]) -> Map | None:
    """An anchor map (H, W) from a map or a number; None if it is 0 everywhere."""
    array = as_array(anchor, "anchor")
    array = check_map(
        np.full(shape, array) if array.ndim == 0 else array, "anchor", shape=shape, nonnegative=True
    )
    if array.ndim != 2:
        raise ValueError(f"Expected anchor as a number or of shape {shape}, got {array.shape}.")
    return array if array.any() else None


class FrameDepth:
    """Depth for frames (H, W) of one calibration, with a pitch in mm per pixel. It is immutable; threads can share it.

    Slopes of confidence 1 have the deviation `full_confidence_sigma`, mm/mm.
    """

    def __init__(self, shape: tuple[int, int], pitch: float, full_confidence_sigma: float) -> None:
        self._pitch, self._full = pitch, full_confidence_sigma
        self._anchor = RestAnchor(shape, pitch, full_confidence_sigma)

    def __call__(self, slopes: ReadSlopes) -> Integration:
        """The depth of a frame's slopes; it is 0 at rest."""
        anchor = self._anchor(slopes.gradients, slopes.at_rest, slopes.coarse_px)
        weights = slopes.weights(self._full)
        return IntegrationProblem(
            slopes.gradients, (self._pitch, self._pitch), weights, anchor=anchor
        ).solved()
