"""Interpolation: exact on a line, close on shading, and it knows when it is far from its samples."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.slopes.color_models import InterpolationModel
from made.color_samples import ball_samples, shading_change

pytestmark = pytest.mark.linear_algebra

MATRIX = np.array([[1.0, 0.2, -0.7], [0.1, 0.9, 0.8]])


def at(model, samples):
    return model.gradients_at(samples.color_change, samples.x_px, samples.y_px)


def test_a_line_is_exact():
    model = InterpolationModel.fit(ball_samples(lambda g, x, y: g @ MATRIX))
    unseen = ball_samples(lambda g, x, y: g @ MATRIX, seed=1, count=500)
    np.testing.assert_allclose(at(model, unseen), unseen.gradients, atol=2e-3)


def test_shading_that_turns_over_the_image_is_followed():
    model = InterpolationModel.fit(ball_samples(shading_change))
    unseen = ball_samples(shading_change, seed=1, count=500)
    error = np.median(np.linalg.norm(at(model, unseen) - unseen.gradients, axis=1))
    line = np.median(np.linalg.norm(unseen.color_change @ model.line - unseen.gradients, axis=1))
    assert error < 0.03
    assert error < 0.4 * line


def test_far_from_the_samples_the_slope_is_doubted():
    model = InterpolationModel.fit(ball_samples(shading_change))
    seen = ball_samples(shading_change, seed=2, count=300)
    _, inside = model.gradients_and_sigma_at(seen.color_change, seen.x_px, seen.y_px)
    _, outside = model.gradients_and_sigma_at(5 * seen.color_change + 1, seen.x_px, seen.y_px)
    assert np.median(outside) > 10 * np.median(inside)
    assert inside.min() >= 0


def test_bad_settings_are_refused():
    samples = ball_samples(shading_change)
    with pytest.raises(ValueError, match="points >= 16"):
        InterpolationModel.fit(samples, points=3)
    with pytest.raises(ValueError, match="place_scale > 0"):
        InterpolationModel.fit(samples, place_scale=0.0)


def test_gray_levels_of_another_size_give_the_same_slopes():
    """How near a sample is in color is judged by the samples' own range."""
    samples, unseen = ball_samples(shading_change), ball_samples(shading_change, seed=1, count=300)
    wider = replace(samples, color_change=8 * samples.color_change)
    found = InterpolationModel.fit(wider, points=500).gradients_at(
        8 * unseen.color_change, unseen.x_px, unseen.y_px
    )
    np.testing.assert_allclose(found, at(InterpolationModel.fit(samples, points=500), unseen), atol=1e-6)


def test_what_the_neighbors_do_not_say_is_taken_from_all():
    """All colors near one place along red: how slopes go with blue there, the others tell."""
    samples = ball_samples(lambda g, x, y: g @ MATRIX)
    model = InterpolationModel.fit(samples)
    blue = np.array([[0.0, 0.0, 0.3]] * 200)
    rng = np.random.default_rng(0)
    found = model.gradients_at(blue, rng.uniform(0, 63, 200), rng.uniform(0, 47, 200))
    np.testing.assert_allclose(found, blue @ model.line, atol=0.02)
