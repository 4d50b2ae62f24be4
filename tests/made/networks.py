"""Random small networks, and the same in plain numpy."""

import numpy as np

from gelform.color_models._shared.layers import Layers
from made.torch_file_writer import network_arrays


def layers_of(sizes, seed=0):
    arrays = list(network_arrays(sizes, seed).values())
    return Layers(tuple(arrays[::2]), tuple(arrays[1::2]))


def in_numpy(layers, values):
    for k, (weight, bias) in enumerate(zip(layers.weights, layers.biases)):
        values = values @ weight.T.astype(float) + bias
        values = np.maximum(values, 0) if k + 1 < len(layers.weights) else values
    return values
