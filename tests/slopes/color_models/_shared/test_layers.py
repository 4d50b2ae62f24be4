"""Small networks: the kernel is the network in plain numpy, layers that do not fit are refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelform.slopes.color_models._shared.layers import BLOCK_PX, Layers, RestedNetwork, blocks_of
from made.networks import in_numpy, layers_of


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
        ((np.where(np.eye(8, 5) > 0, np.nan, good.weights[0]), good.weights[1]), good.biases),
        ((np.zeros((5000, 5)),), (np.zeros(5000),)),
        ((np.zeros(5),), (np.zeros(5),)),
        ((), ()),
    ):
        with pytest.raises(ValueError, match="Expected"):
            Layers(weights, biases)


def test_saved_arrays_give_the_same_layers():
    layers = layers_of((5, 7, 6, 2))
    again = Layers.from_arrays({**layers.to_arrays(), "background": np.zeros(3)})
    for mine, theirs in zip((*layers.weights, *layers.biases), (*again.weights, *again.biases)):
        np.testing.assert_array_equal(mine, theirs)


@settings(deadline=None)
@given(st.integers(0, 50_000), st.integers(1, 20_000))
def test_they_cover_all_rows_once(count, each_px):
    blocks = list(blocks_of(count, each_px))
    assert [row for block in blocks for row in range(block.start, block.stop)] == list(range(count))
    assert all(each_px * (b.stop - b.start) <= max(BLOCK_PX, each_px) for b in blocks)
