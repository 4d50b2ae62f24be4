"""The mlp: a network in plain numpy agrees, training is repeatable and learns, torch is asked for by name."""

import sys

import numpy as np
import pytest

import gelform
from gelform.color_models import MlpModel
from gelform.color_models._shared.layers import Layers, RestedNetwork
from gelform.color_models._shared.least_squares import unit_position
from made.color_samples import SHAPE, ball_samples, shading_change
from made.torch_file_writer import network_arrays


def layers_of(sizes, seed=0):
    arrays = list(network_arrays(sizes, seed).values())
    return Layers(tuple(arrays[::2]), tuple(arrays[1::2]))


def in_numpy(layers, values):
    for k, (weight, bias) in enumerate(zip(layers.weights, layers.biases)):
        values = values @ weight.T.astype(float) + bias
        values = np.maximum(values, 0) if k + 1 < len(layers.weights) else values
    return values


@pytest.mark.parametrize("sizes", [(5, 2), (5, 7, 2), (3, 32, 32, 2), (6, 3, 17, 5), (5, 64, 64, 64, 2)])
@pytest.mark.parametrize("count", [1, 319, 320, 1000])
def test_the_kernel_is_the_network(sizes, count):
    layers, rng = layers_of(sizes), np.random.default_rng(1)
    rest, change = rng.normal(size=(count, sizes[0])), rng.normal(size=(count, 3))
    scale, channels = np.array([2.0, 3.0, 0.5]), (2, 0, 1)
    inputs = rest.copy()
    inputs[:, :3] += scale * change[:, channels]
    network = RestedNetwork(layers, rest.T.astype(np.float32), channels, scale)
    found = network.outputs_from_color(change.astype(np.float32))
    np.testing.assert_allclose(found, in_numpy(layers, inputs), atol=2e-5)


def test_layers_that_do_not_fit_are_refused():
    good = layers_of((5, 8, 2))
    for weights, biases in (
        (good.weights[:1], good.biases),
        (good.weights[::-1], good.biases[::-1]),
        ((good.weights[0].T, good.weights[1]), good.biases),
        ((good.weights[0] * np.nan, good.weights[1]), good.biases),
        ((), ()),
    ):
        with pytest.raises(ValueError, match="Expected"):
            Layers(weights, biases)
    with pytest.raises(ValueError, match="5 inputs and 2 outputs"):
        MlpModel(layers_of((4, 8, 2)), np.ones(3), SHAPE)


def test_rest_is_zero_everywhere_and_the_place_counts():
    model = MlpModel(layers_of((5, 16, 2)), np.array([0.1, 0.2, 0.3]), SHAPE)
    prepared = model.prepare(np.zeros((*SHAPE, 3)), SHAPE)
    assert np.abs(prepared.gradients_from_color(np.zeros((*SHAPE, 3), np.float32))[0]).max() == 0
    change, x, y = np.array([[0.1, -0.2, 0.3]] * 2), np.array([3.0, 50.0]), np.array([40.0, 5.0])
    place = np.stack(unit_position(x, y, SHAPE), -1)
    touched = in_numpy(model.layers, np.concatenate([change / model.change_scale, place], 1))
    rest = in_numpy(model.layers, np.concatenate([0 * change, place], 1))
    np.testing.assert_allclose(model.gradients_at(change, x, y), touched - rest, atol=1e-5)
    with pytest.raises(ValueError, match="as calibrated, got 10x10"):
        model.prepare(np.zeros((10, 10, 3)), (10, 10))


def test_training_learns_lights_that_turn_and_repeats_itself():
    pytest.importorskip("torch", reason="torch, the extra `torch`, is not installed")
    samples, unseen = ball_samples(shading_change), ball_samples(shading_change, seed=4)
    models = [MlpModel.fit(samples, steps=250, seed=seed) for seed in (0, 0, 1)]
    found = [m.gradients_at(unseen.color_change, unseen.x_px, unseen.y_px) for m in models]
    assert np.sqrt(np.mean((found[0] - unseen.gradients) ** 2)) < 0.03
    np.testing.assert_array_equal(found[0], found[1])
    assert np.abs(found[0] - found[2]).max() > 1e-4


def test_weights_count_in_training():
    pytest.importorskip("torch", reason="torch, the extra `torch`, is not installed")
    samples = ball_samples(shading_change, count=2000)
    turned = samples.gradients * np.where(np.arange(2000) % 2, -1, 1)[:, None]
    weight = (np.arange(2000) % 2 == 0).astype(float)
    spoilt = type(samples)(samples.color_change, samples.x_px, samples.y_px, turned, weight, SHAPE)
    found = MlpModel.fit(spoilt, steps=300).gradients_at(samples.color_change, samples.x_px, samples.y_px)
    assert np.sqrt(np.mean((found - samples.gradients) ** 2)) < 0.05


def test_without_torch_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(gelform.GelformError, match=r"gelform\[torch\]"):
        MlpModel.fit(ball_samples(shading_change, count=100))


def test_nothing_to_train_on_is_refused():
    pytest.importorskip("torch", reason="torch, the extra `torch`, is not installed")
    with pytest.raises(ValueError, match="Expected hidden layers, steps and samples"):
        MlpModel.fit(ball_samples(shading_change, count=100), steps=0)
