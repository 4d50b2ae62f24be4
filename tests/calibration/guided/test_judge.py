"""The content of images during a guided calibration, against simulated presses."""

from __future__ import annotations

import numpy as np
import pytest

from gelform.simulate import simulate_background


def looked(judge, image, accepted=()):
    judge.look(image)
    return judge.look(image, accepted)


def test_untouched_is_untouched_whatever_the_noise(judge, sensor):
    for seed in range(5):
        look = judge.look(np.asarray(simulate_background(sensor, np.random.default_rng(seed)), np.uint8))
        assert not look.touched


@pytest.mark.parametrize(("x_mm", "y_mm"), [(0, 0), (5, -3), (-6, 4)])
def test_a_press_is_found_where_it_is(judge, press, x_mm, y_mm):
    made = press(x_mm, y_mm)
    look = looked(judge, made.image)
    assert look.reason == ""
    assert not look.moving
    assert look.circle[:2] == pytest.approx(made.center_px, abs=1.5)
    assert look.circle[2] == pytest.approx(made.contact_radius_px, rel=0.35)


def test_a_ball_that_moves_is_not_still(judge, press):
    judge.look(press(0, 0).image)
    assert judge.look(press(1.0, 0).image).moving
    assert not judge.look(press(1.0, 0, seed=2).image).moving


def test_reasons_say_what_to_do(judge, press):
    here = press(2, 1)
    circle = looked(judge, here.image).circle
    assert "before" in looked(judge, here.image, [circle]).reason
    assert "harder" in looked(judge, press(0, 0, depth_mm=0.06).image).reason
    assert "too deep" in looked(judge, press(0, 0, depth_mm=0.7, diameter_mm=14).image).reason


def test_an_image_of_another_sensor_is_refused_with_the_reason(judge, untouched):
    assert "BGR" in looked(judge, untouched[..., ::-1].copy()).reason
