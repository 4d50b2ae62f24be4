"""Parts of accuracy.py on real presses: where the stated deviations hold, few presses, deep ones.

Every press that is judged was not there when the calibration was made. `quick` takes every fifth press.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import gelform
from accuracy_real import EDGES, calibrated, mini_ball, scored, summary, with_results
from gelform.ball import ball_center
from gelform.calibration.coverage import COARSE, tile_of
from gelform.metrics import score_slopes

SLOPES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
SCORED_ZONE = 0.8  # of the contact radius, for slopes: beyond it the gel leaves the ball
MIN_PIXELS = 500  # of a bin
DRAWS = 10


def sigma(data: Path, quick: bool) -> dict[str, Any]:
    """Share of slopes, and of depth minus its mean over the contact, within the stated deviations: either half judges."""
    presses, order = mini_ball(data)
    even, odd = order[0 : None if not quick else 24 : 2], order[1::2]
    figures = _within(presses, even, odd[:: 5 if quick else 1])
    if not quick:
        figures["odd presses calibrate, even ones judge"] = _within(presses, odd, order[0::2])
    for name, value in figures.items():
        print(f"{name}: {value}")
    return figures


def _within(presses: gelform.Presses, training: list[int], test: list[int]) -> dict[str, Any]:
    calibration = gelform.calibrate(_unlabelled(presses, training))
    reconstruct = gelform.Reconstructor(calibration)
    slopes, shapes, normals = [], [], []
    for i in test:
        press = presses.presses[i]
        result = reconstruct.from_image(press.image)
        radius_px = press.ball_diameter_mm / 2 / calibration.known_mm_per_px
        slopes.append(_slopes(result, press.label, radius_px))
        shapes.append(_shape(result, press.label, radius_px))
        normals.append(_plain_and_smoothed(result, press.label, radius_px))
    rows = np.concatenate(slopes)
    within, bins = rows[:, 2:4].mean(axis=1), np.digitize(rows[:, 4], SLOPES)
    tile = tile_of(rows[:, 0], rows[:, 1], calibration.image_shape, COARSE)
    shares = shares_within(within, bins * 100 + tile)
    return {
        "slopes within 1 sigma, %": float(100 * within.mean()),
        "by slope, least and most, %": _range(within, bins),
        "by place, least and most, %": _range(within, tile),
        "by slope and place, least and most, %": [min(shares), max(shares)],
        "bins of slope and place outside 45-90": f"{sum(not 45 <= one <= 90 for one in shares)} of {len(shares)}",
        "depth against its mean, within 1 and 2 of the difference's sigma, %": _mean(shapes, 0, 2),
        "the same against depth_sigma_mm, %": _mean(shapes, 2, 4),
        "normals, deg, plain and smoothed, of the contact, then within 0.8": np.mean(
            normals, axis=0
        ).tolist(),
    }


def _slopes(result: Any, label: Any, radius_px: float) -> np.ndarray:
    """x, y, within sigma (dx, dy), slope of the pixels in the scored zone."""
    y, x, rho = _from_center(result, label)
    zone = rho < SCORED_ZONE * label[2]
    score = score_slopes(result.gradients[zone], x[zone], y[zone], label[:2], radius_px)
    within = np.abs(score.errors) < result.gradients_sigma[zone]
    slope = np.linalg.norm(result.gradients[zone], axis=-1)
    return np.column_stack([x[zone], y[zone], within, slope])


def _shape(result: Any, label: Any, radius_px: float) -> list[float]:
    """Share within 1 and 2 of depth minus its mean over the contact less 3 px: of its own sigma, of depth's."""
    y, x, rho = _from_center(result, label)
    near = rho < label[2] - 3
    center = ball_center(result.gradients[near], x[near], y[near], label[:2], radius_px)
    square = (x - center[0]) ** 2 + (y - center[1]) ** 2
    region = square < (label[2] - 3) ** 2
    cap = result.mm_per_px * np.sqrt(np.maximum(radius_px**2 - square, 0))
    error = np.abs(result.depth_mm - cap - (result.depth_mm - cap)[region].mean())[region]
    stated = result.depth_difference_sigma(region)[region], result.depth_sigma_mm[region]
    return [float(np.mean(error < n * one)) for one in stated for n in (1, 2)]


def _plain_and_smoothed(result: Any, label: Any, radius_px: float) -> list[float]:
    """Normal errors of a result's slopes and of those smoothed: in the contact less 3 px, then in its inner part."""
    y, x, rho = _from_center(result, label)
    maps = result.gradients, gelform.smoothed_gradients(result.gradients)
    regions = rho < label[2] - 3, rho < SCORED_ZONE * label[2]
    return [
        score_slopes(one[region], x[region], y[region], label[:2], radius_px).normal_deg
        for region in regions
        for one in maps
    ]


def _from_center(result: Any, label: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    y, x = np.mgrid[: result.shape[0], : result.shape[1]]
    return y, x, np.hypot(x - label[0], y - label[1])


def shares_within(within: np.ndarray, bins: np.ndarray) -> list[float]:
    """Share within sigma, per cent, of each bin that has pixels enough."""
    counted = [bins == b for b in np.unique(bins)]
    return [float(100 * within[one].mean()) for one in counted if np.count_nonzero(one) >= MIN_PIXELS]


def _range(within: np.ndarray, bins: np.ndarray) -> list[float]:
    shares = shares_within(within, bins)
    return [min(shares), max(shares)]


def _mean(rows: list[list[float]], start: int, stop: int) -> list[float]:
    return [float(100 * value) for value in np.mean(rows, axis=0)[start:stop]]


def few(data: Path, quick: bool) -> dict[str, Any]:
    """Errors of the other presses, calibrated on 10 and on 20: the mean of ten random draws."""
    presses, order = mini_ball(data)
    figures = {}
    for count in (10, 20):
        rows = []
        for seed in range(1 if quick else DRAWS):
            drawn = sorted(np.random.default_rng(seed).permutation(len(order))[:count])
            calibration, _ = calibrated(presses.subset([order[k] for k in drawn]))
            test = presses.subset(
                [i for k, i in enumerate(order) if k not in set(drawn)][:: 5 if quick else 1]
            )
            pitch, edge = calibration.known_mm_per_px, EDGES["mini-ball"]
            rows.append(
                summary([scored(one, one[0].label, pitch, edge) for one in with_results(calibration, test)])
            )
        figures[str(count)] = {key: float(np.mean([row[key] for row in rows])) for key in rows[0]}
        print(f"\n{count} presses, mean of {len(rows)} draws: {figures[str(count)]}")
    return figures


def _unlabelled(presses: gelform.Presses, indices: list[int]) -> gelform.Presses:
    return replace(presses, presses=tuple(replace(presses.presses[i], label=None) for i in indices))
