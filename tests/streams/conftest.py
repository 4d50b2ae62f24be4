"""Images for streams: a gel at rest and pressed, with noise of their own, simulated once."""

from __future__ import annotations

import numpy as np
import pytest

from gelform import Reconstructor
from gelform.simulate import Ball, Pose, simulate_pose


@pytest.fixture(scope="session")
def reconstruct(calibration):
    """Of the shared simulated sensor."""
    return Reconstructor(calibration)


@pytest.fixture(scope="session")
def at_rest(sensor, made_once):
    """Ten images of the untouched gel."""
    rng = np.random.default_rng(20)
    return made_once("at_rest", lambda _: [_image(sensor, 0.0, rng) for _ in range(10)])


@pytest.fixture(scope="session")
def pressed(sensor, made_once):
    """Ten images of a ball 0.5 mm deep."""
    rng = np.random.default_rng(21)
    return made_once("pressed", lambda _: [_image(sensor, 0.5, rng) for _ in range(10)])


def _image(sensor, depth_mm, rng):
    return simulate_pose(sensor, Ball(3.0), Pose(depth_mm), rng=rng).image
