"""Where held-out normals are off: by the ball's slope and by place, with the contact's rim and without it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.coverage import COARSE, tile_of
from gelform.calibration.report.held_out import HeldOutSample
from gelform.calibration.report.residuals import MIN_PIXELS, SLOPE_EDGES
from gelform.metrics import angle_deg


def errors_where(
    samples: Sequence[HeldOutSample],
    shape: tuple[int, int],
    contact_radius_ratio: float,
    grid: tuple[int, int] = COARSE,
) -> dict[str, Any]:
    """Normal errors of reconstructed presses by slope and by place.

    Over pixels, so a large contact counts for more than a small one; the figures of whole presses are means over
    presses.

    Parameters
    ----------
    samples : of presses that the model has not seen
    shape : (H, W) of the images
    contact_radius_ratio : radius of the contact's edge over that of the visible circle
    grid : rows and columns of cells over the image

    Returns
    -------
    where : dict
        `contact_radius_ratio`; then `contact`, inside the contact's edge, and `rim`, up to 3 px (at 240 rows) inside the
        visible rim, each with `normal_deg`, the mean angle to the ball's normals;
        `by_slope`, bins of the ball's slope with `slope_from`, `slope_to`, `normal_deg`, `gain` (sum of recovered .
        true over sum of true . true) and `pixels`; and `by_place`, with `rows`, `columns` and, cell by cell,
        `normal_deg` and `pixels`. Bins of under 60 pixels are left out, such cells None.
    """
    regions = {"contact": [one.within(contact_radius_ratio) for one in samples], "rim": samples}
    parts = {name: _part(region, shape, grid) for name, region in regions.items()}
    return {"contact_radius_ratio": contact_radius_ratio, **parts}


def _part(samples: Sequence[HeldOutSample], shape: tuple[int, int], grid: tuple[int, int]) -> dict[str, Any]:
    true, seen = (
        np.concatenate([getattr(one, name) for one in samples]) for name in ("true_gradients", "gradients")
    )
    x, y = (np.concatenate([getattr(one, name) for one in samples]) for name in ("x_px", "y_px"))
    angles = angle_deg(seen, true)
    return {
        "normal_deg": float(angles.mean()) if angles.size else None,
        "by_slope": _by_slope(true.astype(np.float64), seen, angles),
        "by_place": _by_place(tile_of(x, y, shape, grid), angles, grid),
    }


def _by_slope(
    true: NDArray[np.float64], seen: NDArray[Any], angles: NDArray[np.float64]
) -> list[dict[str, Any]]:
    slope = np.linalg.norm(true, axis=1)
    bins = []
    for low, high in pairwise(SLOPE_EDGES):
        member = (slope >= low) & (slope < high)
        if np.count_nonzero(member) >= MIN_PIXELS:
            gain = np.sum(seen[member] * true[member]) / np.sum(true[member] ** 2)
            bins.append(
                {
                    "slope_from": low,
                    "slope_to": high,
                    "normal_deg": float(angles[member].mean()),
                    "gain": float(gain),
                    "pixels": int(np.count_nonzero(member)),
                }
            )
    return bins


def _by_place(tile: NDArray[np.intp], angles: NDArray[np.float64], grid: tuple[int, int]) -> dict[str, Any]:
    pixels = np.bincount(tile, minlength=grid[0] * grid[1])
    sums = np.bincount(tile, angles, pixels.size)
    normal_deg = [float(s / n) if n >= MIN_PIXELS else None for s, n in zip(sums, pixels)]
    return {"rows": grid[0], "columns": grid[1], "normal_deg": normal_deg, "pixels": pixels.tolist()}
