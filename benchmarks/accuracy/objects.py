"""Parts of accuracy.py on simulated objects and presses with exact truth: heights, the anchor, deep presses.

`quick` takes one sensor and few objects: it checks that the parts run, and gives no figure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

import gelform
from accuracy.real import MIN_PIXELS, SLOPES, fractions_within
from gelform.calibration.coverage import COARSE, tile_of
from gelform.depth.coarse import RestAnchor
from gelform.depth.integrate import integrate
from gelform.result.metrics import angle_deg
from gelform.simulate import (
    LAYOUTS,
    Ball,
    Coin,
    Cone,
    Cylinder,
    Punch,
    Screw,
    SimulatedPresses,
    SimulatedSensor,
    Torus,
    simulate_background,
    simulate_ball_presses,
    simulate_press,
)
from gelform.simulate.presets import gelsight_mini
from presses import presses_of
from report import table

OBJECTS: dict[str, tuple[Any, tuple[float, float, float]]] = {
    "ball": (Ball(3.0), (0.2, 0.4, 0.7)),
    "coin": (Coin(), (0.15, 0.25, 0.35)),
    "screw": (Screw(), (0.2, 0.4, 0.6)),
    "punch 6 mm": (Punch(6.0), (0.1, 0.3, 0.6)),
    "punch 2 mm": (Punch(2.0), (0.1, 0.2, 0.3)),
    "cylinder": (Cylinder(3.0, 20.0), (0.2, 0.4, 0.6)),
    "cone": (Cone(6.0, 150.0), (0.2, 0.4, 0.6)),
    "ring": (Torus(2.5, 0.8), (0.1, 0.2, 0.4)),
}
LEAST_SLOPE = 0.05  # smallest recovered slope of pixels in the statistics by slope
STEEP = ((0.6, 0.8), (0.8, 1.0), (1.0, 1.4), (1.4, 3.0))  # true slopes
FACE = 0.97  # fraction of the largest depth: a flat face, or the peak
DEEP_BALL_MM, DEEP, DRAWN_MM = 4.0, (0.8, 1.3), 1.2
SEED = 111  # rules were chosen on sets of seed 11


def objects(quick: bool) -> dict[str, Any]:
    """Recovered over true height of eight objects at three depths, and whether the stated sigma covers the error."""
    sensors = {**LAYOUTS, "gelsight-mini": gelsight_mini()}
    figures: dict[str, Any] = {}
    for name, sensor in list(sensors.items())[: 1 if quick else None]:
        reconstruct = gelform.Reconstructor(
            gelform.calibrate(presses_of(usual_presses(sensor, 12 if quick else 30)))
        )
        figures[name] = {
            f"{what}, {depth_mm} mm": height_of(sensor, reconstruct, indenter, depth_mm)
            for what, (indenter, depths) in list(OBJECTS.items())[: 2 if quick else None]
            for depth_mm in depths
        }
        rows = [[what, *one.values()] for what, one in figures[name].items()]
        covered = float(np.mean([one["within_2_sigma"] for one in figures[name].values()]))
        print(
            "\n" + table([name, "height %", "steepest slope", "normals", "smoothed", "within 2 sigma"], rows)
        )
        print(f"{name}: {100 * covered:.0f} % of the objects within 2 sigma")
        figures[name]["within 2 sigma"] = covered
    return figures


def height_of(sensor: SimulatedSensor, reconstruct: Any, indenter: Any, depth_mm: float) -> dict[str, Any]:
    """Recovered over true height of a pressed object, percent, and whether 2 sigma cover the error."""
    press = simulate_press(sensor, indenter, depth_mm=depth_mm, rng=np.random.default_rng(SEED))
    result = reconstruct.from_image(press.image)
    face = press.depth_mm > FACE * press.depth_mm.max()
    error = float((result.depth_mm - press.depth_mm)[face].mean())
    smoothed = gelform.smoothed_gradients(result.gradients)
    normals = [
        angle_deg(g[press.contact], press.gradients[press.contact]).mean()
        for g in (result.gradients, smoothed)
    ]
    return {
        "height_percent": float(100 * result.depth_mm[face].mean() / press.depth_mm[face].mean()),
        "steepest_slope": float(np.quantile(np.linalg.norm(press.gradients, axis=-1), 0.999)),
        "normal_deg": float(normals[0]),
        "normal_deg_smoothed": float(normals[1]),
        "within_2_sigma": bool(abs(error) < 2 * result.depth_sigma_mm[face].mean()),
    }


def walls(quick: bool, sensors: dict[str, SimulatedSensor] | None = None) -> dict[str, Any]:
    """Share of the slopes of the eight objects within one sigma: by slope, by slope and place, and at steep true slopes."""
    sensors = sensors or {**LAYOUTS, "gelsight-mini": gelsight_mini()}
    figures: dict[str, Any] = {}
    for name, sensor in list(sensors.items())[: 1 if quick else None]:
        presses = presses_of(usual_presses(sensor, 12 if quick else 30))
        reconstruct = gelform.Reconstructor(gelform.calibrate(presses, color_model="hierarchical"))
        rows = np.concatenate(
            [
                _slopes_of(sensor, reconstruct, indenter, depth_mm)
                for indenter, depths in list(OBJECTS.values())[: 2 if quick else None]
                for depth_mm in depths
            ]
        )
        read = rows[rows[:, 3] > LEAST_SLOPE]
        within, bins = read[:, 2], np.digitize(read[:, 3], SLOPES)
        tile = tile_of(read[:, 0], read[:, 1], sensor.shape, COARSE)
        fractions = fractions_within(within, bins * 100 + tile)
        figures[name] = {
            "all": float(100 * within.mean()),
            "by slope": [min(fractions_within(within, bins)), max(fractions_within(within, bins))],
            "by slope and place": [min(fractions), max(fractions)],
            "bins outside 45-90": f"{sum(not 45 <= one <= 90 for one in fractions)} of {len(fractions)}",
            **{
                f"true slope {low:g}-{high:g}": float(100 * rows[at, 2].mean())
                for low, high in STEEP
                if np.count_nonzero(at := (rows[:, 4] >= low) & (rows[:, 4] < high)) >= MIN_PIXELS
            },
        }
    keys = list(dict.fromkeys(key for one in figures.values() for key in one))
    table_rows = [[name, *(str(one.get(key, "")) for key in keys)] for name, one in figures.items()]
    print("\n" + table(["within 1 sigma, %", *keys], table_rows))
    return figures


def _slopes_of(sensor: SimulatedSensor, reconstruct: Any, indenter: Any, depth_mm: float) -> np.ndarray:
    """x, y, share of the components within sigma, recovered slope, true slope of all pixels of an object's image."""
    press = simulate_press(sensor, indenter, depth_mm=depth_mm, rng=np.random.default_rng(SEED))
    result = reconstruct.from_image(press.image)
    y, x = np.mgrid[: result.shape[0], : result.shape[1]]
    within = (np.abs(result.gradients - press.gradients) < result.gradients_sigma).mean(axis=-1)
    slopes = [np.linalg.norm(one, axis=-1) for one in (result.gradients, press.gradients)]
    return np.stack([x, y, within, *slopes], axis=-1).reshape(-1, 5)


def anchor(quick: bool) -> dict[str, Any]:
    """The anchor's effect on flat punches: depth of the face, percent, from true slopes and from recovered ones."""
    figures: dict[str, Any] = {}
    for name, sensor in list(LAYOUTS.items())[: 1 if quick else None]:
        calibration = gelform.calibrate(presses_of(usual_presses(sensor, 12 if quick else 30)))
        reconstruct = gelform.Reconstructor(calibration)
        for width_mm, depth_mm in ((2.0, 0.05), (2.0, 0.1), (2.0, 0.3), (6.0, 0.1), (6.0, 0.3)):
            rng = np.random.default_rng(SEED)
            press = simulate_press(sensor, Punch(width_mm), depth_mm=depth_mm, rng=rng)
            figures[f"{name}, {width_mm:g} mm wide, {depth_mm:g} mm deep"] = _anchored(reconstruct, press)
    keys = list(next(iter(figures.values())))
    print(
        "\n" + table(["face over true, %", *keys], [[name, *one.values()] for name, one in figures.items()])
    )
    return figures


def _anchored(reconstruct: gelform.Reconstructor, press: Any) -> dict[str, float]:
    """The face's depth over the true one, from true slopes and recovered ones, without and with the anchor."""
    read, calibration = reconstruct.record(press.image).slopes, reconstruct.calibration
    at_rest, full = read.at_rest, calibration.slope_sigma.full_confidence_sigma
    pitch = calibration.known_mm_per_px
    anchor = RestAnchor(calibration.image_shape, pitch, full)
    true = gelform.gradients_from_depth(press.depth_mm, mm_per_px=pitch).astype(np.float32)
    face = press.depth_mm > FACE * press.depth_mm.max()
    found = {}
    for what, slopes, weights in (
        ("true slopes", true, None),
        ("read slopes", read.gradients, read.weights(full)),
    ):
        hold = anchor(slopes, at_rest)
        free = integrate(slopes, mm_per_px=pitch, weights=weights, zero=at_rest, solver="multigrid")
        held = integrate(slopes, mm_per_px=pitch, weights=weights, anchor=hold, solver="multigrid")
        for how, solution in (("no anchor", free), ("anchor", held)):
            percent = 100 * solution.depth_mm[face].mean() / press.depth_mm[face].mean()
            found[f"{what}, {how}"] = float(percent)
    return found


def deep(quick: bool) -> dict[str, Any]:
    """Balls pressed 0.8-1.3 of their radius into a gel that sinks far around them, compared with usual presses."""
    figures, rows = {}, []
    for name in list(LAYOUTS)[: 1 if quick else None]:
        layout = replace(LAYOUTS[name], relaxation_mm=DRAWN_MM)
        dotted = replace(layout.coating, marker_pitch_mm=1.4, marker_radius_mm=0.2)
        sensors = {name: layout, f"{name}, dots": replace(layout, coating=dotted)}
        for what, sensor in list(sensors.items())[: 1 if quick else None]:
            count = 12 if quick else 24
            sets = {"deep": _deep(sensor, count), "usual": usual_presses(sensor, count, (DEEP_BALL_MM,))}
            for depth, made in sets.items():
                figures[f"{what}, {depth}"] = one = _held_out(made)
                rows.append([f"{what}, {depth}", *one.values()])
    print("\n" + table(["presses", *next(iter(figures.values()))], rows))
    return figures


def _held_out(made: SimulatedPresses) -> dict[str, Any]:
    """Number of used presses, distance of their centers from the truth, and held-out errors; or the refusal."""
    try:
        report = gelform.calibrate(presses_of(made)).report
    except gelform.CalibrationError as problem:
        return {"refused": str(problem)}
    off = [
        np.hypot(row.center_x_px - press.center_px[0], row.center_y_px - press.center_px[1])
        for row, press in zip(report.presses, made.presses)
        if row.accepted
    ]
    keys = ("normal_free_deg", "radius_percent", "cap_free_um", "off_contact_um")
    return {
        "used": f"{len(off)} of {len(made.presses)}",
        "center, px": float(np.median(off)),
        **{key: report.held_out.get(key, float("nan")) for key in keys},
    }


def usual_presses(
    sensor: SimulatedSensor, count: int, balls_mm: Sequence[float] = (5.0, 8.0)
) -> SimulatedPresses:
    """Presses of balls by hand, all over the gel."""
    return simulate_ball_presses(
        sensor, ball_diameters_mm=balls_mm, count=count, rng=np.random.default_rng(SEED)
    )


def _deep(sensor: SimulatedSensor, count: int) -> SimulatedPresses:
    """Presses on a lattice over the image, shifted by up to 0.5 mm, each with a random depth."""
    rng = np.random.default_rng(SEED)
    height, width = (n * sensor.mm_per_px for n in sensor.shape)
    columns = round((count * width / height) ** 0.5)
    presses = []
    for k in range(count):
        row, column = divmod(k, columns)
        x = (0.1 + 0.8 * column / (columns - 1) - 0.5) * width + rng.uniform(-0.5, 0.5)
        y = (0.1 + 0.8 * row / (-(-count // columns) - 1) - 0.5) * height + rng.uniform(-0.5, 0.5)
        ball, deep_mm = Ball(DEEP_BALL_MM / 2), DEEP_BALL_MM / 2 * rng.uniform(*DEEP)
        presses.append(simulate_press(sensor, ball, depth_mm=deep_mm, center_mm=(x, y), rng=rng))
    return SimulatedPresses(sensor, simulate_background(sensor, rng), tuple(presses))
