"""Sensors that cannot be."""

import re
from dataclasses import replace

import pytest

from gelform.simulate import Led, SimulatedSensor
from made.sensors import PLAIN, SMALL

REFUSED = [
    (lambda: replace(PLAIN, leds=(Led((1, 0, 1), (1, 1, 1)),)), "outside the gel"),
    (lambda: replace(PLAIN, shading=((1, 2),)), "shading"),
    (lambda: SimulatedSensor(()), "at least one LED"),
    (lambda: replace(SMALL, noise_sd=-1), "noise_sd >= 0"),
    (lambda: replace(SMALL, noise_gain=-0.1), "noise_gain >= 0"),
    (lambda: replace(SMALL, vignetting=1.0), "vignetting"),
    (lambda: replace(SMALL, crosstalk=((1, 0), (0, 1))), "crosstalk"),
    (lambda: replace(SMALL, mm_per_px=0.0), "mm_per_px"),
    (lambda: replace(SMALL, shape=(0, 3)), "shape"),
]


@pytest.mark.parametrize(("make", "message"), REFUSED)
def test_bad_settings_are_refused_with_the_reason(make, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        make()
