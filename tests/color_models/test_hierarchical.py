"""Hierarchical polynomial: exact where it can be, simple where nothing is known, the light as a clue."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.color_models import HierarchicalModel, PolynomialModel
from made.color_samples import SHAPE, ball_samples, lambertian_change, shading_change


def rms(model, samples):
    found = model.gradients_at(samples.color_change, samples.x_px, samples.y_px)
    return np.sqrt(np.mean((found - samples.gradients) ** 2))


def at_few_places(samples, count=6, seed=0):
    """The samples within 6 px of a few places, as few presses give."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(5, SHAPE[1] - 5, count), rng.uniform(5, SHAPE[0] - 5, count)
    near = (np.hypot(samples.x_px[:, None] - x, samples.y_px[:, None] - y) < 6).any(axis=1)
    parts = ("color_change", "x_px", "y_px", "gradients", "weight")
    return replace(samples, **{part: getattr(samples, part)[near] for part in parts})


def test_it_follows_lights_that_turn_over_the_image():
    model = HierarchicalModel.fit(ball_samples(shading_change), ridge=1e-6)
    assert rms(model, ball_samples(shading_change, seed=4)) < 0.03


def test_few_presses_leave_less_error_elsewhere_than_in_a_free_polynomial():
    few = at_few_places(ball_samples(shading_change, count=8000))
    noise = 0.02 * np.random.default_rng(1).normal(size=few.color_change.shape)
    few = replace(few, color_change=few.color_change + noise)
    unseen = ball_samples(shading_change, seed=5)
    free = PolynomialModel.fit(few, position_degrees=(5, 4, 3))
    assert rms(HierarchicalModel.fit(few), unseen) < 0.5 * rms(free, unseen)


def test_the_light_tells_what_the_place_does_not():
    """Colour that weakens with the light, unlike any polynomial of the place: stripes."""
    stripes = 1 + 0.6 * np.sign(np.sin(np.arange(SHAPE[1]) / 6.0))
    background = np.broadcast_to(80 * stripes[None, :, None], (*SHAPE, 3)).astype(np.float32)
    wide = (96, 128)
    background = np.kron(background, np.ones((2, 2, 1))).astype(np.float32)[: wide[0], : wide[1]]
    import cv2

    smooth = cv2.GaussianBlur(background, (0, 0), 8.0)[48, :, 0]

    def change(gradients, x, y):
        light = np.log(smooth[np.clip(2 * x, 0, wide[1] - 1).astype(int)])
        return (
            gradients
            @ np.array([[1.0, 0.2, -0.7], [0.1, 0.9, 0.8]])
            / (1 + 0.3 * light[:, None] / light.mean())
        )

    samples, unseen = (ball_samples(change, seed=s) for s in (0, 6))
    samples, unseen = (replace(s, x_px=2 * s.x_px, y_px=2 * s.y_px, shape=wide) for s in (samples, unseen))
    settings = {"position_degrees": (1,), "ridge": 1e-6}
    without = rms(HierarchicalModel.fit(samples, **settings), unseen)
    known = rms(HierarchicalModel.fit(replace(samples, background=background), **settings), unseen)
    assert known < 0.6 * without


def test_more_ridge_is_less_slope():
    samples = ball_samples(lambertian_change)
    sizes = [
        np.abs(
            HierarchicalModel.fit(samples, ridge=ridge).gradients_at(
                samples.color_change, samples.x_px, samples.y_px
            )
        ).mean()
        for ridge in (1e-6, 1e-1, 1e3)
    ]
    assert sizes[0] > sizes[1] > sizes[2]
    assert sizes[2] < 0.01


def test_bad_settings_and_other_sizes_are_refused():
    samples = ball_samples(lambertian_change)
    with pytest.raises(ValueError, match="ridge > 0"):
        HierarchicalModel.fit(samples, ridge=0)
    with pytest.raises(ValueError, match="as calibrated, got 10x10"):
        HierarchicalModel.fit(samples).prepare(np.zeros((10, 10, 3)), (10, 10))
