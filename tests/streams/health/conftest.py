"""Gels with a texture of their own, and what a stream finds of each fault of theirs."""

import numpy as np
import pytest

from stream.sensor_faults import Gel, found_in, frames_with


@pytest.fixture(scope="session")
def findings(sensor, calibration):
    """The names found in 60 s of a gel with a fault, and when; both drawn from the seed."""

    def found(fault, seed=0, seconds=50.0):
        rng = np.random.default_rng([seed, 9])
        gel = Gel.drawn(sensor, rng)
        own = gel.calibration(calibration, rng)
        return found_in(frames_with(fault, gel, seconds, rng), own)

    return found
