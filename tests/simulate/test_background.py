"""The untouched gel: averaging, exposure."""

import re
from dataclasses import replace

import numpy as np
import pytest

from gelform.simulate import Optics, exposed, simulate_background
from made.sensors import PLAIN, SMALL


def test_averaging_frames_lowers_the_noise():
    sensor = replace(SMALL, noise_sd=2.0, noise_gain=0.0)
    clean = simulate_background(sensor, None, quantise=False)
    mean = simulate_background(sensor, np.random.default_rng(0), frames=16)
    assert mean.dtype == np.float32
    assert (mean - clean).std() == pytest.approx(0.5, rel=0.1)


def test_exposed_gives_the_mean_levels():
    sensor = exposed(replace(SMALL, white_balance=(1, 1, 1)), (60, 80, 100))
    np.testing.assert_allclose(simulate_background(sensor, None, quantise=False).mean((0, 1)), (60, 80, 100))


@pytest.mark.parametrize("gamma", [1.0, 1.8])
def test_exposed_gives_the_levels_behind_the_response(gamma):
    sensor = exposed(replace(PLAIN, optics=Optics(response_gamma=gamma)), (60, 80, 100))
    np.testing.assert_allclose(
        simulate_background(sensor, None, quantise=False).mean((0, 1)), (60, 80, 100), rtol=1e-6
    )


REFUSED = [
    (lambda: simulate_background(SMALL, None, frames=0), "frames"),
]


@pytest.mark.parametrize(("make", "message"), REFUSED)
def test_bad_settings_are_refused_with_the_reason(make, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        make()
