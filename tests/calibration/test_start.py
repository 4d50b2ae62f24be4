"""A second unit begins at any first unit's model: what `auto` chose, whatever it was, is one to start from."""

from dataclasses import replace

import numpy as np
import pytest

import gelform
from gelform.calibration.start import start_from, translated
from gelform.color_models import HierarchicalModel
from gelform.errors import CalibrationError
from gelform.simulate import Ball, simulate_press


def test_a_translated_model_reads_the_slopes_that_the_first_one_reads(lambertian_calibration, simulated):
    """On the image of a ball that neither has seen: as far from the truth, and near to each other."""
    press = simulate_press(
        simulated.sensor, Ball(3.2), depth_mm=0.5, center_mm=(1.0, -1.0), rng=np.random.default_rng(2)
    )
    model = translated(lambertian_calibration)
    assert isinstance(model, HierarchicalModel)
    change = replace(lambertian_calibration.change, offset=HierarchicalModel.change_offset)
    lambertian_calibration = replace(lambertian_calibration, forward=response_alone(lambertian_calibration))
    other = replace(lambertian_calibration, color_model=model, change=change)
    y, x = np.mgrid[: press.image.shape[0], : press.image.shape[1]]
    inside = np.hypot(x - press.center_px[0], y - press.center_px[1]) < 0.8 * press.contact_radius_px
    first, second = (
        gelform.Reconstructor(one)(press.image).gradients[inside] for one in (lambertian_calibration, other)
    )
    assert np.sqrt(np.mean(first**2)) > 0.15
    assert np.sqrt(np.mean((first - second) ** 2)) < 0.04


def response_alone(calibration):
    """Its forward response, which takes no step from the slopes that its color model reads."""
    return replace(calibration.forward, step_sigma=None)


def test_a_second_unit_starts_from_any_color_model(lambertian_calibration, presses):
    start = start_from(lambertian_calibration, presses, "auto")
    assert start.digest == lambertian_calibration.digest
    assert start.model.degree == 3, "as the model that is drawn to it"


def test_of_the_same_color_model_the_start_is_the_model_itself(calibration, presses):
    assert start_from(calibration, presses, "hierarchical").model is calibration.color_model


def test_the_noise_of_colours_is_that_of_the_response(lambertian_calibration, monkeypatch):
    """Alike channels stay alike: the covariance, not a deviation of each."""
    drawn = []
    covariance = 1e-4 * np.array([[1.0, 0.9, 0.0], [0.9, 1.0, 0.0], [0.0, 0.0, 0.25]])
    forward = replace(response_alone(lambertian_calibration), covariance=covariance)
    plain = type(lambertian_calibration.color_model).gradients_at

    def read(self, change, x, y):
        drawn.append(change)  # of no slope: all of it is noise
        return plain(self, change, x, y)

    first = replace(lambertian_calibration, forward=forward, slope_sigma=flat(lambertian_calibration))
    monkeypatch.setattr(type(first.color_model), "gradients_at", read)
    translated(first)
    np.testing.assert_allclose(np.cov(drawn[0].T), covariance, atol=1e-5)


def flat(calibration):
    """Its deviation of slopes, measured up to hardly any slope."""
    return replace(calibration.slope_sigma, slopes=(0.0, 1e-6), sigmas=(0.01, 0.01))


def test_a_start_without_a_forward_response_is_refused(lambertian_calibration, presses):
    with pytest.raises(CalibrationError, match="what colour a slope gives"):
        start_from(replace(lambertian_calibration, forward=None), presses, "auto")


def test_a_start_for_images_of_another_size_is_refused(lambertian_calibration, presses):
    with pytest.raises(ValueError, match="132x176 px, got one for 10x20 px"):
        start_from(replace(lambertian_calibration, image_shape=(10, 20)), presses, "auto")
