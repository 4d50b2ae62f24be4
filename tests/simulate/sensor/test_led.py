"""LEDs: rings, colours, refusals."""

import re

import numpy as np
import pytest

from gelform.simulate import Led, led_color
from gelform.simulate.sensor.led import led_ring


def test_a_ring_goes_round_as_its_angles_say():
    right, down = led_ring(10.0, 5.0, (0, 90), ((1, 0, 0), (0, 1, 0)))
    np.testing.assert_allclose(right.position_mm, (10, 0, 5), atol=1e-9)
    np.testing.assert_allclose(down.position_mm, (0, 10, 5), atol=1e-9)


def test_colours_of_leds_land_in_their_channels():
    assert np.argmax(led_color(625)) == 0
    assert np.argmax(led_color(530)) == 1
    assert np.argmax(led_color(465)) == 2
    assert led_color(465)[2] > led_color(480)[2]


REFUSED = [
    (lambda: Led((0, 0, 2), (1, 1, 1), beam_power=-1), "beam_power"),
    (lambda: Led((0, 0, 2), (1, 1, 1), aim_mm=(0, 0, 2)), "aim_mm"),
    (lambda: led_color(900), "peak_nm"),
    (lambda: Led((0, 0, -2), (1, 1, 1)), "z > 0 mm"),
    (lambda: Led((0, 0, 2), (0, 0, 0)), "color"),
]


@pytest.mark.parametrize(("make", "message"), REFUSED)
def test_bad_settings_are_refused_with_the_reason(make, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        make()
