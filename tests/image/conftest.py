"""One gel at rest and pressed, for what compares a frame with its background."""

import numpy as np
import pytest

from gelform.simulate import Ball, simulate_background, simulate_press


@pytest.fixture(scope="session")
def rest(sensor):
    return simulate_background(sensor, np.random.default_rng(0))


@pytest.fixture(scope="session")
def pressed(sensor):
    return simulate_press(
        sensor, Ball(3.0), depth_mm=0.6, center_mm=(1.5, 1), rng=np.random.default_rng(1)
    ).image
