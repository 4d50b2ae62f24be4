"""Errors on every real set of presses, each press judged by a calibration that has not seen it: one table.

Presses are scored as `gelform.metrics` has it, with a free centre. Circles are the reference's (mini-ball), people's
(gelsight-ball-deep), or of a calibration of all the presses, which scores nothing else. "edge" is within the measured edge of
the contact: the ratio to the visible circle at which the gel leaves the ball, the same for every code compared (EDGES).
"""

from __future__ import annotations

import csv
import sys
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
# Of the visible radius: where what a model of the inner half reads falls below 0.8 of the ball's slope, median of the folds.
EDGES = {"mini-ball": 0.90, "digit-ball": 0.60, "gelsight-ball-deep": 1.0, "gelslim": 0.65, "gelslim-dots": 0.70, "mini-d": 0.85}
RATIOS = (0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85, 0.9, 0.95, 1.0)
KEYS = ("edge_deg", "normal_free_deg", "normal_inner_deg", "radius_percent", "cap_free_um", "off_contact_um")


def all_sets(data: Path, names: list[str] | None = None, step: int = 1) -> dict[str, Any]:
    """Every set's splits: means over the presses, of radius the median of its size."""
    figures: dict[str, Any] = {}
    for name, training, test in _splits(data):
        if names and not any(name.startswith(one) for one in names):
            continue
        figures.setdefault(name, []).append(_judged(name, training, test.subset(range(0, len(test.presses), step))))
    found = {name: summary([row for rows in parts for row in rows[0]], [rows[1] for rows in parts]) for name, parts in figures.items()}
    rows = [[name, *(one[k] for k in KEYS), one["seconds"]] for name, one in found.items()]
    print("\n" + table(["set", *KEYS, "s"], rows), flush=True)
    return found


def summary(rows: list[dict[str, Any]], seconds: list[float]) -> dict[str, Any]:
    """Of presses: means, the median for radii and off contact."""
    found: dict[str, Any] = {"presses": len(rows), "seconds": float(np.mean(seconds))}
    for key in rows[0]:
        values = np.array([row[key] for row in rows])
        median = key == "radius_percent"
        found[key] = float(np.nanmedian(np.abs(values)) if median else np.nanmean(values))
        if key in ("edge_deg", "off_contact_um", "cap_free_um"):
            found[f"median_{key}"] = float(np.nanmedian(values))
    return found


def _splits(data: Path) -> Iterator[tuple[str, gelform.Presses, gelform.Presses]]:
    ball = _mini_ball(data)
    order = sorted(range(len(ball.presses)), key=lambda i: ball.presses[i].name)
    sizes = [[i for i in order if ball.presses[i].ball_diameter_mm == d] for d in (6.31, 9.5)]
    even, odd = ([i for one in sizes for i in one[k::2]] for k in (0, 1))
    for name, (training, test) in {
        "mini-ball even": (even, odd),
        "mini-ball odd": (odd, even),
        "mini-ball 6.31 mm": (sizes[0], sizes[1]),
        "mini-ball 9.50 mm": (sizes[1], sizes[0]),
    }.items():
        yield name, ball.subset(training), ball.subset(test)
    for name in ("mini-d", "gelslim", "gelslim-dots", "digit-ball", "gelsight-ball-deep"):
        presses = _with_circles(gelform.read_presses(data / name))
        for fold in range(FOLDS):
            members = range(len(presses.presses))
            yield (
                name,
                presses.subset([i for i in members if i % FOLDS != fold]),
                presses.subset([i for i in members if i % FOLDS == fold]),
            )


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


def _mini_ball(data: Path) -> gelform.Presses:
    presses = gelform.read_presses(data / "mini-ball")
    with (data / "mini-ball" / "reference_circles.csv").open() as file:
        names = ("center_x_px", "center_y_px", "contact_radius_px")
        circles = {row["image"]: tuple(float(row[k]) for k in names) for row in csv.DictReader(file)}
    return replace(presses, presses=tuple(replace(p, label=circles[p.name]) for p in presses.presses))


def _judged(name: str, training: gelform.Presses, test: gelform.Presses) -> tuple[list[dict[str, Any]], float]:
    began = time.process_time()
    unlabelled = replace(training, presses=tuple(replace(p, label=None) for p in training.presses))
    calibration = gelform.calibrate(unlabelled)
    seconds = time.process_time() - began
    reconstruct = gelform.Reconstructor(calibration, depth_sigma=False)
    rows = [_scored(name, press, press.label, reconstruct.from_image(press.image), calibration.known_mm_per_px) for press in test.presses]
    return rows, seconds


def _scored(name: str, press: Any, circle: Any, result: Any, mm_per_px: float) -> dict[str, Any]:
    errors = press_errors(
        result.depth_mm, result.gradients, circle_px=circle, ball_radius_mm=press.ball_diameter_mm / 2, mm_per_px=mm_per_px
    )
    row = {key: getattr(errors, key) for key in KEYS[1:]}
    ball_px = press.ball_diameter_mm / 2 / mm_per_px
    y, x = np.mgrid[: result.shape[0], : result.shape[1]]
    away = np.hypot(x - circle[0], y - circle[1])
    for ratio in sorted({*RATIOS, EDGES[name.split()[0]]}):
        inside = away < min(ratio * circle[2], 0.95 * ball_px)
        score = score_slopes(result.gradients[inside], x[inside], y[inside], circle[:2], ball_px)
        row[f"deg_{ratio:g}"] = score.normal_deg
    row["edge_deg"] = row[f"deg_{EDGES[name.split()[0]]:g}"]
    return {"edge_deg": row["edge_deg"], **row}


if __name__ == "__main__":
    import json

    data = Path(sys.argv[1])
    out = all_sets(data, sys.argv[3:] or None)
    Path(sys.argv[2]).write_text(json.dumps(out, indent=1))
