"""Random presses on a simulated layout: balls, and objects that touch at least 40 pixels."""

from __future__ import annotations

from typing import Any

import numpy as np

from gelform.simulate import (
    LAYOUTS,
    Ball,
    BoxEdge,
    Cylinder,
    HeightMap,
    Pyramid,
    SimulatedPress,
    Torus,
    simulate_press,
    text_relief,
)


def press(name: str, rng: np.random.Generator, depths_mm: tuple[float, float] = (0.2, 0.8)) -> SimulatedPress:
    """A ball of 3 to 8 mm at a random place; it touches at least one pixel's center."""
    while True:
        radius = rng.uniform(1.5, 4)
        depth = min(float(np.exp(rng.uniform(*np.log(depths_mm)))), 0.45 * radius)
        place = _place(name, rng)
        try:
            return simulate_press(
                LAYOUTS[name], Ball(radius), depth_mm=depth, center_mm=place, rng=rng, oversample=1
            )
        except ValueError:  # it touches between the pixels' centers
            continue


def _place(name: str, rng: np.random.Generator) -> tuple[float, float]:
    sensor = LAYOUTS[name]
    x, y = rng.uniform(-0.3, 0.3, 2) * sensor.shape[::-1] * sensor.mm_per_px
    return float(x), float(y)


def object_press(name: str, rng: np.random.Generator) -> tuple[str, SimulatedPress]:
    """A ball, an edge or a texture of random size and rotation, 0.05 to 1.5 mm deep; it touches at least 40 pixels."""
    while True:
        kind = str(rng.choice(["ball", "edge", "texture"]))
        depth = float(np.exp(rng.uniform(np.log(0.05), np.log(1.5))))
        spin = float(rng.uniform(0, 180))
        try:
            made = simulate_press(
                LAYOUTS[name], _object(kind, depth, rng), depth_mm=depth, center_mm=_place(name, rng), rng=rng,
                spin_deg=spin, oversample=1,
            )  # fmt: skip
        except ValueError:  # outside the image
            continue
        if made.contact.sum() >= 40:
            return kind, made


def _object(kind: str, depth: float, rng: np.random.Generator) -> Any:
    if kind == "ball":
        return Ball(rng.uniform(max(1.5, 1.2 * depth), 5))
    if kind == "edge":
        edges = (
            BoxEdge(rng.uniform(4, 12), rng.uniform(90, 150)),
            Cylinder(rng.uniform(max(0.8, 1.2 * depth), 3), rng.uniform(4, 12)),
            Torus(rng.uniform(2, 4), rng.uniform(max(0.5, depth), 1.5)),
            Pyramid(rng.uniform(3, 7), rng.uniform(110, 150)),
        )
        return edges[rng.integers(len(edges))]
    if rng.random() < 0.3:
        return text_relief("AB", height_mm=rng.uniform(3, 6))
    y, x = np.mgrid[:160, :160] * 0.05
    wave, amplitude = 2 * np.pi / rng.uniform(0.6, 1.5), rng.uniform(0.03, 0.12)
    relief = amplitude * np.sin(wave * x) * (np.sin(wave * y) if rng.random() < 0.5 else 1)
    dome = ((x - 4) ** 2 + (y - 4) ** 2) / (2 * rng.uniform(6, 15))
    return HeightMap(relief - dome - (relief - dome).max(), 0.05)
