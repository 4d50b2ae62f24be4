"""The forward response: colours predicted from slopes, and what depth adds."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.color_models._shared.forward import ForwardResponse
from gelform.color_models._shared.least_squares import unit_position
from made.color_samples import SHAPE, ball_samples, shading_change


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


def test_a_law_of_its_own_form_comes_back_with_its_noise():
    """Slopes to the third power whose effect changes over the image, and light that grows with depth."""
    samples = ball_samples(shading_change, count=8000)
    p, q = samples.gradients.T
    x, y = unit_position(samples.x_px, samples.y_px, SHAPE)
    depth = np.random.default_rng(9).uniform(0, 1, len(x))
    law = np.stack([0.3 * p * x**3 + 0.2 * q, 0.4 * p * q * y**2, 0.5 * p**3 * x + 0.1 * q**3], axis=1)
    noise = np.array([0.02, 0.01, 0.03]) * np.random.default_rng(3).normal(size=law.shape)
    found = ForwardResponse.fit(replace(samples, color_change=law + noise))
    np.testing.assert_allclose(found.noise, [0.02, 0.01, 0.03], rtol=0.05)
    at = samples.gradients, samples.x_px, samples.y_px
    assert np.sqrt(np.mean((found.color_from_gradients(*at) - law) ** 2)) < 0.002
    by_depth = (depth * (x**3 - 0.5 * y**3))[:, None] * np.array([0.3, 0.2, 0.1])
    seeing = ForwardResponse.fit(replace(samples, color_change=by_depth), depth_mm=depth)
    np.testing.assert_allclose(seeing.color_from_gradients(*at, depth_mm=depth), by_depth, atol=0.002)
