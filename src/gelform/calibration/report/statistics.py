"""Statistics of held-out residuals: gain by slope, errors by place, and whether the stated sigma is right."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.coverage import COARSE, DIRECTIONS, direction_of, tile_of
from gelform.calibration.enough import NEEDED
from gelform.calibration.held_out.measure import HeldOutSample
from gelform.result.metrics import angle_deg
from gelform.slopes.confidence.slope_sigma import MIN_IN_BIN

SLOPE_EDGES = tuple(round(0.1 * k, 1) for k in range(13))
DRAWS = 1000  # bootstrap draws of presses, for intervals
PRIOR_PIXELS = 200  # pixels; the error of a direction in a tile is pulled to the mean of all with this weight


def resampled(count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """How often each of `count` presses is drawn in each bootstrap, (draws, count)."""
    return rng.multinomial(count, np.full(count, 1 / count), size=DRAWS).astype(np.float64)


def _bins_of(slope: NDArray[Any]) -> Iterator[tuple[dict[str, float], NDArray[np.bool_]]]:
    """The limits of each bin of slopes that holds enough pixels, and the pixels in it."""
    for low, high in pairwise(SLOPE_EDGES):
        member = (slope >= low) & (slope < high)
        if np.count_nonzero(member) >= MIN_IN_BIN:
            yield {"slope_from": low, "slope_to": high}, member


def _tiles_of(
    samples: Sequence[HeldOutSample], shape: tuple[int, int], grid: tuple[int, int]
) -> NDArray[np.intp]:
    """The number of the tile that each pixel of all samples lies in."""
    return np.concatenate([tile_of(one.x_px, one.y_px, shape, grid) for one in samples])


def gain_curve(samples: Sequence[HeldOutSample], rng: np.random.Generator) -> list[dict[str, Any]]:
    """Recovered over true slope, by bins of the true slope, with a 95 % interval over presses.

    The gain of a bin is `sum g . t / sum t . t` over its pixels, g the reconstructed and t the true gradient:
    noise does not raise it, and a regression to the mean at the rim shows as less than 1.
    """
    sums = np.zeros((3, len(samples), len(SLOPE_EDGES) - 1))
    for k, one in enumerate(samples):
        bins, true = np.linalg.norm(one.true_gradients, axis=1), one.true_gradients.astype(np.float64)
        for row, weights in enumerate(((one.gradients * true).sum(1), (true**2).sum(1), np.ones(len(true)))):
            sums[row, k] = np.histogram(bins, SLOPE_EDGES, weights=weights)[0]
    drawn = resampled(len(samples), rng)
    curve = []
    for b, (low, high) in enumerate(pairwise(SLOPE_EDGES)):
        projected, square, pixels = sums[:, :, b]
        if not NEEDED.interval.met(int(np.count_nonzero(pixels))) or pixels.sum() < MIN_IN_BIN:
            continue
        among = drawn @ square
        gains = (drawn @ projected)[among > 0] / among[among > 0]
        curve.append(
            {
                "slope_from": low,
                "slope_to": high,
                "gain": float(projected.sum() / square.sum()),
                "interval": [float(v) for v in np.percentile(gains, (2.5, 97.5))],
                "presses": int(np.count_nonzero(pixels)),
                "pixels": int(pixels.sum()),
            }
        )
    return curve


def error_map(
    samples: Sequence[HeldOutSample], shape: tuple[int, int], grid: tuple[int, int]
) -> dict[str, Any]:
    """Held-out slope errors by tile: mean (dx, dy), RMS length and number of pixels, None where there are few."""
    tile = _tiles_of(samples, shape, grid)
    errors = np.concatenate([one.errors for one in samples]).astype(np.float64)
    count = np.bincount(tile, minlength=grid[0] * grid[1])
    sums = [np.bincount(tile, w, count.size) for w in (errors[:, 0], errors[:, 1], (errors**2).sum(1))]
    full = count >= 10
    mean = [
        [float(sums[0][i] / count[i]), float(sums[1][i] / count[i])] if full[i] else None
        for i in range(count.size)
    ]
    rms = [float(np.sqrt(sums[2][i] / count[i])) if full[i] else None for i in range(count.size)]
    return {"rows": grid[0], "columns": grid[1], "mean": mean, "rms": rms, "pixels": count.tolist()}


def square_error_by_direction(
    samples: Sequence[HeldOutSample], shape: tuple[int, int], tiles: tuple[int, int]
) -> NDArray[np.float64]:
    """(rows, columns, 8) mean square slope error, drawn to the overall mean where few pixels tell."""
    size = tiles[0] * tiles[1] * DIRECTIONS
    total, count = np.zeros(size), np.zeros(size)
    for one in samples:
        index = tile_of(one.x_px, one.y_px, shape, tiles) * DIRECTIONS + direction_of(one.true_gradients)
        total += np.bincount(index, (one.errors.astype(np.float64) ** 2).sum(axis=1), size)
        count += np.bincount(index, minlength=size)
    overall = total.sum() / count.sum() if count.any() else 1.0
    mean: NDArray[np.float64] = (total + PRIOR_PIXELS * overall) / (count + PRIOR_PIXELS)
    return mean.reshape(*tiles, DIRECTIONS)


def fraction_within_sigma(
    samples: Sequence[HeldOutSample],
    sigmas: Sequence[NDArray[np.float32]],
    shape: tuple[int, int],
    grid: tuple[int, int],
) -> dict[str, Any]:
    """Fraction of held-out slopes within one stated standard deviation, by bins of slope and of place; 0.68 is right."""
    inside = np.concatenate([np.abs(one.errors) <= sigma for one, sigma in zip(samples, sigmas)]).mean(axis=1)
    slope = np.concatenate([np.linalg.norm(one.gradients, axis=1) for one in samples])
    by_slope = [{**limits, "share": float(inside[member].mean())} for limits, member in _bins_of(slope)]
    tile = _tiles_of(samples, shape, grid)
    by_place = [
        float(inside[tile == i].mean()) if np.count_nonzero(tile == i) >= MIN_IN_BIN else None
        for i in range(grid[0] * grid[1])
    ]
    return {
        "all": float(inside.mean()),
        "by_slope": by_slope,
        "rows": grid[0],
        "columns": grid[1],
        "by_place": by_place,
    }


def errors_where(
    samples: Sequence[HeldOutSample],
    shape: tuple[int, int],
    contact_radius_ratio: float,
    grid: tuple[int, int] = COARSE,
) -> dict[str, Any]:
    """Normal errors of reconstructed presses by slope and by place: `contact` up to its edge, `rim` up to the visible rim.

    Means over pixels, so that a large contact counts for more than a small one; the figures of whole presses are means over
    presses. Bins of the ball's slope of under 50 pixels are left out, and such cells of the grid (rows, columns) are None.
    """
    regions = {"contact": [one.within(contact_radius_ratio) for one in samples], "rim": samples}
    parts = {name: _part(region, shape, grid) for name, region in regions.items()}
    return {"contact_radius_ratio": contact_radius_ratio, **parts}


def _part(samples: Sequence[HeldOutSample], shape: tuple[int, int], grid: tuple[int, int]) -> dict[str, Any]:
    true = np.concatenate([one.true_gradients for one in samples])
    read = np.concatenate([one.gradients for one in samples])
    angles, true = angle_deg(read, true), true.astype(np.float64)
    return {
        "normal_deg": float(angles.mean()) if angles.size else None,
        "by_slope": [
            {
                **limits,
                "normal_deg": float(angles[member].mean()),
                "gain": float(np.sum(read[member] * true[member]) / np.sum(true[member] ** 2)),
                "pixels": int(np.count_nonzero(member)),
            }
            for limits, member in _bins_of(np.linalg.norm(true, axis=1))
        ],
        "by_place": _by_place(_tiles_of(samples, shape, grid), angles, grid),
    }


def _by_place(tile: NDArray[np.intp], angles: NDArray[np.float64], grid: tuple[int, int]) -> dict[str, Any]:
    pixels = np.bincount(tile, minlength=grid[0] * grid[1])
    sums = np.bincount(tile, angles, pixels.size)
    normal_deg = [float(s / n) if n >= MIN_IN_BIN else None for s, n in zip(sums, pixels)]
    return {"rows": grid[0], "columns": grid[1], "normal_deg": normal_deg, "pixels": pixels.tolist()}
