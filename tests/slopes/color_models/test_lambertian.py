"""Lambertian: the camera's exponent and the crosstalk come back, exact on its own law."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.image.background.change import ChangeSettings, PreparedBackground
from gelform.slopes.color_models import LambertianModel, NearLightModel, Samples
from gelform.slopes.color_models.lambertian import inverse_lights, linear_change
from made.color_samples import LIGHTS, SHAPE, ball_samples, lambertian_change

pytestmark = pytest.mark.linear_algebra

SCALED = LIGHTS / LIGHTS[:, 2:]


def gamma_coded(exponent, mixture=None):
    """Samples of slopes up to 0.4 as a camera of that response and crosstalk sees them."""
    samples = ball_samples(lambda g, x, y: lambertian_change(g / 2, x, y))
    ratio = 1 + samples.color_change
    if mixture is not None:
        ratio = ratio @ mixture.T
    return replace(samples, color_change=ratio**exponent - 1, gradients=samples.gradients / 2)


@pytest.mark.parametrize("exponent", [0.45, 0.7, 1.0])
def test_the_response_is_found(exponent):
    model = LambertianModel.fit(gamma_coded(exponent))
    assert model.response == pytest.approx(exponent, abs=1e-3)
    np.testing.assert_allclose(model.lights, SCALED, atol=1e-3)


def test_a_given_response_is_taken():
    model = LambertianModel.fit(gamma_coded(0.7), response=0.7)
    assert model.response == 0.7
    np.testing.assert_allclose(model.lights, SCALED, atol=1e-5)
    with pytest.raises(ValueError, match="response > 0"):
        LambertianModel.fit(gamma_coded(0.7), response=-1)


def test_crosstalk_is_held_by_the_lights():
    mixture = np.array([[0.8, 0.15, 0.05], [0.1, 0.7, 0.2], [0.0, 0.2, 0.8]])
    samples = gamma_coded(0.7, mixture)
    model = LambertianModel.fit(samples)
    np.testing.assert_allclose(model.lights, mixture @ SCALED, atol=2e-3)
    found = model.gradients_at(samples.color_change, samples.x_px, samples.y_px)
    np.testing.assert_allclose(found, samples.gradients, atol=5e-3)


def test_linear_light_undoes_the_response():
    change = np.array([-0.5, 0.0, 0.5, -1.0])
    np.testing.assert_allclose(linear_change((1 + change) ** 0.45 - 1, 0.45), change, atol=1e-12)
    assert linear_change(change.astype(np.float32), 0.45).dtype == np.float32


def test_it_finds_its_lights_and_inverts_them():
    model = LambertianModel.fit(ball_samples(lambertian_change))
    np.testing.assert_allclose(model.lights, LIGHTS / LIGHTS[:, 2:], atol=1e-5)
    unseen = ball_samples(lambertian_change, seed=3)
    lit = (unseen.color_change > -0.98).all(axis=1)
    found = model.gradients_at(unseen.color_change, unseen.x_px, unseen.y_px)
    np.testing.assert_allclose(found[lit], unseen.gradients[lit], atol=1e-4)


def test_a_pixel_in_shadow_stays_finite():
    model = LambertianModel(LIGHTS / LIGHTS[:, 2:])
    gradients = model.gradients_at(
        np.array([[-1.0, -1.0, 5.0], [-1.0, -1.0, -1.0]]), np.zeros(2), np.zeros(2)
    )
    assert np.isfinite(gradients).all()
    assert np.linalg.norm(gradients, axis=1).max() <= 5.0 + 1e-6


def test_coplanar_lights_are_refused_with_their_condition_number():
    coplanar = np.array([[1.0, 0, 1], [0, 0, 1], [-1, 0, 1]])
    with pytest.raises(ValueError, match=r"condition number .*coplanar"):
        inverse_lights(coplanar)
    with pytest.raises(ValueError, match="condition number"):
        inverse_lights(coplanar + 1e-7 * np.eye(3))


def test_huber_weights_ignore_a_bad_press():
    good = ball_samples(lambertian_change)
    rng = np.random.default_rng(6)
    bad = rng.choice(len(good.x_px), 400, replace=False)
    change = good.color_change.copy()
    change[bad] = rng.uniform(-0.5, 0.5, (400, 3))
    spoilt = Samples(change, good.x_px, good.y_px, good.gradients, good.weight, SHAPE)
    model = LambertianModel.fit(spoilt)
    np.testing.assert_allclose(model.lights, LIGHTS / LIGHTS[:, 2:], atol=0.05)


@pytest.mark.parametrize("model", [LambertianModel, NearLightModel])
def test_its_color_change_is_the_ratio_of_light_however_dark_the_gel(model):
    """The law is of I/I0: levels added to either, as other models want them against noise, would bend it."""
    ratio = np.linspace(0.3, 1.9, 60).reshape(4, 5, 3).astype(np.float32)
    dark = np.full((4, 5, 3), 10.0, dtype=np.float32)
    settings = ChangeSettings(offset=model.change_offset, blur_px=0.0)
    np.testing.assert_allclose(PreparedBackground(dark, settings).change(dark * ratio), ratio - 1, atol=1e-5)
