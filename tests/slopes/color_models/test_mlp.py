"""The mlp: a network in plain numpy agrees, training is repeatable and learns, torch is asked for by name."""

import sys

import numpy as np
import pytest

import gelform
from gelform.slopes.color_models import MlpModel
from gelform.slopes.color_models._shared.least_squares import unit_position
from made.color_samples import SHAPE, ball_samples, shading_change
from made.networks import in_numpy, layers_of


def test_rest_is_zero_everywhere_and_the_place_counts():
    model = MlpModel(layers_of((5, 16, 2)), np.array([0.1, 0.2, 0.3]), SHAPE)
    prepared = model.prepare(np.zeros((*SHAPE, 3)), SHAPE)
    assert np.abs(prepared.gradients_from_color(np.zeros((*SHAPE, 3), np.float32))[0]).max() == 0
    change, x, y = np.array([[0.1, -0.2, 0.3]] * 2), np.array([3.0, 50.0]), np.array([40.0, 5.0])
    place = np.stack(unit_position(x, y, SHAPE), -1)
    touched = in_numpy(model.layers, np.concatenate([change / model.change_scale, place], 1))
    rest = in_numpy(model.layers, np.concatenate([0 * change, place], 1))
    np.testing.assert_allclose(model.gradients_at(change, x, y), touched - rest, atol=1e-5)
    with pytest.raises(ValueError, match="5 inputs and 2 outputs"):
        MlpModel(layers_of((4, 8, 2)), np.ones(3), SHAPE)


def test_training_learns_lights_that_turn_and_repeats_itself():
    pytest.importorskip("torch", reason="torch, the extra `torch`, is not installed")
    samples, unseen = ball_samples(shading_change), ball_samples(shading_change, seed=4)
    models = [MlpModel.fit(samples, steps=250, seed=seed) for seed in (0, 0, 1)]
    found = [m.gradients_at(unseen.color_change, unseen.x_px, unseen.y_px) for m in models]
    assert np.sqrt(np.mean((found[0] - unseen.gradients) ** 2)) < 0.03
    np.testing.assert_array_equal(found[0], found[1])
    assert np.abs(found[0] - found[2]).max() > 1e-4


def test_without_torch_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(gelform.GelformError, match=r"gelform\[torch\]"):
        MlpModel.fit(ball_samples(shading_change, count=100))
