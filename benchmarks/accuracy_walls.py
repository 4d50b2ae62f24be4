"""Part of accuracy.py: heights of objects and errors on balls where walls may be steeper than they are read, not flatter."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import gelform
from accuracy_heights import WALLS_DRAWN, drawn_sensor
from accuracy_objects import FACE, OBJECTS, SEED, presses_of, usual_presses
from accuracy_presses import _unlabelled
from accuracy_real import mini_ball
from gelform.metrics import press_errors
from gelform.simulate import SimulatedSensor, simulate_press
from report import table

ERRORS = ("normal_free_deg", "normal_inner_deg", "radius_percent", "cap_free_um", "off_contact_um")


def at_least(data: Path, quick: bool) -> dict[str, Any]:
    """`at_least` beside `multigrid`: mini-ball, half of which calibrates, and objects on four sensors drawn at random."""
    figures = {"mini-ball, mean of presses": _balls(data, quick)}
    for seed in list(WALLS_DRAWN)[: 1 if quick else None]:
        sensor = drawn_sensor(seed)
        calibration = gelform.calibrate(presses_of(usual_presses(sensor, 12 if quick else 30)))
        figures[sensor.name] = {
            solver: _heights(
                sensor, gelform.Reconstructor(calibration, solver=solver, depth_sigma=False), quick
            )
            for solver in ("multigrid", "at_least")
        }
    for name, one in figures.items():
        print(
            "\n" + table([name, *one["multigrid"]], [[solver, *row.values()] for solver, row in one.items()])
        )
    return figures


def _balls(data: Path, quick: bool) -> dict[str, dict[str, float]]:
    presses, order = mini_ball(data)
    calibration = gelform.calibrate(_unlabelled(presses, order[0 : 24 if quick else None : 2]))
    figures = {}
    for solver in ("multigrid", "at_least"):
        reconstruct, rows = gelform.Reconstructor(calibration, solver=solver, depth_sigma=False), []
        for i in order[1 :: 10 if quick else 2]:
            press = presses.presses[i]
            result = reconstruct.from_image(press.image)
            ball = {"circle_px": press.label, "ball_radius_mm": press.ball_diameter_mm / 2}
            errors = press_errors(
                result.depth_mm, result.gradients, mm_per_px=calibration.known_mm_per_px, **ball
            )
            rows.append([getattr(errors, name) for name in ERRORS])
        figures[solver] = dict(zip(ERRORS, np.nanmean(np.array(rows, dtype=float), axis=0).tolist()))
    return figures


def _heights(sensor: SimulatedSensor, reconstruct: gelform.Reconstructor, quick: bool) -> dict[str, float]:
    """Recovered over true height of eight objects at three depths, per cent."""
    percent = []
    for indenter, depths in list(OBJECTS.values())[: 2 if quick else None]:
        for depth_mm in depths:
            press = simulate_press(sensor, indenter, depth_mm=depth_mm, rng=np.random.default_rng(SEED))
            face = press.depth_mm > FACE * press.depth_mm.max()
            depth = reconstruct.from_image(press.image).depth_mm
            percent.append(100 * depth[face].mean() / press.depth_mm[face].mean())
    off = np.array(percent) - 100
    return {
        "mean %": float(100 + off.mean()),
        "rms off 100": float(np.sqrt(np.mean(off**2))),
        "least %": float(100 + off.min()),
        "most %": float(100 + off.max()),
    }
