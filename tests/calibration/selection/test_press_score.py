"""The score of a press: what a known error of the slopes does to its normals and its cap."""

import numpy as np
import pytest

from gelform.calibration.selection.press_score import press_score


class TimesTheTruth:
    """A model that reads the ball's own slopes, a little too steep or too gentle."""

    def __init__(self, press, contact, gain):
        self.press, self.contact, self.gain = press, contact, gain

    def gradients_at(self, change, x, y):
        return self.gain * self.press.ball_gradients(self.contact, np.asarray(y), np.asarray(x))


def test_the_truth_scores_next_to_nothing(prepared, found):
    score = press_score(prepared[0], found[0], TimesTheTruth(prepared[0], found[0], 1.0))
    assert score.normal_deg < 0.01
    assert score.cap_px < 0.05


def test_cap_error_is_that_of_the_depth(prepared, found):
    """A model whose slopes are 10 % too steep makes the cap too high by 10 %: its error is known."""
    press, contact = prepared[0], found[0]
    score = press_score(press, contact, TimesTheTruth(press, contact, 1.1))
    radius, a = press.ball_radius_px, contact.radius_px - 3 * min(press.size.shape) / 240
    depth = np.sqrt(radius**2 - np.linspace(0, a**2, 2000)) - np.sqrt(radius**2 - a**2)  # uniform in area
    assert score.cap_px == pytest.approx(0.1 * depth.std(), rel=0.25)
    assert 0.5 < score.normal_deg < 3
