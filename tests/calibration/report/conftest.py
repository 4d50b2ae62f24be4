"""Held-out samples that are put together, with errors that are known."""

import numpy as np
import pytest

from gelform.ball import ball_gradients
from gelform.calibration.report.held_out import HeldOutSample

SHAPE = (60, 80)


@pytest.fixture(scope="session")
def sample():
    """Makes the pixels of a ball of radius 40 px in an image of 60x80 px, read with a gain, a bias and noise."""
    return _sample


def _sample(index=0, *, gain=1.0, noise=0.0, bias=(0.0, 0.0), circle=(40.0, 30.0, 25.0), rng=None):
    y, x = (axis.ravel() for axis in np.mgrid[: SHAPE[0], : SHAPE[1]])
    inside = np.hypot(x - circle[0], y - circle[1]) < circle[2] - 2
    x, y = x[inside].astype(np.float32), y[inside].astype(np.float32)
    true = ball_gradients(x, y, circle[:2], 40.0)
    seen = gain * true + np.asarray(bias)
    if noise:
        seen = seen + noise * rng.standard_normal(true.shape)
    empty = np.zeros((3, 3), dtype=np.float32)
    return HeldOutSample(index, circle, x, y, true.astype(np.float32), seen.astype(np.float32), empty)
