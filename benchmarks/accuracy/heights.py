"""Parts of accuracy.py: heights of objects with calibrations from balls only, and steep walls.

They use sensors with random lamps, gel, coating and camera, on which no setting was chosen. `objects` has the layouts.
`quick` takes one sensor and few objects: it checks that the parts run, and gives no figure.
"""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

import gelform
from accuracy.objects import FACE, OBJECTS, SEED, height_of, usual_presses, walls
from gelform.result.metrics import press_errors
from gelform.simulate import LAYOUTS, SimulatedSensor, simulate_press
from gelform.simulate.gel import Gel
from gelform.simulate.light import exposed
from gelform.simulate.sensor import Coating, led_row
from gelform.slopes.gradients import slopes_of_solution
from presses import depth_by, mini_ball, presses_of, unlabeled
from report import table

DRAWN = range(411, 415)
WALLS_DRAWN = (*range(311, 315), *range(421, 425))  # the rules of sigma were chosen on 301-308
GENTLE = 1.0
ERRORS = ("normal_free_deg", "radius_percent", "cap_free_um", "off_contact_um")


def drawn_sensor(seed: int) -> SimulatedSensor:
    """A random sensor of 132x176 px: three rows of lamps, a gel that bulges, a coating that scatters, a camera."""
    rng = np.random.default_rng(seed)
    leds = []
    for k in range(3):
        turn = np.deg2rad(90 + 120 * k + rng.uniform(-25, 25))
        reach, height = rng.uniform(11, 20), rng.uniform(6, 16)
        power = np.full(3, 0.05)
        power[k] = rng.uniform(0.8, 1.2) * reach**2 / 200
        middle = reach * np.array([np.cos(turn), np.sin(turn)])
        along = 4 * np.array([-np.sin(turn), np.cos(turn)])
        ends = ((*(middle + side * along), height) for side in (1, -1))
        leds += led_row(*ends, tuple(power), 3)
    sensor = replace(
        list(LAYOUTS.values())[seed % 3],
        leds=tuple(leds),
        name=f"drawn {seed}",
        shape=(132, 176),
        mm_per_px=0.1153,
        white_balance=(1.0, 1.0, 1.0),
        ambient=(0.0, 0.0, 0.0),
        relaxation_mm=float(rng.uniform(0.3, 0.8)),
        noise_sd=float(rng.uniform(0.7, 1.8)),
        blur_px=float(rng.uniform(0.5, 1.0)),
        gel=Gel(thickness_mm=float(rng.uniform(2.5, 4.5)), bulge=float(rng.uniform(0, 0.4))),
        coating=Coating(scattering=float(rng.uniform(0, 0.25)), seed=seed),
    )
    return exposed(sensor, (90, 95, 90))


def heights_drawn(quick: bool) -> dict[str, Any]:
    """Heights of the eight objects on four random sensors, on which no setting was chosen; calibrated on balls only."""
    return _table(quick, {f"drawn {seed}": drawn_sensor(seed) for seed in DRAWN})


def walls_drawn(quick: bool) -> dict[str, Any]:
    """Shares of slopes within one sigma on eight sensors that had no part in the rules of sigma."""
    return walls(quick, {f"drawn {seed}": drawn_sensor(seed) for seed in WALLS_DRAWN})


def _table(quick: bool, sensors: dict[str, SimulatedSensor]) -> dict[str, Any]:
    chosen = list(sensors.items())[: 1 if quick else None]
    with ProcessPoolExecutor(2) as pool:
        figures = dict(
            zip((name for name, _ in chosen), pool.map(partial(_heights_of, quick), *zip(*chosen)))
        )
    keys = ("mean %", "rms off 100", "gentle mean %", "gentle range %", "within 2 sigma")
    rows = [[name, *(_said(one[key]) for key in keys)] for name, one in figures.items()]
    print("\n" + table(["heights", *keys], rows))
    return figures


def _said(value: Any) -> str:
    return "-".join(f"{v:.0f}" for v in value) if isinstance(value, list) else f"{value:.3g}"


def _heights_of(quick: bool, name: str, sensor: SimulatedSensor) -> dict[str, Any]:
    calibration = gelform.calibrate(presses_of(usual_presses(sensor, 12 if quick else 30)))
    reconstruct = gelform.Reconstructor(calibration)
    objects = {
        f"{kind}, {depth_mm} mm": height_of(sensor, reconstruct, indenter, depth_mm)
        for kind, (indenter, depths) in list(OBJECTS.items())[: 2 if quick else None]
        for depth_mm in depths
    }
    percent = np.array([one["height_percent"] for one in objects.values()])
    gentle = percent[[one["steepest_slope"] < GENTLE for one in objects.values()]]
    found = {
        "mean %": float(percent.mean()),
        "rms off 100": float(np.sqrt(np.mean((percent - 100) ** 2))),
        "gentle mean %": float(gentle.mean()),
        "gentle range %": [float(gentle.min()), float(gentle.max())],
        "within 2 sigma": float(np.mean([one["within_2_sigma"] for one in objects.values()])),
        "held out": calibration.held_out,
        "settings": dict(calibration.settings),
    }
    print(name, found, flush=True)
    return {**found, "objects": {kind: one["height_percent"] for kind, one in objects.items()}}


def at_least(quick: bool) -> dict[str, Any]:
    """`at_least` against `multigrid`: mini-ball, calibrated on half of it, and objects on four random sensors."""
    figures = {"mini-ball, mean of presses": _balls(quick)}
    for seed in list(WALLS_DRAWN)[: 1 if quick else None]:
        sensor = drawn_sensor(seed)
        calibration = gelform.calibrate(presses_of(usual_presses(sensor, 12 if quick else 30)))
        figures[sensor.name] = {
            solver: _heights_at_least(sensor, gelform.Reconstructor(calibration), solver, quick)
            for solver in ("multigrid", "at_least")
        }
    for name, one in figures.items():
        print(
            "\n" + table([name, *one["multigrid"]], [[solver, *row.values()] for solver, row in one.items()])
        )
    return figures


def _balls(quick: bool) -> dict[str, dict[str, float]]:
    presses, order = mini_ball()
    calibration = gelform.calibrate(unlabeled(presses, order[0 : 24 if quick else None : 2]))
    reconstruct, figures = gelform.Reconstructor(calibration), {}
    pitch = calibration.known_mm_per_px
    for solver in ("multigrid", "at_least"):
        rows = []
        for i in order[1 :: 10 if quick else 2]:
            press = presses.presses[i]
            depth = depth_by(solver, reconstruct, press.image)
            ball = {"circle_px": press.label, "ball_radius_mm": press.ball_diameter_mm / 2}
            gradients = slopes_of_solution(depth, (pitch, pitch))
            errors = press_errors(depth, gradients, mm_per_px=pitch, **ball)
            rows.append([getattr(errors, name) for name in ERRORS])
        figures[solver] = dict(zip(ERRORS, np.nanmean(np.array(rows, dtype=float), axis=0).tolist()))
    return figures


def _heights_at_least(
    sensor: SimulatedSensor, reconstruct: gelform.Reconstructor, solver: str, quick: bool
) -> dict[str, float]:
    """Recovered over true height of eight objects at three depths, percent."""
    percent = []
    for indenter, depths in list(OBJECTS.values())[: 2 if quick else None]:
        for depth_mm in depths:
            press = simulate_press(sensor, indenter, depth_mm=depth_mm, rng=np.random.default_rng(SEED))
            face = press.depth_mm > FACE * press.depth_mm.max()
            depth = depth_by(solver, reconstruct, press.image)
            percent.append(100 * depth[face].mean() / press.depth_mm[face].mean())
    off = np.array(percent) - 100
    return {
        "mean %": float(100 + off.mean()),
        "rms off 100": float(np.sqrt(np.mean(off**2))),
        "least %": float(100 + off.min()),
        "most %": float(100 + off.max()),
    }
