"""Parts of accuracy.py on real presses: errors on every set, coverage of the stated sigma, few presses.

Each press is judged by a calibration without it. `quick` takes fewer presses.

Normals have a free center. Circles are the reference's (mini-ball), labels by people (gelsight-ball-deep), or those of a
calibration on all presses, which serves no other purpose. "edge" is inside the contact; its radius relative to the visible
circle is the same for every compared package (EDGES). "rim" is up to 3 px inside the visible rim; "inner" is within
0.8 of its radius.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from typing import Any

import numpy as np

import gelform
from gelform.calibration.coverage import COARSE, tile_of
from gelform.calibration.presses.press_set import Presses
from gelform.result.metrics import ball_center, press_errors, score_slopes
from presses import DATA, labeled, mini_ball, unlabeled
from report import table

FOLDS = 3
EDGES = {
    "mini-ball": 0.85,
    "mini-d": 0.75,
    "gelslim": 0.65,
    "gelslim-dots": 0.65,
    "digit-ball": 0.6,
    "gelsight-ball-deep": 0.75,
}
STEEPEST = 0.95  # fraction of the ball's radius beyond which no pixel counts
INNER = 0.8
SLOPES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6)
SCORED_ZONE = 0.8  # fraction of the contact radius, for slopes: beyond it the gel leaves the ball
MIN_PIXELS = 500  # least pixels of a bin
DRAWS = 10
Split = tuple[str, Any, Any]  # name, presses for calibration, presses for the test
Score = Callable[[tuple[Any, Any], Any, float, float], dict[str, float]]  # as `scored`
KEYS = ("read_edge_deg", "edge_deg", "inner_deg", "rim_deg", "radius_percent", "cap_um", "off_contact_um")


def real(quick: bool) -> dict[str, Any]:
    """Every set: mini-ball one half by the other and one ball size by the other, the others in three folds."""
    return held_out(chain(of_mini_ball(), *map(of_folds, list(EDGES)[1:])), quick)


def held_out(splits: Iterable[Split], quick: bool, score: Score | None = None) -> dict[str, Any]:
    """Errors of the presses that each calibration has not seen, by the names of the splits; by `scored`, or by `score`."""
    parts: dict[str, list[Any]] = {}
    for name, training, test in splits:
        if quick:
            training, test = (one.subset(range(0, len(one.presses), 3)) for one in (training, test))
        calibration, seconds = calibrated(training)
        edge, pitch = EDGES[name.split(",")[0]], calibration.known_mm_per_px
        rows = [(score or scored)(one, one[0].label, pitch, edge) for one in with_results(calibration, test)]
        parts.setdefault(name, []).append((rows, seconds, dict(calibration.settings)))
    figures = {}
    for name, folds in parts.items():
        figures[name] = {
            **summary([row for rows, *_ in folds for row in rows]),
            "cpu_s": float(np.mean([seconds for _, seconds, _ in folds])),
            "settings": [settings for *_, settings in folds],
        }
    rows = [[name, *(one[key] for key in KEYS), one["cpu_s"]] for name, one in figures.items()]
    print("\n" + table(["real presses, not seen", *KEYS, "CPU s"], rows), flush=True)
    return figures


def calibrated(presses: Presses) -> tuple[gelform.Calibration, float]:
    """A calibration without labeled circles, and its CPU seconds."""
    began = time.process_time()
    return gelform.calibrate(unlabeled(presses)), time.process_time() - began


def with_results(calibration: gelform.Calibration, presses: Presses) -> Iterator[Any]:
    """Each press and its result."""
    reconstruct = gelform.Reconstructor(calibration)
    for press in presses.presses:
        yield press, reconstruct.from_image(press.image)


def scored(press_and_result: tuple[Any, Any], circle: Any, mm_per_px: float, edge: float) -> dict[str, float]:
    """Errors of one press."""
    press, result = press_and_result
    ball_mm = press.ball_diameter_mm / 2
    arguments: dict[str, Any] = {"circle_px": circle, "ball_radius_mm": ball_mm, "mm_per_px": mm_per_px}
    errors = press_errors(result.depth_mm, result.gradients, **arguments)
    y, x = np.mgrid[: result.shape[0], : result.shape[1]]
    away, ball_px = np.hypot(x - circle[0], y - circle[1]), ball_mm / mm_per_px

    def normal_deg(slopes: np.ndarray, ratio: float) -> float:
        inside = away < min(ratio * circle[2], STEEPEST * ball_px)
        return float(score_slopes(slopes[inside], x[inside], y[inside], circle[:2], ball_px).normal_deg)

    return {
        "read_edge_deg": normal_deg(result.observed_gradients, edge),
        "edge_deg": normal_deg(result.gradients, edge),
        "inner_deg": normal_deg(result.gradients, INNER),
        "rim_deg": errors.normal_free_deg,
        "radius_percent": abs(errors.radius_percent),
        "cap_um": errors.cap_free_um,
        "off_contact_um": errors.off_contact_um,
    }


def summary(rows: list[dict[str, float]]) -> dict[str, float]:
    """Means over presses; the median of radii, whose errors have a long tail."""
    found = {key: float(np.nanmean([row[key] for row in rows])) for key in rows[0]}
    median = float(np.median([row["radius_percent"] for row in rows]))
    return {"presses": float(len(rows)), **found, "radius_percent": median}


def of_mini_ball() -> Iterator[Split]:
    """mini-ball: both halves, which have presses of both balls, then one ball by the other, and few presses."""
    ball, order = mini_ball()
    sizes = [[i for i in order if ball.presses[i].ball_diameter_mm == d] for d in (6.31, 9.5)]
    even, odd = ([i for one in sizes for i in one[k::2]] for k in (0, 1))
    splits = {
        "every second press calibrates": (even, odd),
        "the others calibrate": (odd, even),
        "6.31 mm calibrates": (sizes[0], sizes[1]),
        "9.50 mm calibrates": (sizes[1], sizes[0]),
        "every sixth press calibrates (12)": (order[0::6], [i for i in order if i not in order[0::6]]),
        "every third press calibrates (23)": (order[0::3], [i for i in order if i not in order[0::3]]),
    }
    for name, (training, test) in splits.items():
        yield f"mini-ball, {name}", ball.subset(training), ball.subset(test)


def of_folds(name: str) -> Iterator[Split]:
    """A set in three folds; each is judged by a calibration on the others."""
    presses = labeled(gelform.read_presses(DATA / name))
    for fold in range(FOLDS):
        of_fold = [i % FOLDS == fold for i in range(len(presses.presses))]
        others, own = ([i for i, member in enumerate(of_fold) if member == held] for held in (False, True))
        yield name, presses.subset(others), presses.subset(own)


def sigma(quick: bool) -> dict[str, Any]:
    """Share of slopes, and of depth minus its mean over the contact, within the stated sigma; each half judges the other."""
    presses, order = mini_ball()
    even, odd = order[0 : None if not quick else 24 : 2], order[1::2]
    figures = _within(presses, even, odd[:: 5 if quick else 1])
    if not quick:
        figures["odd presses calibrate, even ones judge"] = _within(presses, odd, order[0::2])
    for name, value in figures.items():
        print(f"{name}: {value}")
    return figures


def _within(presses: Presses, training: list[int], test: list[int]) -> dict[str, Any]:
    calibration = gelform.calibrate(unlabeled(presses, training))
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
    fractions = fractions_within(within, bins * 100 + tile)
    return {
        "slopes within 1 sigma, %": float(100 * within.mean()),
        "by slope, least and most, %": _range(within, bins),
        "by place, least and most, %": _range(within, tile),
        "by slope and place, least and most, %": [min(fractions), max(fractions)],
        "bins of slope and place outside 45-90": f"{sum(not 45 <= one <= 90 for one in fractions)} of {len(fractions)}",
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
    """Share within 1 and 2 sigma of depth minus its mean, over the contact less 3 px: by its own sigma, by depth's sigma."""
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
    """Normal errors of a result's slopes and of smoothed ones: in the contact less 3 px, then in its inner part."""
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


def fractions_within(within: np.ndarray, bins: np.ndarray) -> list[float]:
    """Share within sigma, percent, of each bin with enough pixels."""
    counted = [bins == b for b in np.unique(bins)]
    return [float(100 * within[one].mean()) for one in counted if np.count_nonzero(one) >= MIN_PIXELS]


def _range(within: np.ndarray, bins: np.ndarray) -> list[float]:
    fractions = fractions_within(within, bins)
    return [min(fractions), max(fractions)]


def _mean(rows: list[list[float]], start: int, stop: int) -> list[float]:
    return [float(100 * value) for value in np.mean(rows, axis=0)[start:stop]]


def few(quick: bool) -> dict[str, Any]:
    """Errors of the other presses after calibration on 10 and on 20 presses: mean of ten random draws."""
    presses, order = mini_ball()
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
