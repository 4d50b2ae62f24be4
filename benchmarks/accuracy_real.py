"""Errors on every real set of presses, each press judged by a calibration that has not seen it: one table.

Normals have a free centre. Circles are the reference's (mini-ball), people's (gelsight-ball-deep), or of a calibration of
all the presses, which scores nothing else. "edge" is inside the contact, whose radius over that of the visible circle is the
same for every code that is compared (EDGES); "rim" is up to 3 px inside the visible rim; "inner" within 0.8 of its radius.
"""

from __future__ import annotations

import csv
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import gelform
from gelform.metrics import press_errors, score_slopes
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
STEEPEST = 0.95  # of the ball's radius, beyond which no pixel counts
INNER = 0.8
KEYS = ("read_edge_deg", "edge_deg", "inner_deg", "rim_deg", "radius_percent", "cap_um", "off_contact_um")


def real(data: Path, quick: bool) -> dict[str, Any]:
    """Every set: mini-ball half by half and one size by the other, the others in three folds."""
    parts: dict[str, list[Any]] = {}
    for name, training, test in _splits(data):
        if quick:
            training, test = (one.subset(range(0, len(one.presses), 3)) for one in (training, test))
        calibration, seconds = calibrated(training)
        edge, pitch = EDGES[name.split(",")[0]], calibration.known_mm_per_px
        rows = [scored(one, one[0].label, pitch, edge) for one in with_results(calibration, test)]
        parts.setdefault(name, []).append((rows, seconds, calibration.settings))
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


def calibrated(presses: gelform.Presses) -> tuple[gelform.Calibration, float]:
    """A calibration that was told no circle, and its CPU seconds."""
    began = time.process_time()
    unlabelled = replace(presses, presses=tuple(replace(p, label=None) for p in presses.presses))
    return gelform.calibrate(unlabelled), time.process_time() - began


def with_results(calibration: gelform.Calibration, presses: gelform.Presses) -> Iterator[Any]:
    """Each press and what is read of it."""
    reconstruct = gelform.Reconstructor(calibration, depth_sigma=False)
    for press in presses.presses:
        yield press, reconstruct.from_image(press.image)


def scored(press_and_result: tuple[Any, Any], circle: Any, mm_per_px: float, edge: float) -> dict[str, float]:
    """Errors of one press."""
    press, result = press_and_result
    ball_mm = press.ball_diameter_mm / 2
    how: dict[str, Any] = {"circle_px": circle, "ball_radius_mm": ball_mm, "mm_per_px": mm_per_px}
    errors = press_errors(result.depth_mm, result.gradients, **how)
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
    found = {key: float(np.nanmean([row[key] for row in rows])) for key in KEYS}
    median = float(np.median([row["radius_percent"] for row in rows]))
    return {"presses": float(len(rows)), **found, "radius_percent": median}


def mini_ball(data: Path) -> tuple[gelform.Presses, list[int]]:
    """The presses with the circles that score them, and their order by name."""
    presses = gelform.read_presses(data / "mini-ball")
    with (data / "mini-ball" / "reference_circles.csv").open() as file:
        names = ("center_x_px", "center_y_px", "contact_radius_px")
        circles = {row["image"]: tuple(float(row[k]) for k in names) for row in csv.DictReader(file)}
    labelled = tuple(replace(p, label=circles[p.name]) for p in presses.presses)
    return replace(presses, presses=labelled), sorted(range(len(labelled)), key=lambda i: labelled[i].name)


def _splits(data: Path) -> Iterator[tuple[str, gelform.Presses, gelform.Presses]]:
    """Name, presses that calibrate, presses that test."""
    ball, order = mini_ball(data)
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
    for name in list(EDGES)[1:]:
        presses = _with_circles(gelform.read_presses(data / name))
        for fold in range(FOLDS):
            of_fold = [i % FOLDS == fold for i in range(len(presses.presses))]
            others, own = (
                [i for i, member in enumerate(of_fold) if member == held] for held in (False, True)
            )
            yield name, presses.subset(others), presses.subset(own)


def _with_circles(presses: gelform.Presses) -> gelform.Presses:
    """The presses that a calibration of all accepts, with its circles; people's circles stay."""
    if presses.presses[0].label is not None:
        return presses
    rows = gelform.calibrate(presses).report.presses
    labelled = (
        replace(press, label=(row.center_x_px, row.center_y_px, row.contact_radius_px))
        for press, row in zip(presses.presses, rows)
        if row.accepted
    )
    return replace(presses, presses=tuple(labelled))
