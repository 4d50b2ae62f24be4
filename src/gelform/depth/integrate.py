"""gradients -> depth in millimetres: the one door to solvers/, the zero reference and levelling."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.checks import check_gradients, check_map, check_mask, check_mm_per_px
from gelform.depth.integration import Integration, Request, integrated, solved
from gelform.solvers.edges import Pair, differences, edges_from_gradients
from gelform.solvers.inputs import check_anchor, check_slopes, check_weights, checked_solver
from gelform.zero import Level, Zero, median_over, zero_region


def depth_from_gradients(
    gradients: ArrayLike,
    *,
    mm_per_px: float | Sequence[float],
    weights: ArrayLike | tuple[ArrayLike, ArrayLike] | None = None,
    mask: ArrayLike | None = None,
    anchor: ArrayLike | None = None,
    zero: Zero | NDArray[np.bool_] = "mean",
    level: Level | None = None,
    solver: str = "auto",
) -> NDArray[np.float32]:
    """Depth from slopes by least squares with a free border; see `integrate` for the arguments."""
    return solved(_checked(gradients, mm_per_px, weights, mask, anchor, zero, level, solver)).depth_mm


def integrate(
    gradients: ArrayLike,
    *,
    mm_per_px: float | Sequence[float],
    weights: ArrayLike | tuple[ArrayLike, ArrayLike] | None = None,
    mask: ArrayLike | None = None,
    anchor: ArrayLike | None = None,
    zero: Zero | NDArray[np.bool_] = "mean",
    level: Level | None = None,
    solver: str = "auto",
) -> Integration:
    """Depth from slopes by least squares with a free border, and how it was found.

    Minimises `sum wx (z_x - p)^2 + wy (z_y - q)^2 + anchor z^2/(hx hy)` over the edges between pixels.

    Parameters
    ----------
    gradients : (H, W, 2) or a stack (N, H, W, 2), mm/mm
    mm_per_px : float or (x, y), mm
    weights : (H, W), a stack of them, or a pair (wx, wy) of shapes (H, W-1) and (H-1, W); >= 0
        Confidence of each pixel's slopes, or of each edge. Slopes of weight under 1e-3 of the largest are
        replaced by a fill from their neighbours: their own values have no influence.
    mask : (H, W) bool
        Pixels that belong to the surface. Each island of them gets its own zero; beyond, depth is filled.
    anchor : float or (H, W), >= 0
        How firmly depth is held at 0, relative to weight 1: (sigma0 mm_per_px / sigma_zero_mm)^2. An island
        that holds an anchor takes its offset from it, and `zero` moves the others only.
    zero : "mean", "border" or a boolean (H, W) of untouched pixels
        Where depth is 0: its mean over the frame, its median over the frame's outermost pixels, or its
        median over the given pixels.
    level : None, "slope", "plane" or "quadratic"
        What is removed beside the offset: the median slope of the zero pixels before integrating, or a
        surface fitted to their depth after it. With an anchor, "slope" is the one to take: bias first, then
        the anchor (2 um left of a bias where the anchor alone leaves 19).
    solver : "auto" or a name in `SOLVERS`
        "auto" takes `dct` where neither weights, mask nor anchor are given, else `multigrid`.

    Raises
    ------
    ValueError, TypeError
        An argument of the wrong shape or range; weights for a solver that takes none.
    ConvergenceError
        The solver did not reach its tolerance.
    """
    return integrated(_checked(gradients, mm_per_px, weights, mask, anchor, zero, level, solver))


def integrate_unchecked(
    gradients: NDArray[np.float32],
    *,
    mm_per_px: float,
    weights: NDArray[np.float32] | None = None,
    anchor: NDArray[np.float32] | None = None,
    zero: Zero | NDArray[np.bool_] = "mean",
    solver: str = "auto",
) -> Integration:
    """`integrate` of one frame that a Reconstructor made: its values were checked where they came in.

    Parameters
    ----------
    gradients : (H, W, 2), C order, that `check_slopes` lets pass
    weights, anchor : (H, W), C order, finite, >= 0
    """
    return integrated(
        Request(
            gradients=gradients,
            pitch=(mm_per_px, mm_per_px),
            weights=weights,
            mask=None,
            anchor=anchor,
            zero=zero,
            region=zero_region(zero, gradients.shape[:2]),
            level=None,
            solver=_chosen(solver, uniform=weights is None and anchor is None),
        )
    )


def edge_residuals(depth_mm: ArrayLike, gradients: ArrayLike, *, mm_per_px: float | Sequence[float]) -> Pair:
    """Recovered minus given slope along each edge, mm/mm: which slopes no surface satisfies.

    Parameters
    ----------
    depth_mm : (..., H, W), mm
    gradients : (..., H, W, 2), mm/mm
    mm_per_px : float or (x, y), mm

    Returns
    -------
    rx : (..., H, W-1) float32
    ry : (..., H-1, W) float32

    Raises
    ------
    ValueError, TypeError
        Depth or slopes of another shape or not finite, or a pitch that is not positive.
    """
    g = check_gradients(gradients)
    depth = check_map(depth_mm, "depth_mm", shape=(g.shape[-3], g.shape[-2]))
    recovered, given = differences(depth, check_mm_per_px(mm_per_px)), edges_from_gradients(g)
    return recovered[0] - given[0], recovered[1] - given[1]


def _checked(
    gradients: ArrayLike,
    mm_per_px: float | Sequence[float],
    weights: ArrayLike | tuple[ArrayLike, ArrayLike] | None,
    mask: ArrayLike | None,
    anchor: ArrayLike | None,
    zero: Zero | NDArray[np.bool_],
    level: Level | None,
    solver: str,
) -> Request:
    pitch = check_mm_per_px(mm_per_px)
    g = check_gradients(gradients)
    check_slopes(g)
    shape = (g.shape[-3], g.shape[-2])
    if level not in (None, "slope", "plane", "quadratic"):
        raise ValueError(f"Expected level as None, 'slope', 'plane' or 'quadratic', got {level!r}.")
    region = zero_region(zero, shape)
    if level == "slope":
        g = g - np.stack([median_over(g[..., c], region) for c in (0, 1)], axis=-1)[..., None, None, :]
    return Request(
        gradients=g,
        pitch=pitch,
        weights=None if weights is None else check_weights(weights, g.shape[:-1]),
        mask=None if mask is None else check_mask(mask, shape=shape),
        anchor=None if anchor is None else check_anchor(anchor, shape),
        zero=zero,
        region=region,
        level=level,
        solver=_chosen(solver, uniform=weights is None and mask is None and anchor is None),
    )


def _chosen(solver: str, *, uniform: bool) -> str:
    if checked_solver(solver) == "auto":
        return "dct" if uniform else "multigrid"
    return solver
