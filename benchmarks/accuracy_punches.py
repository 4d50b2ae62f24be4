"""Parts of accuracy.py: heights of objects, calibrated on balls alone (with depth by lights) and with flat punches.

The four layouts that rules were made on, and sensors that no rule has seen: lamps, gel, coating and camera drawn
at random. `quick` takes one sensor and few objects: whether it runs, not a figure.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

import gelform
from accuracy_objects import OBJECTS, SEED, height_of, presses_of, usual_presses, walls
from gelform.calibration.presses.press_set import FlatPress
from gelform.frames import pixels_digest
from gelform.simulate import LAYOUTS, Posed, Punch, SimulatedSensor, simulate_press
from gelform.simulate.background import exposed
from gelform.simulate.gel.gel import Gel
from gelform.simulate.presets import gelsight_mini
from gelform.simulate.sensor.coating import Coating
from gelform.simulate.sensor.led import led_row
from report import table

DRAWN = range(201, 211)
LIGHTS_DRAWN = range(411, 415)  # the rule of depth by lights was chosen on 401-404
WALLS_DRAWN = (*range(311, 315), *range(421, 425))  # rules of sigma were chosen on 301-308
PUNCH_MM = 4.0
# (x, y) as parts of the image's width and height from its centre, and depth, mm
PUNCHES = (
    (-0.25, -0.23, 0.15),
    (0.25, -0.2, 0.3),
    (0.0, 0.0, 0.2),
    (-0.22, 0.23, 0.3),
    (0.25, 0.23, 0.15),
    (0.02, -0.03, 0.25),
)
TILT_DEG, KNOWN_TO_MM = 0.4, 0.01
FACE_RADIUS_MM = 1.2
GENTLE = 1.0
HELD_OUT = ("normal_free_deg", "normal_inner_deg", "radius_percent", "cap_free_um", "off_contact_um")


def drawn_sensor(seed: int) -> SimulatedSensor:
    """132x176 px; three rows of lamps, a gel that bulges, a coating that scatters, a camera: all drawn at random."""
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


def flat_presses(sensor: SimulatedSensor, seed: int) -> tuple[FlatPress, ...]:
    """Six presses of a flat punch, tilted by up to 0.4 degrees, its middle's depth known to 10 um."""
    rng = np.random.default_rng(seed)
    size_mm = np.array(sensor.shape[::-1]) * sensor.mm_per_px
    rows, columns = np.mgrid[: sensor.shape[0], : sensor.shape[1]]
    flats = []
    for k, (x, y, depth_mm) in enumerate(PUNCHES):
        center = size_mm * (x, y) + rng.uniform(-0.3, 0.3, 2)
        punch = Posed(Punch(PUNCH_MM), tilt_deg=tuple(rng.uniform(-TILT_DEG, TILT_DEG, 2)))
        press = simulate_press(sensor, punch, depth_mm=depth_mm, center_mm=tuple(center), rng=rng)
        distance = np.hypot(columns - press.center_px[0], rows - press.center_px[1]) * sensor.mm_per_px
        known = press.depth_mm[distance < FACE_RADIUS_MM].mean() + rng.normal(0, KNOWN_TO_MM)
        flats.append(FlatPress(f"flat {k}", press.image, float(known), pixels_digest(press.image)))
    return tuple(flats)


def punches(quick: bool) -> dict[str, Any]:
    """Heights of the eight objects with and without punches of known height: the four layouts that rules were made on."""
    return _table(quick, {**LAYOUTS, "gelsight-mini": gelsight_mini()}, _without_and_with_punches)


def punches_drawn(quick: bool) -> dict[str, Any]:
    """The same on ten sensors that no rule has seen."""
    return _table(quick, {f"drawn {seed}": drawn_sensor(seed) for seed in DRAWN}, _without_and_with_punches)


def lights(quick: bool) -> dict[str, Any]:
    """Heights of the eight objects with `hierarchical` and with `auto`, balls alone: the four layouts."""
    return _table(quick, {**LAYOUTS, "gelsight-mini": gelsight_mini()}, _plain_and_auto)


def lights_drawn(quick: bool) -> dict[str, Any]:
    """The same on four sensors that no rule has seen."""
    return _table(quick, {f"drawn {seed}": drawn_sensor(seed) for seed in LIGHTS_DRAWN}, _plain_and_auto)


def walls_drawn(quick: bool) -> dict[str, Any]:
    """Shares of slopes within one sigma on eight sensors that no rule of sigma has seen."""
    return walls(quick, {f"drawn {seed}": drawn_sensor(seed) for seed in WALLS_DRAWN})


Ways = Callable[..., dict[str, Any]]  # by name: the presses, and the color model to calibrate with


def _without_and_with_punches(
    name: str, sensor: SimulatedSensor, presses: gelform.Presses
) -> dict[str, tuple[gelform.Presses, str]]:
    seed = SEED + (int(name.split()[1]) if name.startswith("drawn") else 0)
    known = replace(presses, flats=flat_presses(sensor, seed))
    return {"balls": (presses, "auto"), "balls and punches": (known, "auto")}


def _plain_and_auto(
    name: str, sensor: SimulatedSensor, presses: gelform.Presses
) -> dict[str, tuple[gelform.Presses, str]]:
    return {"hierarchical": (presses, "hierarchical"), "auto": (presses, "auto")}


def _table(quick: bool, sensors: dict[str, SimulatedSensor], ways: Ways) -> dict[str, Any]:
    chosen = list(sensors.items())[: 1 if quick else None]
    with ProcessPoolExecutor(2) as pool:
        compared = pool.map(partial(_compared, quick, ways), *zip(*chosen))
        figures = dict(zip((name for name, _ in chosen), compared))
    keys = ("mean %", "rms off 100", "gentle mean %", "gentle range %", "within 2 sigma")
    rows = []
    for name, one in figures.items():
        before, after = one.values()
        rows.append([name, after["model"], *(f"{_said(before[k])} -> {_said(after[k])}" for k in keys)])
    print("\n" + table([f"heights, {' -> '.join(one)}", "model", *keys], rows))
    return figures


def _said(value: Any) -> str:
    return "-".join(f"{v:.0f}" for v in value) if isinstance(value, list) else f"{value:.3g}"


def _compared(quick: bool, ways: Ways, name: str, sensor: SimulatedSensor) -> dict[str, Any]:
    made = presses_of(usual_presses(sensor, 12 if quick else 30))
    found = {}
    for what, (presses, color_model) in ways(name, sensor, made).items():
        calibration = gelform.calibrate(presses, color_model=color_model)
        reconstruct = gelform.Reconstructor(calibration)
        objects = {
            f"{kind}, {depth_mm} mm": height_of(sensor, reconstruct, indenter, depth_mm)
            for kind, (indenter, depths) in list(OBJECTS.items())[: 2 if quick else None]
            for depth_mm in depths
        }
        percent = np.array([one["height_percent"] for one in objects.values()])
        gentle = percent[[one["steepest_slope"] < GENTLE for one in objects.values()]]
        found[what] = {
            "model": f"{calibration.color_model.name} {calibration.settings.get('share', '')}".strip(),
            "mean %": float(percent.mean()),
            "rms off 100": float(np.sqrt(np.mean((percent - 100) ** 2))),
            "gentle mean %": float(gentle.mean()),
            "gentle range %": [float(gentle.min()), float(gentle.max())],
            "within 2 sigma": float(np.mean([one["within_2_sigma"] for one in objects.values()])),
            "held out": {key: calibration.held_out[key] for key in HELD_OUT},
            "said": [
                note for note in calibration.report.notes if "known height" in note or "Near lights" in note
            ],
            "objects": {kind: one["height_percent"] for kind, one in objects.items()},
        }
        print(name, what, {key: value for key, value in found[what].items() if key != "objects"}, flush=True)
    return found
