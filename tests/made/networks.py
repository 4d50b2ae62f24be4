"""Small random networks, in plain numpy too, and files of them."""

from itertools import pairwise

import numpy as np
import pytest

from gelform.slopes.color_models._shared.layers import Layers


def torch_file(path, arrays, *, nested=False):
    """A file of `torch.save`; the test is skipped without torch."""
    torch = pytest.importorskip("torch", reason="torch, the extra `torch`, is not installed")
    content = {name: torch.from_numpy(np.array(array)) for name, array in arrays.items()}
    torch.save({"epoch": 3, "state_dict": content} if nested else content, path)
    return path


def web_file(path, arrays=None):
    """A network of gsrobotics as its browser port has it, which needs no torch; random by default."""
    arrays = network_arrays((5, 64, 64, 64, 2)) if arrays is None else arrays
    np.concatenate([array.ravel() for array in arrays.values()]).astype("<f4").tofile(path)
    return path


def network_arrays(sizes, seed=0):
    """fc1.weight, fc1.bias, ... of random layers."""
    rng = np.random.default_rng(seed)
    arrays = {}
    for k, (n_in, n_out) in enumerate(pairwise(sizes), start=1):
        arrays[f"fc{k}.weight"] = rng.normal(0, n_in**-0.5, (n_out, n_in)).astype(np.float32)
        arrays[f"fc{k}.bias"] = rng.normal(0, 0.1, n_out).astype(np.float32)
    return arrays


def layers_of(sizes, seed=0):
    arrays = list(network_arrays(sizes, seed).values())
    return Layers(tuple(arrays[::2]), tuple(arrays[1::2]))


def in_numpy(layers, values):
    for k, (weight, bias) in enumerate(zip(layers.weights, layers.biases)):
        values = values @ weight.T.astype(float) + bias
        values = np.maximum(values, 0) if k + 1 < len(layers.weights) else values
    return values
