"""What changes from frame to frame."""

import re
from dataclasses import replace

import numpy as np
import pytest

from gelform.simulate import Ball, Pose, Timing, simulate_pose
from made.sensors import PLAIN


def test_leds_drift_and_flicker():
    sensor = replace(PLAIN, timing=Timing(drift=(0.2, -0.1, 0.0), drift_time_s=10.0))
    settings = {"rng": None, "quantise": False}
    first, later = (simulate_pose(sensor, Ball(2), Pose(0), time_s=t, **settings).image for t in (0.0, 10.0))
    part = 1 - np.exp(-1)
    np.testing.assert_allclose((later / first).mean((0, 1)), [1 + 0.2 * part, 1 - 0.1 * part, 1], rtol=1e-6)
    rolling = replace(PLAIN, timing=Timing(flicker=0.1, flicker_hz=100, readout_s=0.03))
    rows = (simulate_pose(rolling, Ball(2), Pose(0), time_s=0.0013, **settings).image / first)[:, 0, 0]
    crossings = np.count_nonzero(np.diff(np.sign(rows - 1)))
    assert crossings == 6
    assert rows.max() == pytest.approx(1.1, abs=0.01)


REFUSED = [
    (lambda: Timing(readout_s=1.0), "readout_s"),
    (lambda: Timing(drop_probability=1.0), "drop_probability"),
    (lambda: Timing(frame_rate_hz=0), "frame_rate_hz"),
]


@pytest.mark.parametrize(("make", "message"), REFUSED)
def test_bad_settings_are_refused_with_the_reason(make, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        make()
