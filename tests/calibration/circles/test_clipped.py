"""Clipped channels of a background: their share is said, and said of presses in the place of a wrong ball."""

import re

import numpy as np
import pytest

from gelform.calibration.circles.clipped import light_notes
from gelform.calibration.circles.refine import misfit_reasons


@pytest.mark.parametrize(
    ("channel", "gain", "said"),
    [
        (2, 0.04, r"100 % of the background image .* \(blue in 100 % below 8 gray levels\).*raise the light"),
        (0, 50, r"100 % of the background image .* \(red in 100 % saturated\).*lower"),
    ],
)
def test_a_channel_that_says_little_is_noted(presses, channel, gain, said):
    assert light_notes(presses.background) == ()
    gains = np.ones(3, np.float32)
    gains[channel] = gain
    (note,) = light_notes(np.minimum(presses.background * gains, 255))
    assert re.match(said, note)
    assert "exposure" in note


def test_channels_that_are_clipped_in_turn_are_summed_up():
    """None of them in a tenth of the image; no pixel counts twice."""
    background = np.full((60, 80, 3), 100, np.float32)
    background[20:30, 20:60, 0], background[30:40, 20:60, 2], background[30:34, 20:60, 1] = 255, 255, 2
    (note,) = light_notes(background)
    assert note.startswith(
        "17 % of the background image is at an end of the camera's range (green in 3 % below 8"
    )
    assert "red in 8 %, blue in 8 % saturated" in note
    assert light_notes(np.where(background > 200, 100, background)) == ()


def test_presses_of_clipped_light_are_not_called_no_ball():
    """Their slopes read less than the ball's because of the light."""
    reasons = misfit_reasons([(0.1, 0.4), (0.3, 1.0), (0.05, 1.0)], "17 % of the image is clipped")
    assert reasons[2] is None
    assert all("17 % of the image is clipped" in one and "no ball" not in one for one in reasons[:2])
    assert "it is no ball" in misfit_reasons([(0.1, 0.4), (0.05, 1.0)])[0]
