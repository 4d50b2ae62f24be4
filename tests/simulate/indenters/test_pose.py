"""Poses turn the indenter."""

import re
from dataclasses import replace

import numpy as np
import pytest

from gelform.simulate import Coating, Cylinder, Pose, simulate_press
from made.sensors import DRAGGED


def test_a_pose_turns_the_indenter():
    settings = {"depth_mm": 0.3, "rng": None, "oversample": 1, "quantise": False}
    sensor = replace(DRAGGED, coating=Coating(), shape=(61, 61))
    lying = simulate_press(sensor, Cylinder(1.5, 3), **settings).depth_mm
    standing = simulate_press(sensor, Cylinder(1.5, 3), spin_deg=90, **settings).depth_mm
    np.testing.assert_allclose(standing, lying.T, atol=1e-4)


REFUSED = [
    (lambda: Pose(np.nan), "finite numbers"),
    (lambda: Pose(0.3, tilt_deg=(0, 90)), "tilt_deg within"),
]


@pytest.mark.parametrize(("make", "message"), REFUSED)
def test_bad_settings_are_refused_with_the_reason(make, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        make()
