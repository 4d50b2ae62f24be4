"""A judge of the small simulated sensor, and images to judge."""

import numpy as np
import pytest

from gelform.calibration.guided.guide import Judge
from gelform.simulate import Ball, simulate_background, simulate_press

BALL_MM = 5.0


@pytest.fixture(scope="session")
def untouched(sensor):
    return np.asarray(simulate_background(sensor, np.random.default_rng(31)), np.uint8)


@pytest.fixture
def judge(sensor, untouched):
    background = np.asarray(simulate_background(sensor, None), np.float32)
    return Judge(background, untouched, sensor.noise_sd, BALL_MM / 2 / sensor.mm_per_px)


@pytest.fixture
def press(sensor):
    """An image of a ball pressed somewhere (mm from the middle), with its truth."""

    def made(x_mm=0.0, y_mm=0.0, depth_mm=0.4, seed=1, diameter_mm=BALL_MM):
        ball, rng = Ball(diameter_mm / 2), np.random.default_rng(seed)
        return simulate_press(sensor, ball, depth_mm=depth_mm, center_mm=(x_mm, y_mm), rng=rng, oversample=1)

    return made
