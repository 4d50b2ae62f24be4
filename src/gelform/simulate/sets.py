"""Presses of balls spread over the image: what a calibration is made from, with the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gelform.progress import Progress, no_progress
from gelform.simulate.background import simulate_background
from gelform.simulate.gel.ball_press import depth_of_ball
from gelform.simulate.indenters.faces import Ball
from gelform.simulate.press import SimulatedPress, simulate_press
from gelform.simulate.sensor.sensor import SimulatedSensor

RIM_SLOPES = (0.5, 0.95)


@dataclass(frozen=True)
class SimulatedPresses:
    """A background and presses of one simulated sensor: what a press folder holds, and the truth."""

    sensor: SimulatedSensor
    background: NDArray[np.uint8]
    presses: tuple[SimulatedPress, ...]


def simulate_ball_presses(
    sensor: SimulatedSensor,
    *,
    ball_diameters_mm: Sequence[float],
    count: int,
    rng: np.random.Generator,
    oversample: int = 3,
    progress: Progress = no_progress,
) -> SimulatedPresses:
    """A background and `count` presses of balls, spread over the image; some are cut by its border.

    The balls take turns. Centres lie on a low-discrepancy sequence that fills the image evenly; depths give
    slopes of 0.5-0.95 at the contact's rim, as a hand that presses a GelSight does. Each press has its own
    random stream, so it does not depend on the others.
    """
    if count < 1 or len(ball_diameters_mm) == 0:
        raise ValueError(f"Expected count >= 1 and a ball, got {count} and {list(ball_diameters_mm)}.")
    background_rng, place_rng, *press_rngs = rng.spawn(count + 2)
    shift = place_rng.random(2)
    presses = []
    for k, press_rng in enumerate(press_rngs):
        presses.append(_ball_press(sensor, ball_diameters_mm, k, shift, press_rng, oversample))
        progress(k + 1, count, "simulating presses of a ball")
    return SimulatedPresses(sensor, simulate_background(sensor, background_rng), tuple(presses))


def ball_press_of_set(
    sensor: SimulatedSensor, ball_diameters_mm: Sequence[float], k: int, *, seed: int, oversample: int = 3
) -> SimulatedPress:
    """The k-th press of `simulate_ball_presses` with `rng=numpy.random.default_rng(seed)`, alone."""
    place_rng, press_rng = (
        np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(n,))) for n in (1, k + 2)
    )
    return _ball_press(sensor, ball_diameters_mm, k, place_rng.random(2), press_rng, oversample)


def _ball_press(
    sensor: SimulatedSensor,
    ball_diameters_mm: Sequence[float],
    k: int,
    shift: NDArray[np.float64],
    rng: np.random.Generator,
    oversample: int,
) -> SimulatedPress:
    ball = Ball(ball_diameters_mm[k % len(ball_diameters_mm)] / 2)
    depth = _depth_of(sensor, ball, rng.uniform(*RIM_SLOPES))
    return simulate_press(
        sensor, ball, depth_mm=depth, center_mm=_place(sensor, k, shift), rng=rng, oversample=oversample
    )


def _depth_of(sensor: SimulatedSensor, ball: Ball, rim_slope: float) -> float:
    gel = sensor.gel
    return depth_of_ball(
        ball.radius_mm, rim_slope, sensor.relaxation_mm, thickness_mm=gel.thickness_mm, bulge=gel.bulge
    )


def _place(sensor: SimulatedSensor, k: int, shift: NDArray[np.float64]) -> tuple[float, float]:
    """The k-th point of Roberts' R2 sequence (2018), over all but the outermost 2 % of the image."""
    plastic = 1.32471795724474602596
    unit = (shift + (k + 1) / np.array([plastic, plastic**2])) % 1
    height, width = sensor.shape
    x, y = (unit - 0.5) * 0.96 * np.array([width, height]) * sensor.mm_per_px
    return float(x), float(y)
