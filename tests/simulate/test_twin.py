"""Presses that look like a calibrated sensor's."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.image.background.change import color_change_from_image
from gelform.simulate import Ball, Pose
from gelform.simulate.twin import CalibratedLook, Twin


def test_an_untouched_twin_is_the_background(calibration):
    image = Twin(calibration).press(Ball(3), Pose(0.0), rng=None).image
    assert np.abs(image - calibration.background).max() <= 0.5 + 1e-4


def test_the_color_is_the_calibrations_forward_response(calibration):
    press = Twin(calibration).press(Ball(3), Pose(0.5), rng=None)
    y, x = (axis.ravel() for axis in np.mgrid[: press.depth_mm.shape[0], : press.depth_mm.shape[1]])
    expected = calibration.forward.color_from_gradients(
        press.gradients.reshape(-1, 2), x, y, depth_px=press.depth_mm.ravel() / calibration.mm_per_px
    ).reshape(*press.gradients.shape[:2], 3)
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
    look = CalibratedLook(calibration, steepest=0.8)
    depth = np.full(calibration.image_shape, 0.3)
    steep, limit = np.zeros((2, *calibration.image_shape, 2))
    steep[..., 0], limit[..., 0] = 3.0, 0.8
    np.testing.assert_allclose(look.color_change(steep, depth), look.color_change(limit, depth), atol=1e-6)
    limit[..., 0] = 0.4
    assert np.abs(look.color_change(steep, depth) - look.color_change(limit, depth)).max() > 0.02


def test_the_depth_changes_the_color_in_millimeters(calibration):
    """Level gel that is pressed 0.3 mm deep: the response counts pixels, of whatever width."""
    level, depth = np.zeros((*calibration.image_shape, 2), np.float32), np.full(calibration.image_shape, 0.3)
    look = CalibratedLook(calibration)
    found = look.color_change(level, depth)
    assert np.abs(found).max() > 0.005
    assert not look.color_change(level, 0 * depth).any()
    wider = CalibratedLook(replace(calibration, mm_per_px=2 * calibration.mm_per_px))
    np.testing.assert_allclose(wider.color_change(level, 2 * depth), found, atol=1e-6)


def test_the_noise_is_that_of_the_images(calibration):
    uneven = replace(calibration, settings={"image_noise": [1.0, 2.0, 4.0]})
    for known in (calibration, uneven):
        look = CalibratedLook(known)
        np.testing.assert_array_equal(look.noise, known.settings["image_noise"])
        noisy = Twin(look).press(Ball(3), Pose(0.0), rng=np.random.default_rng(0)).image.astype(float)
        apart = (noisy - calibration.background).std(axis=(0, 1))
        np.testing.assert_allclose(apart, np.sqrt(look.noise**2 + 1 / 12), rtol=0.1)
    unknown = {k: v for k, v in calibration.settings.items() if k != "image_noise"}
    plain = CalibratedLook(replace(calibration, settings=unknown))
    np.testing.assert_array_equal(plain.noise, calibration.background_noise)


def test_the_same_seed_gives_the_same_presses_with_noise(calibration):
    twin = Twin(calibration)
    one, two, other = (
        twin.ball_presses(ball_diameters_mm=[6.0], count=2, rng=np.random.default_rng(seed))
        for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one.presses[1].image, two.presses[1].image)
    assert np.any(one.presses[1].image != other.presses[1].image)


def test_what_is_no_look_is_refused(calibration):
    with pytest.raises(ValueError, match="square pixels"):
        Twin(replace(calibration, mm_per_px=(0.06, 0.07)))
    with pytest.raises(TypeError, match=r"Expected a Calibration or a look .* got str.*load_calibration"):
        Twin("mini.npz")
