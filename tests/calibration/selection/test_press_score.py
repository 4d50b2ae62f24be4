"""The score of a press: what a known error of the slopes does to its normals and its cap."""

import numpy as np
import pytest

from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.selection.press_score import press_score


class TimesTheTruth:
    """A model that reads the ball's own slopes, a little too steep or too gentle."""

    def __init__(self, press, contact, gain):
        self.press, self.contact, self.gain = press, contact, gain

    def gradients_at(self, change, x, y):
        return self.gain * self.press.ball_gradients(self.contact, np.asarray(y), np.asarray(x))


def test_the_truth_scores_next_to_nothing(prepared, found):
    score = press_score(prepared[0], found[0], TimesTheTruth(prepared[0], found[0], 1.0))
    assert score.normal_deg < 0.03
    assert score.cap_px < 0.005


def test_cap_error_is_that_of_the_depth(prepared, found):
    """A model whose slopes are 10 % too steep makes the cap too high by 10 %: its error is known."""
    press, contact = prepared[0], found[0]
    score = press_score(press, contact, TimesTheTruth(press, contact, 1.1))
    radius, a = press.ball_radius_px, contact.radius_px - 3 * min(press.size.shape) / 240
    depth = np.sqrt(radius**2 - np.linspace(0, a**2, 2000)) - np.sqrt(radius**2 - a**2)  # uniform in area
    assert score.cap_px == pytest.approx(0.1 * depth.std(), rel=0.25)
    assert 0.5 < score.normal_deg < 3


def test_normals_are_those_of_the_depth(prepared, found):
    """Slopes that no surface has, a turn about the centre, leave no trace in the depth: they do not count."""

    class Turning(TimesTheTruth):
        def gradients_at(self, change, x, y):
            way = np.stack([np.asarray(y) - self.contact.y_px, self.contact.x_px - np.asarray(x)], axis=-1)
            return super().gradients_at(change, x, y) + 0.004 * way

    press, contact = prepared[1], found[1]
    turned = Turning(press, contact, 1.0)
    raw = np.degrees(np.arctan(0.004 * 0.6 * contact.radius_px))
    assert press_score(press, contact, turned).normal_deg < 0.4 * raw


def test_a_contact_that_the_border_leaves_one_row_of_is_scored(prepared):
    press = max(prepared, key=lambda press: press.ball_radius_px)
    contact = ContactCircle(90.0, -25.0, 27.2, 0.5, 9.0)
    assert set(press.pixels(contact, 0.94)[0]) == {0}
    score = press_score(press, contact, TimesTheTruth(press, contact, 1.0))
    assert np.isfinite([score.normal_deg, score.cap_px]).all()
