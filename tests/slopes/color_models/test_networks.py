"""Small networks: the kernel is the network in plain numpy, layers that do not fit are refused. An imported network:
what it is fed, how its answer is read, and that no change is no slope. The mlp: a network in plain numpy agrees,
training is repeatable, learns and heeds weights, torch is asked for by name.
"""

import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import gelform
from gelform.slopes.color_models import MlpModel
from gelform.slopes.color_models.networks import BLOCK_PX, Layers, NetworkModel, PreparedNetwork, blocks_of
from gelform.slopes.color_models.seam import unit_position
from made.files import in_numpy, layers_of
from made.images import SHAPE as SHAPE_MLP
from made.images import ball_samples, shading_change


@pytest.mark.parametrize("sizes", [(5, 2), (5, 7, 2), (3, 32, 32, 2), (6, 3, 17, 5), (5, 64, 64, 64, 2)])
@pytest.mark.parametrize("count", [1, 319, 320, 1000])
def test_the_kernel_is_the_network(sizes, count):
    layers, rng = layers_of(sizes), np.random.default_rng(1)
    rest, change = rng.normal(size=(count, sizes[0])), rng.normal(size=(count, 3))
    scale, channels = np.array([2.0, 3.0, 0.5]), (2, 0, 1)
    inputs = rest.copy()
    inputs[:, :3] += scale * change[:, channels]
    network = PreparedNetwork(layers, rest.T.astype(np.float32), channels, scale)
    found = network.outputs_from_color(change.astype(np.float32))
    np.testing.assert_allclose(found, in_numpy(layers, inputs), atol=2e-5)


def test_layers_that_do_not_fit_are_refused():
    good = layers_of((5, 8, 2))
    for weights, biases in (
        (good.weights[:1], good.biases),
        (good.weights[::-1], good.biases[::-1]),
        ((good.weights[0].T, good.weights[1]), good.biases),
        ((np.where(np.eye(8, 5) > 0, np.nan, good.weights[0]), good.weights[1]), good.biases),
        ((np.zeros((5000, 5)),), (np.zeros(5000),)),
        ((np.zeros(5),), (np.zeros(5),)),
        ((), ()),
    ):
        with pytest.raises(ValueError, match="Expected"):
            Layers(weights, biases)


@settings(deadline=None)
@given(st.integers(0, 50_000), st.integers(1, 20_000))
def test_they_cover_all_rows_once(count, each_px):
    blocks = list(blocks_of(count, each_px))
    assert [row for block in blocks for row in range(block.start, block.stop)] == list(range(count))
    assert all(each_px * (b.stop - b.start) <= max(BLOCK_PX, each_px) for b in blocks)


SHAPE = (6, 8)
BACKGROUND = np.random.default_rng(0).uniform(60, 160, (*SHAPE, 3)).astype(np.float32)


def linear(weight):
    """A network of one layer: its outputs are weight @ inputs."""
    return Layers((np.asarray(weight, dtype=np.float32),), (np.zeros(2, dtype=np.float32),))


def model(weight, position="xy", answer="angles"):
    return NetworkModel(linear(weight), BACKGROUND, position, answer)


def gradients(one, change):
    return one.prepare(BACKGROUND, SHAPE).gradients_from_color(change.astype(np.float32))[0]


READ = {
    "angles": lambda found: -np.tan(found),
    "normals": lambda found: -found / np.sqrt(1 - np.sum(found**2, axis=-1, keepdims=True)),
}


@pytest.mark.parametrize("answer", READ)
@pytest.mark.parametrize(("position", "place"), [("xy", (1, 2)), ("yx", (2, 1)), ("zeros", (0, 0))])
def test_it_is_fed_blue_green_red_and_the_place(position, place, answer):
    """Its answer, read as an angle or as a normal that points along it, worked out from image and place."""
    weight = 0.8 * np.array([[0.3, 0.5, -0.4, 0.6, -0.7], [0.2, -0.3, 0.1, 0.4, 0.5]])
    change = np.random.default_rng(6).uniform(-0.2, 0.2, (*SHAPE, 3))
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    both = [np.zeros(SHAPE), x / SHAPE[1], y / SHAPE[0]]
    fed = [*np.moveaxis(BACKGROUND[..., ::-1] / 255, -1, 0), *(both[k] for k in place)]
    rest, touched = np.stack(fed, axis=-1), np.stack(fed, axis=-1)
    touched[..., :3] += change[..., ::-1]
    expected = READ[answer](touched @ weight.T) - READ[answer](rest @ weight.T)
    np.testing.assert_allclose(gradients(model(weight, position, answer), change), expected, atol=1e-5)


@pytest.mark.parametrize(("position", "answer"), [("xy", "angles"), ("yx", "normals"), ("zeros", "angles")])
def test_scattered_pixels_and_the_file_of_it_answer_as_the_frame_does(position, answer):
    one = NetworkModel(layers_of((5, 7, 6, 2)), BACKGROUND, position, answer)
    change = np.random.default_rng(3).normal(0, 0.1, (*SHAPE, 3)).astype(np.float32)
    rows, columns = np.array([0, 2, 5]), np.array([7, 1, 3])
    found = one.gradients_at(change[rows, columns], columns, rows)
    np.testing.assert_allclose(found, gradients(one, change)[rows, columns], atol=1e-6)
    again = NetworkModel.from_arrays(*one.to_arrays())
    np.testing.assert_array_equal(gradients(one, change), gradients(again, change))


def test_what_it_is_not_is_refused():
    with pytest.raises(ValueError, match="5 inputs and 2 outputs, got 3 and 2"):
        model(np.zeros((2, 3)))
    with pytest.raises(ValueError, match="Expected position"):
        model(np.zeros((2, 5)), "there")
    with pytest.raises(ValueError, match="6x8"):
        model(np.zeros((2, 5))).prepare(np.zeros((4, 4, 3)), (4, 4))


def test_rest_is_zero_everywhere_and_the_place_counts():
    model = MlpModel(layers_of((5, 16, 2)), np.array([0.1, 0.2, 0.3]), SHAPE_MLP)
    prepared = model.prepare(np.zeros((*SHAPE_MLP, 3)), SHAPE_MLP)
    assert np.abs(prepared.gradients_from_color(np.zeros((*SHAPE_MLP, 3), np.float32))[0]).max() == 0
    change, x, y = np.array([[0.1, -0.2, 0.3]] * 2), np.array([3.0, 50.0]), np.array([40.0, 5.0])
    place = np.stack(unit_position(x, y, SHAPE_MLP), -1)
    touched = in_numpy(model.layers, np.concatenate([change / model.change_scale, place], 1))
    rest = in_numpy(model.layers, np.concatenate([0 * change, place], 1))
    np.testing.assert_allclose(model.gradients_at(change, x, y), touched - rest, atol=1e-5)
    with pytest.raises(ValueError, match="5 inputs and 2 outputs"):
        MlpModel(layers_of((4, 8, 2)), np.ones(3), SHAPE_MLP)


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
    spoilt = type(samples)(samples.color_change, samples.x_px, samples.y_px, turned, weight, SHAPE_MLP)
    found = MlpModel.fit(spoilt, steps=300).gradients_at(samples.color_change, samples.x_px, samples.y_px)
    assert np.sqrt(np.mean((found - samples.gradients) ** 2)) < 0.05
    with pytest.raises(ValueError, match="Expected hidden layers, steps and samples"):
        MlpModel.fit(samples, steps=0)


def test_without_torch_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(gelform.GelformError, match=r"gelform\[torch\]"):
        MlpModel.fit(ball_samples(shading_change, count=100))
