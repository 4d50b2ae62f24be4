"""Images for streams: a gel at rest and pressed, simulated once; gels with a texture of their own."""

from __future__ import annotations

import numpy as np
import pytest

from gelform import Reconstructor
from gelform.simulate import Ball, Pose, simulate_pose
from stream.sensor_faults import Gel, found_in, frames_with


@pytest.fixture(scope="session")
def reconstruct(calibration):
    """Of the shared simulated sensor."""
    return Reconstructor(calibration)


def _images(sensor, depth_mm, seed):
    rng = np.random.default_rng(seed)
    return [simulate_pose(sensor, Ball(3.0), Pose(depth_mm), rng=rng).image for _ in range(10)]


@pytest.fixture(scope="session")
def at_rest(sensor, made_once):
    """Ten images of the untouched gel."""
    return made_once("at_rest", lambda _: _images(sensor, 0.0, 20))


@pytest.fixture(scope="session")
def pressed(sensor, made_once):
    """Ten images of a ball 0.5 mm deep."""
    return made_once("pressed", lambda _: _images(sensor, 0.5, 21))


@pytest.fixture(scope="session")
def findings(sensor, calibration):
    """The names found in 60 s of a gel with a fault, and when; both drawn from the seed."""

    def found(fault, seed=0, seconds=50.0):
        rng = np.random.default_rng([seed, 9])
        gel = Gel.drawn(sensor, rng)
        own = gel.calibration(calibration, rng)
        return found_in(frames_with(fault, gel, seconds, rng), own)

    return found
