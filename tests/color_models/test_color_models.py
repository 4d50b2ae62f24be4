"""Color models: no change means no slope, exact on their own forward model, frames equal scattered pixels."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.color_models import COLOR_MODELS, LambertianModel, PolynomialModel, Samples
from gelform.color_models._shared.forward import ForwardResponse
from gelform.color_models._shared.least_squares import (
    monomials,
    polynomial_terms,
    position_powers,
    robust_ridge,
    unit_position,
)
from gelform.color_models.lambertian import inverse_lights
from made.color_samples import LIGHTS, SHAPE, ball_samples, lambertian_change, shading_change


def fitted(name, samples, **settings):
    """A fitted model; where it takes torch to train, a test of it is skipped without."""
    if name == "mlp":
        pytest.importorskip("torch", reason="torch, the extra `torch`, is not installed")
        settings = {"steps": 200, **settings}
    return COLOR_MODELS[name].fit(samples, **settings)


@pytest.mark.parametrize("name", COLOR_MODELS)
def test_no_colour_change_means_no_slope(name):
    model = fitted(name, ball_samples(lambertian_change))
    prepared = model.prepare(np.full((*SHAPE, 3), 100, np.float32), SHAPE)
    gradients, _ = prepared.gradients_from_color(np.zeros((*SHAPE, 3), dtype=np.float32))
    np.testing.assert_allclose(gradients, 0, atol=1e-6)


@pytest.mark.parametrize("name", COLOR_MODELS)
def test_a_frame_equals_its_pixels_one_by_one(name):
    model = fitted(name, ball_samples(shading_change))
    change = np.random.default_rng(1).uniform(-0.3, 0.3, (*SHAPE, 3)).astype(np.float32)
    frame, _ = model.prepare(np.full((*SHAPE, 3), 100, np.float32), SHAPE).gradients_from_color(change)
    y, x = (axis.ravel() for axis in np.mgrid[: SHAPE[0], : SHAPE[1]])
    pixels = model.gradients_at(change.reshape(-1, 3), x, y)
    np.testing.assert_allclose(frame.reshape(-1, 2), pixels, atol=2e-5)


@pytest.mark.parametrize("name", COLOR_MODELS)
def test_saved_arrays_give_the_same_model(name):
    model = fitted(name, ball_samples(shading_change))
    again = COLOR_MODELS[name].from_arrays(*model.to_arrays())
    samples = ball_samples(shading_change, seed=2)
    for a, b in zip(
        *(m.gradients_at(samples.color_change, samples.x_px, samples.y_px) for m in (model, again))
    ):
        np.testing.assert_array_equal(a, b)


def test_lambertian_finds_its_lights_and_inverts_them():
    model = LambertianModel.fit(ball_samples(lambertian_change))
    np.testing.assert_allclose(model.lights, LIGHTS / LIGHTS[:, 2:], atol=1e-5)
    unseen = ball_samples(lambertian_change, seed=3)
    lit = (unseen.color_change > -0.98).all(axis=1)
    found = model.gradients_at(unseen.color_change, unseen.x_px, unseen.y_px)
    np.testing.assert_allclose(found[lit], unseen.gradients[lit], atol=1e-4)


def test_lambertian_in_shadow_stays_finite():
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


def test_polynomial_follows_lights_that_turn_over_the_image():
    unseen = ball_samples(shading_change, seed=4)
    errors = {}
    for degrees in ((0,), (4, 3, 1)):
        model = PolynomialModel.fit(ball_samples(shading_change), position_degrees=degrees)
        found = model.gradients_at(unseen.color_change, unseen.x_px, unseen.y_px)
        errors[degrees] = np.sqrt(np.mean((found - unseen.gradients) ** 2))
    assert errors[(4, 3, 1)] < 0.03
    assert errors[(4, 3, 1)] < 0.3 * errors[(0,)]


def test_polynomial_recovers_a_polynomial_exactly():
    rng = np.random.default_rng(5)
    degrees = (5, 3, 1)
    size = sum(len(position_powers(degrees[len(t) - 1])) for t in monomials(3, 3))
    truth = PolynomialModel(rng.normal(size=(size, 2)), degrees, SHAPE)
    samples = ball_samples(lambertian_change, count=3000)
    gradients = truth.gradients_at(samples.color_change, samples.x_px, samples.y_px)
    samples = Samples(samples.color_change, samples.x_px, samples.y_px, gradients, samples.weight, SHAPE)
    model = PolynomialModel.fit(samples, position_degrees=degrees, ridge=1e-13)
    np.testing.assert_allclose(
        model.gradients_at(samples.color_change, samples.x_px, samples.y_px), gradients, rtol=1e-4, atol=1e-4
    )


def test_polynomial_refuses_frames_of_another_size():
    model = PolynomialModel.fit(ball_samples(lambertian_change))
    with pytest.raises(ValueError, match="as calibrated, got 10x10"):
        model.prepare(np.zeros((10, 10, 3)), (10, 10))
    with pytest.raises(ValueError, match="position degrees"):
        PolynomialModel.fit(ball_samples(lambertian_change), position_degrees=(9,))


def test_huber_weights_ignore_a_bad_press():
    good = ball_samples(lambertian_change)
    rng = np.random.default_rng(6)
    bad = rng.choice(len(good.x_px), 400, replace=False)
    change = good.color_change.copy()
    change[bad] = rng.uniform(-0.5, 0.5, (400, 3))
    spoilt = Samples(change, good.x_px, good.y_px, good.gradients, good.weight, SHAPE)
    model = LambertianModel.fit(spoilt)
    np.testing.assert_allclose(model.lights, LIGHTS / LIGHTS[:, 2:], atol=0.05)


def test_robust_ridge_is_least_squares_without_outliers():
    rng = np.random.default_rng(7)
    design, truth = rng.normal(size=(200, 4)), rng.normal(size=(4, 2))
    found = robust_ridge(design, design @ truth, np.ones(200), ridge=1e-12, huber=1.0)
    np.testing.assert_allclose(found, truth, rtol=1e-8)


def test_monomials_are_complete_and_ordered():
    assert monomials(2, 2) == [(0,), (1,), (0, 0), (0, 1), (1, 1)]
    assert len(monomials(3, 3)) == 3 + 6 + 10
    x, y = unit_position(np.array([0.0, 63.0]), np.array([23.5, 23.5]), SHAPE)
    np.testing.assert_allclose([x, y], [[-31.5 / 32, 31.5 / 32], [0, 0]])
    terms = polynomial_terms(np.array([[2.0, 3.0]]), np.array([0.5]), np.array([0.25]), (1, 0))
    np.testing.assert_allclose(terms, [[2, 1, 0.5, 3, 1.5, 0.75, 4, 6, 9]])


def test_forward_response_predicts_the_colour_it_was_fitted_on():
    response = ForwardResponse.fit(ball_samples(shading_change))
    unseen = ball_samples(shading_change, seed=8)
    found = response.color_from_gradients(unseen.gradients, unseen.x_px, unseen.y_px)
    assert np.sqrt(np.mean((found - unseen.color_change) ** 2)) < 0.02
    at_rest = response.color_from_gradients(np.zeros((5, 2)), np.arange(5), np.arange(5))
    np.testing.assert_array_equal(at_rest, 0)


def test_a_forward_response_that_knows_depths_says_what_slopes_cannot():
    slopes = ball_samples(shading_change)
    depth = np.random.default_rng(9).uniform(0, 1, len(slopes.x_px))
    x, _ = unit_position(slopes.x_px, slopes.y_px, SHAPE)
    brighter = (depth * (0.2 + 0.1 * x))[:, None] * np.array([1.0, 0.5, 0.0])
    samples = replace(slopes, color_change=slopes.color_change + brighter)
    response = ForwardResponse.fit(samples, depth_mm=depth)
    assert response.knows_depth
    at = samples.gradients, samples.x_px, samples.y_px
    blind = response.color_from_gradients(*at)
    seeing = response.color_from_gradients(*at, depth_mm=depth)
    error = [np.sqrt(np.mean((found - samples.color_change) ** 2)) for found in (blind, seeing)]
    assert error[1] < 0.005 < 0.02 < error[0]
    at_rest = response.color_from_gradients(
        np.zeros((5, 2)), np.arange(5), np.arange(5), depth_mm=np.zeros(5)
    )
    np.testing.assert_array_equal(at_rest, 0)


def test_the_slopes_part_does_not_depend_on_the_depths():
    samples = ball_samples(shading_change)
    plain = ForwardResponse.fit(samples)
    both = ForwardResponse.fit(samples, depth_mm=np.ones(len(samples.x_px)))
    at = samples.gradients, samples.x_px, samples.y_px
    np.testing.assert_array_equal(plain.color_from_gradients(*at), both.color_from_gradients(*at))
    assert not plain.knows_depth
    with pytest.raises(ValueError, match="fitted without"):
        plain.color_from_gradients(*at, depth_mm=np.ones(len(samples.x_px)))
