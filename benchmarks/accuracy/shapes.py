"""Part of accuracy.py: what `gelform.measure` says of shapes of known size, and how often its sigma covers the error.

Steps, radii and angles are judged by the object's own size. A groove or ridge is judged by the gel's true surface, because
the gel does not follow an edge to its foot.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from typing import Any

import cv2
import numpy as np

import gelform
from accuracy.objects import SEED, usual_presses
from edges_of_cube import FROM_EDGE_PX, frames
from faces_of_cube import ENDS, sharpest, touched_faces
from gelform.simulate import LAYOUTS, Ball, Cylinder, SimulatedSensor, simulate_press
from gelform.simulate.indenters import BoxEdge, HeightMap
from gelform.simulate.presets import gelsight_mini
from presses import presses_of
from report import table

PLATE_MM, PLATE_SAMPLES = 8.0, 401
KINDS = ("step", "groove", "ridge", "waves", "cylinder", "ball", "prism")


def shapes(quick: bool) -> dict[str, Any]:
    """Error, sigma and coverage of every figure of `measure` on simulated shapes."""
    sensors = {**LAYOUTS, "gelsight-mini": gelsight_mini()}
    rows: dict[tuple[str, str], list[tuple[float, float, float]]] = defaultdict(list)
    for name, sensor in list(sensors.items())[: 1 if quick else None]:
        reconstruct = gelform.Reconstructor(
            gelform.calibrate(presses_of(usual_presses(sensor, 12 if quick else 24)))
        )
        for draw in range(2 if quick else 24):
            for number, kind in enumerate(KINDS):
                drawn = measured(sensor, reconstruct, kind, np.random.default_rng([SEED, draw, number]))
                for what, one in drawn.items():
                    rows[name, what].append(one)
    figures: dict[str, Any] = {}
    for what in dict.fromkeys(what for _, what in rows):
        figures[what] = {
            "all": figures_of([one for (_, of), all in rows.items() if of == what for one in all])
        }
        figures[what] |= {name: figures_of(all) for (name, of), all in rows.items() if of == what}
    figures["all"] = figures_of([one for all in rows.values() for one in all])
    listed = [
        [f"{what}, {name}", *one.values()]
        for what, by_name in figures.items()
        for name, one in (by_name.items() if what != "all" else [("all", by_name)])
    ]
    print("\n" + table(["figure", *figures["all"]], listed))
    return figures


def figures_of(rows: list[tuple[float, float, float]]) -> dict[str, float]:
    """Of (truth, value, sigma): median relative error and sigma, percent, and the share within one and two sigma."""
    truth, value, sigma = np.array(rows).T
    off = np.abs(value - truth)
    return {
        "n": len(rows),
        "truth": round(float(np.mean(truth)), 3),
        "bias %": round(float(100 * np.median((value - truth) / truth)), 1),
        "error %": round(float(100 * np.median(off / truth)), 1),
        "sigma %": round(float(100 * np.median(sigma / truth)), 1),
        "within 1 sigma %": round(100 * float(np.mean(off <= sigma))),
        "within 2 sigma %": round(100 * float(np.mean(off <= 2 * sigma))),
    }


def plate(kind: str, rng: np.random.Generator) -> tuple[HeightMap, float, float]:
    """A plate with a step, groove or ridge along y in its middle; its height and half its width, mm."""
    x = np.linspace(-PLATE_MM / 2, PLATE_MM / 2, PLATE_SAMPLES)
    height, half, flank = rng.uniform(0.08, 0.25), rng.uniform(0.4, 0.8), rng.uniform(0.3, 0.7)
    if kind == "waves":
        height = 10 ** rng.uniform(-2.7, -1.3)
        across = height / 2 * np.cos(2 * np.pi * x / (2 * half))
    else:
        inside = x / (2 * flank) if kind == "step" else (half - np.abs(x)) / flank
        t = np.clip(inside + 0.5, 0, 1)
        across = (-1 if kind == "groove" else 1) * height * t * t * (3 - 2 * t)
    return (
        HeightMap(np.tile(across, (PLATE_SAMPLES, 1)), PLATE_MM / (PLATE_SAMPLES - 1)),
        height,
        half + flank / 2,
    )


def measured(
    sensor: SimulatedSensor, reconstruct: gelform.Reconstructor, kind: str, rng: np.random.Generator
) -> dict[str, tuple[float, float, float]]:
    """Truth, value and sigma of each figure of one drawn shape; none where the gel does not follow it."""
    height = half = size = 0.0
    if kind == "ball":
        size = rng.uniform(1.5, 5)
        indenter: Any = Ball(size)
    elif kind == "cylinder":
        size = rng.uniform(1.5, 4)
        indenter = Cylinder(size, rng.uniform(5, 12))
    elif kind == "prism":
        size = rng.uniform(100, 150)
        indenter = BoxEdge(rng.uniform(5, 9), size)
    else:
        indenter, height, half = plate(kind, rng)
    deep = {
        "step": height + rng.uniform(0.08, 0.15), "ridge": height + rng.uniform(0.05, 0.15),
        "groove": rng.uniform(0.2, 0.35), "prism": rng.uniform(0.4, 0.8),
    }.get(kind, rng.uniform(0.25, 0.6))  # fmt: skip
    spin = rng.uniform(-90, 90)
    center_mm = tuple(rng.uniform(-1.5, 1.5, 2))
    press = simulate_press(
        sensor, indenter, depth_mm=deep, center_mm=center_mm, spin_deg=spin, rng=rng, oversample=1
    )
    result = reconstruct.from_image(press.image)
    y, x = np.mgrid[: result.shape[0], : result.shape[1]]
    x, y = (one - at for one, at in zip((x, y), press.center_px))
    pitch, turn = sensor.mm_per_px, np.deg2rad(spin)
    u, v = (pitch * (np.cos(turn) * a + np.sin(turn) * b) for a, b in ((x, y), (y, -x)))
    truth = replace(result, depth=press.depth_mm.astype(np.float32))
    if kind == "waves":
        region = (np.abs(u) < 2.5) & (np.abs(v) < 2.5) & press.contact
        found, true = (gelform.measure(one, regions=[region]).quantities for one in (result, truth))
        names = ("flatness", "Sa", "Sq", "Sz")
        return {
            f"waves {one.name}": (by.value, one.value, one.sigma)
            for one, by in zip(found, true)
            if one.name in names
        }
    if kind in ("groove", "ridge"):
        along = 2.5 * half / pitch * np.array([np.cos(turn), np.sin(turn)])
        line = (*(press.center_px - along), *(press.center_px + along))
        found, true = (gelform.measure(one, lines=[line]).quantities for one in (result, truth))
        return {
            f"{kind} {'flank' if 'flank' in one.name else one.name}": (by.value, one.value, one.sigma)
            for one, by in zip(found, true)
            if one.name in ("depth", "height", "width", "left flank") and one.value and by.value
        }
    if kind in ("ball", "cylinder"):
        reach = 0.7 * np.sqrt(size**2 - (size - 0.5 * deep) ** 2)
        region = np.hypot(u, v) < reach if kind == "ball" else (np.abs(v) < reach) & (np.abs(u) < 1.5)
        if np.count_nonzero(region & press.contact) < 100:
            return {}
        name = f"{kind} radius"
        found = gelform.measure(result, regions=[region & press.contact], radius=kind).quantities
        return {one.name: (size, one.value, one.sigma) for one in found if one.name == name}
    away, across, inner, outer = (u, v, 0.3, 1.2) if kind == "step" else (v, u, 0.15, 0.9)
    shift = half if kind != "step" else 0.7
    near = press.contact & (np.abs(across) < 0.8 * (1 if kind == "step" else 2))
    pair = [near & (side * away > shift + inner) & (side * away < shift + outer) for side in (-1, 1)]
    if min(np.count_nonzero(one) for one in pair) < 100:
        return {}
    found = gelform.measure(result, regions=pair).quantities
    name, size = ("step", height) if kind == "step" else ("angle", size)
    return {one.name: (size, one.value, one.sigma) for one in found if one.name == name}


def cube(quick: bool) -> dict[str, Any]:
    """The angle between a cube's faces, 90 degrees, on a real Mini without presses of its own, by the make's starter.

    The faces are found in color alone (`faces_of_cube`); the regions end 4 px off the edge and 2 px off the faces' border.
    """
    background, images = frames()
    reconstruct = gelform.Reconstructor(gelform.calibration_from_background(background, "gelsight-mini"))
    figures = {}
    for name in [one for one in ENDS if one in images][: 2 if quick else None]:
        touched = touched_faces(images[name], background, np.array(ENDS[name])).astype(np.uint8)
        change = cv2.GaussianBlur(images[name].astype(np.float32) - background, (0, 0), 1.0)
        ends = sharpest(change, np.array(ENDS[name], np.float64))
        inner = cv2.erode(touched, np.ones((5, 5), np.uint8)) > 0
        y, x = np.mgrid[: inner.shape[0], : inner.shape[1]]
        along = (ends[1] - ends[0]) / np.hypot(*(ends[1] - ends[0]))
        off = (y - ends[0, 1]) * along[0] - (x - ends[0, 0]) * along[1]
        faces = [inner & (side * off > FROM_EDGE_PX) for side in (-1, 1)]
        found = gelform.measure(reconstruct.from_image(images[name]), regions=faces).quantities
        angle = next(one for one in found if one.name == "angle")
        figures[name] = {
            "angle_deg": angle.value, "sigma_deg": angle.sigma, "pixels": int(min(face.sum() for face in faces)),
            "doubts": list(angle.doubts),
        }  # fmt: skip
    print(
        "\n"
        + table(
            ["frame", "angle_deg", "sigma_deg", "pixels", "doubts"],
            [[k, *v.values()] for k, v in figures.items()],
        )
    )
    return figures
