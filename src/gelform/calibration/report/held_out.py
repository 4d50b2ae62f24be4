"""What held-out presses say pixel by pixel: the slopes that were read, the ball's own, and depth minus the cap.

A calibration run keeps them in its report; they are not saved. The report is binned from them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.ball import STEEPEST_FRACTION, ball_center, ball_gradients
from gelform.calibration.presses.folder import Press
from gelform.metrics import angle_deg
from gelform.reconstruct import Reconstructor

MAX_PIXELS = 2000
SLOPE_EDGES = tuple(round(0.1 * k, 1) for k in range(13))
MIN_PRESSES, MIN_PIXELS = 3, 60
DRAWS = 1000


@dataclass(frozen=True, eq=False)
class HeldOutSample:
    """Pixels of one press, reconstructed with a model that has not seen it; the ball's centre is free.

    Attributes
    ----------
    index : of the press in its folder
    circle_px : (centre x, centre y, contact radius), px
    x_px, y_px : (N,) float32, inside the contact, 3 px (at 240 rows) inside its rim
    true_gradients, gradients : (N, 2) float32, the ball's slopes there and those that were reconstructed
    cap_error_um : (h, w) float32, depth minus the ball's cap in the contact's box, mean 0, NaN outside it;
        empty where the fitted ball lies outside the frame
    """

    index: int
    circle_px: tuple[float, float, float]
    x_px: NDArray[np.float32]
    y_px: NDArray[np.float32]
    true_gradients: NDArray[np.float32]
    gradients: NDArray[np.float32]
    cap_error_um: NDArray[np.float32]

    @property
    def errors(self) -> NDArray[np.float32]:
        """(N, 2) reconstructed minus true slopes."""
        return self.gradients - self.true_gradients

    @property
    def true_slope(self) -> NDArray[np.float32]:
        """(N,) magnitude of the ball's slope."""
        slope: NDArray[np.float32] = np.linalg.norm(self.true_gradients, axis=1)
        return slope

    @property
    def normal_deg(self) -> float:
        """Mean angle to the ball's normals."""
        return float(angle_deg(self.gradients, self.true_gradients).mean())

    def within(self, zone: float) -> HeldOutSample:
        """The pixels inside a share of the contact radius."""
        x, y, radius = self.circle_px
        keep = np.hypot(self.x_px - x, self.y_px - y) < zone * radius
        return HeldOutSample(
            self.index,
            self.circle_px,
            self.x_px[keep],
            self.y_px[keep],
            self.true_gradients[keep],
            self.gradients[keep],
            self.cap_error_um,
        )


def held_out_sample(
    index: int,
    press: Press,
    circle_px: tuple[float, float, float],
    reconstruct: Reconstructor,
    *,
    max_pixels: int = MAX_PIXELS,
) -> HeldOutSample:
    """Reconstruct a press that the calibration has not seen, and keep what tells how far off it is.

    The region and the free centres are those of `gelform.metrics.press_errors`.
    """
    result = reconstruct.from_image(press.image)
    mm_per_px = reconstruct.calibration.known_mm_per_px
    ball_px = press.ball_diameter_mm / 2 / mm_per_px
    height, width = result.depth_mm.shape
    reach = min(circle_px[2] - 3 * min(height, width) / 240, STEEPEST_FRACTION * ball_px)
    y, x = np.mgrid[:height, :width]
    start = circle_px[:2]
    inside = np.hypot(x - start[0], y - start[1]) < reach
    center = ball_center(result.gradients[inside], x[inside], y[inside], start, ball_px)
    rows, cols = _thinned(np.hypot(x - center[0], y - center[1]) < reach, max_pixels)
    return HeldOutSample(
        index,
        (*center, circle_px[2]),
        cols.astype(np.float32),
        rows.astype(np.float32),
        ball_gradients(cols, rows, center, ball_px).astype(np.float32),
        result.gradients[rows, cols],
        _cap_error_um(result.depth_mm, inside, start, reach, ball_px, mm_per_px),
    )


def _thinned(region: NDArray[np.bool_], count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of at most about `count` pixels of a region, on a regular lattice."""
    rows, cols = np.nonzero(region)
    stride = -(-len(rows) // count)
    keep = (cols + 3 * rows) % max(stride, 1) == 0
    return rows[keep], cols[keep]


def _cap_error_um(
    depth_mm: NDArray[Any],
    inside: NDArray[np.bool_],
    start_px: tuple[float, float],
    reach_px: float,
    ball_px: float,
    mm_per_px: float,
) -> NDArray[np.float32]:
    """Depth minus the cap of a ball whose centre is fitted to the slopes of the depth, in the contact's box."""
    along_y, along_x = np.gradient(depth_mm.astype(np.float64), mm_per_px)
    slopes = np.stack([along_x, along_y], axis=-1)[inside]
    y, x = np.mgrid[: depth_mm.shape[0], : depth_mm.shape[1]]
    center = ball_center(slopes, x[inside], y[inside], start_px, ball_px)
    square = (x - center[0]) ** 2 + (y - center[1]) ** 2
    error = 1e3 * (depth_mm - mm_per_px * np.sqrt(np.maximum(ball_px**2 - square, 0)))
    region = square < reach_px**2
    if not region.any():
        return np.empty((0, 0), dtype=np.float32)
    error = np.where(region, error - error[region].mean(), np.nan).astype(np.float32)
    rows, cols = np.nonzero(region)
    box: NDArray[np.float32] = error[rows.min() : rows.max() + 1, cols.min() : cols.max() + 1]
    return box


def resampled(count: int, rng: np.random.Generator, draws: int = DRAWS) -> NDArray[np.float64]:
    """How often each of `count` presses is drawn in each bootstrap, (draws, count)."""
    return rng.multinomial(count, np.full(count, 1 / count), size=draws).astype(np.float64)


def gain_curve(samples: Sequence[HeldOutSample], rng: np.random.Generator) -> list[dict[str, Any]]:
    """Recovered over true slope, by bins of the true slope, with a 95 % interval over presses.

    The gain of a bin is `sum g . t / sum t . t` over its pixels, g the reconstructed and t the true gradient:
    noise does not raise it, and a regression to the mean at the rim shows as less than 1.
    """
    sums = np.zeros((3, len(samples), len(SLOPE_EDGES) - 1))
    for k, one in enumerate(samples):
        bins, true = one.true_slope, one.true_gradients.astype(np.float64)
        for row, weights in enumerate(((one.gradients * true).sum(1), (true**2).sum(1), np.ones(len(true)))):
            sums[row, k] = np.histogram(bins, SLOPE_EDGES, weights=weights)[0]
    drawn = resampled(len(samples), rng)
    curve = []
    for b, (low, high) in enumerate(pairwise(SLOPE_EDGES)):
        projected, square, pixels = sums[:, :, b]
        if np.count_nonzero(pixels) < MIN_PRESSES or pixels.sum() < MIN_PIXELS:
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


def cells_of(
    x_px: NDArray[Any], y_px: NDArray[Any], shape: tuple[int, int], grid: tuple[int, int]
) -> NDArray[np.intp]:
    """Flat index of the grid cell (rows, columns) that each pixel of an image (H, W) lies in."""
    row = np.clip((np.asarray(y_px) + 0.5) * grid[0] / shape[0], 0, grid[0] - 1).astype(np.intp)
    column = np.clip((np.asarray(x_px) + 0.5) * grid[1] / shape[1], 0, grid[1] - 1).astype(np.intp)
    return row * grid[1] + column


def error_map(
    samples: Sequence[HeldOutSample], shape: tuple[int, int], grid: tuple[int, int]
) -> dict[str, Any]:
    """Held-out slope errors by place: mean (dx, dy), RMS length and number of pixels of each cell, None if empty."""
    cell = np.concatenate([cells_of(one.x_px, one.y_px, shape, grid) for one in samples])
    errors = np.concatenate([one.errors for one in samples]).astype(np.float64)
    count = np.bincount(cell, minlength=grid[0] * grid[1])
    sums = [np.bincount(cell, w, count.size) for w in (errors[:, 0], errors[:, 1], (errors**2).sum(1))]
    full = count >= 10
    mean = [
        [float(sums[0][i] / count[i]), float(sums[1][i] / count[i])] if full[i] else None
        for i in range(count.size)
    ]
    rms = [float(np.sqrt(sums[2][i] / count[i])) if full[i] else None for i in range(count.size)]
    return {"rows": grid[0], "columns": grid[1], "mean": mean, "rms": rms, "pixels": count.tolist()}


def stated_sigma(
    reconstruct: Reconstructor, image: NDArray[Any], sample: HeldOutSample
) -> NDArray[np.float32]:
    """(N, 2) standard deviation that users of the calibration are told for the pixels of a sample."""
    sigma = reconstruct.from_image(image).gradients_sigma
    if sigma is None:
        raise ValueError("Expected a calibration that states a standard deviation of its slopes, got none.")
    rows, cols = sample.y_px.astype(np.intp), sample.x_px.astype(np.intp)
    stated: NDArray[np.float32] = sigma[rows, cols]
    return stated


def share_within_sigma(
    samples: Sequence[HeldOutSample],
    sigmas: Sequence[NDArray[np.float32]],
    shape: tuple[int, int],
    grid: tuple[int, int],
) -> dict[str, Any]:
    """Share of held-out slopes within one stated standard deviation, by bins of slope and of place; 0.68 is right."""
    inside = np.concatenate([np.abs(one.errors) <= sigma for one, sigma in zip(samples, sigmas)]).mean(axis=1)
    slope = np.concatenate([np.linalg.norm(one.gradients, axis=1) for one in samples])
    by_slope = []
    for low, high in pairwise(SLOPE_EDGES):
        member = (slope >= low) & (slope < high)
        if np.count_nonzero(member) >= MIN_PIXELS:
            by_slope.append({"slope_from": low, "slope_to": high, "share": float(inside[member].mean())})
    cell = np.concatenate([cells_of(one.x_px, one.y_px, shape, grid) for one in samples])
    by_place = [
        float(inside[cell == i].mean()) if np.count_nonzero(cell == i) >= MIN_PIXELS else None
        for i in range(grid[0] * grid[1])
    ]
    return {
        "all": float(inside.mean()),
        "by_slope": by_slope,
        "rows": grid[0],
        "columns": grid[1],
        "by_place": by_place,
    }
