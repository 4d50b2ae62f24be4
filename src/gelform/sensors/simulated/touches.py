"""The source "simulated": a ball touches a simulated gel again and again, at a camera's pace."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.sensors.simulated.paced import PacedSimulation
from gelform.simulate import Ball, Pose, SimulatedSensor, simulate_pose

RATE_HZ = 60.0
BALL = Ball(3.0)
DEPTH_MM, STEPS = 0.6, 12  # of a touch, and how many depths it goes through
REST_S, TOUCH_S = 1.0, 1.0
PLACES = ((-0.2, 0.1), (0.25, -0.15))  # of the touches in turn, parts of the image's width and height


class SimulatedTouches(PacedSimulation):
    """Frames of a simulated sensor that a ball of 6 mm touches at two places in turn, for ever.

    Each touch goes 0.6 mm deep and back within a second; a second of rest parts them. The depth moves in steps of
    0.05 mm: their images without noise are computed once (about a second), and each frame gets noise of its own, so
    that 60 frames a second take a tenth of a core. Frame k has the same pixels in every run.

    Parameters
    ----------
    sensor : SimulatedSensor
    rate_hz : frames a second
    seed : of the noise
    """

    def __init__(self, sensor: SimulatedSensor, *, rate_hz: float = RATE_HZ, seed: int = 0) -> None:
        super().__init__(sensor, rate_hz=rate_hz, seed=seed)
        self._levels = _noise_free_levels(sensor)

    def levels_at(self, index: int) -> NDArray[Any]:
        """Of the place and the depth that the ball has in the frame of that number."""
        return self._levels[self._step_at(index)]

    def pose_at(self, index: int) -> Pose:
        """Where the ball stands in the frame of that number."""
        place, step = self._step_at(index)
        return _pose(self.sensor, place, step)

    def _step_at(self, index: int) -> tuple[int, int]:
        """Which place is touched, and how many steps deep (0: at rest)."""
        touch, time_s = divmod(index / self._rate_hz, REST_S + TOUCH_S)
        phase = max(0.0, time_s - REST_S) / TOUCH_S
        step = round(STEPS * np.sin(np.pi * phase) ** 2)
        return (int(touch) % len(PLACES), step) if step else (0, 0)


def _pose(sensor: SimulatedSensor, place: int, step: int) -> Pose:
    height, width = sensor.shape
    x, y = PLACES[place]
    return Pose(DEPTH_MM * step / STEPS, (x * width * sensor.mm_per_px, y * height * sensor.mm_per_px))


@lru_cache(maxsize=2)
def _noise_free_levels(sensor: SimulatedSensor) -> dict[tuple[int, int], NDArray[Any]]:
    """Linear grey levels (H, W, 3) float32 by place and step: before noise, response curve and rounding."""
    linear = sensor.linear()
    wanted = [(0, 0), *((place, step) for place in range(len(PLACES)) for step in range(1, STEPS + 1))]
    return {
        key: simulate_pose(linear, BALL, _pose(sensor, *key), rng=None, quantise=False).image.astype(
            np.float32
        )
        for key in wanted
    }
