"""Presses that look like a calibrated sensor's."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.background import color_change_from_image
from gelform.simulate import Ball, Pose
from gelform.simulate.like import Twin


def test_an_untouched_twin_is_the_background(calibration):
    image = Twin(calibration).press(Ball(3), Pose(0.0), rng=None).image
    assert np.abs(image - calibration.background).max() <= 0.5 + 1e-4


def test_the_colour_is_the_calibrations_forward_response(calibration):
    press = Twin(calibration).press(Ball(3), Pose(0.5), rng=None)
    expected = calibration.color_from_gradients(press.gradients.astype(np.float32))
    seen = color_change_from_image(
        press.image, calibration.background, replace(calibration.change, blur_px=0.0)
    )
    level = 0.51 / (calibration.background + calibration.change.offset)
    assert np.all(np.abs(seen - expected)[~press.saturated] <= level[~press.saturated] + 1e-5)
    assert np.abs(seen).max() > 0.1


def test_the_calibration_recovers_the_depth_of_its_twin(calibration):
    from gelform import Reconstructor

    press = Twin(calibration).press(Ball(3), Pose(0.5, (1.0, 0.5)), rng=np.random.default_rng(0))
    found = Reconstructor(calibration)(press.image)
    inside = press.contact
    assert np.sqrt(np.mean((found.depth_mm - press.depth_mm)[inside] ** 2)) < 0.1
    assert abs(found.depth_mm.max() - 0.5) < 0.12


def test_steep_slopes_are_rendered_as_the_steepest_known(calibration):
    twin = Twin(calibration, steepest=0.8)
    steep, limit = np.zeros((2, *calibration.image_shape, 2))
    steep[..., 0], limit[..., 0] = 3.0, 0.8
    np.testing.assert_allclose(twin.color_change(steep), twin.color_change(limit), atol=1e-6)


def test_the_same_seed_gives_the_same_presses_with_noise(calibration):
    twin = Twin(calibration)
    one, two, other = (
        twin.ball_presses(ball_diameters_mm=[6.0], count=2, rng=np.random.default_rng(seed))
        for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one.presses[1].image, two.presses[1].image)
    assert np.any(one.presses[1].image != other.presses[1].image)


def test_pixels_that_are_not_square_are_refused(calibration):
    with pytest.raises(ValueError, match="square pixels"):
        Twin(replace(calibration, mm_per_px=(0.06, 0.07)))
