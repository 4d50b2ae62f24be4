"""A result of random numbers, with two contacts."""

import numpy as np
import pytest

from gelform.errors import Finding
from gelform.result import Reconstruction


@pytest.fixture
def result():
    rng = np.random.default_rng(0)
    shape = (24, 32)
    return Reconstruction(
        depth=rng.normal(0, 1, shape).astype(np.float32),
        depth_sigma_mm=None,
        gradients=rng.normal(0, 1, (*shape, 2)).astype(np.float32),
        gradients_sigma=rng.uniform(0, 1, (*shape, 2)).astype(np.float32),
        observed_gradients=rng.normal(0, 1, (*shape, 2)).astype(np.float32),
        confidence=rng.uniform(0, 1, shape).astype(np.float32),
        contact=two_contacts(shape),
        known=np.ones(shape, dtype=bool),
        mm_per_px=0.0634,
        mm_per_px_sigma=0.0009,
        zero="untouched",
        solver="dct",
        curl_rms=0.01,
        health=(Finding("background_ratio", "<b>darker</b> & older", 0.87),),
        index=3,
        time_s=1.5,
        wall_time_ns=1_700_000_000_123_456_789,
        calibration_digest="ab12",
    )


def two_contacts(shape):
    """A rectangle of 4x6 pixels, and one of 3x2 at the right border."""
    contact = np.zeros(shape, dtype=bool)
    contact[5:9, 4:10] = True
    contact[15:18, -2:] = True
    return contact
