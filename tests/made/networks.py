"""Small random networks, in plain numpy too, and files as torch.save writes them, made by hand: torch is not needed."""

import struct
import zipfile
from itertools import pairwise

import numpy as np

from gelform.color_models._shared.layers import Layers

TENSOR = b"ctorch._utils\n_rebuild_tensor_v2\n"
ORDERED = b"ccollections\nOrderedDict\n"


def text(value):
    return b"X" + struct.pack("<I", len(value)) + value.encode()


def integer(value):
    return b"J" + struct.pack("<i", value)


def integers(values):
    return b"(" + b"".join(map(integer, values)) + b"t"


def pickled_tensor(key, array, *, storage="FloatStorage", stride=None, size=None, offset=0):
    stride = [s // array.itemsize for s in array.strides] if stride is None else stride
    reference = (
        b"("
        + text("storage")
        + f"ctorch\n{storage}\n".encode()
        + text(key)
        + text("cpu")
        + integer(array.size)
    )
    shape = integers(array.shape if size is None else size)
    return (
        TENSOR
        + (b"(" + reference + b"tQ" + integer(offset) + shape + integers(stride) + b"\x89")
        + (ORDERED + b")R" + b"tR")
    )


def pickled_dict(items):
    """An OrderedDict of (name, pickled value), with the `_metadata` that torch gives it."""
    body = b"".join(text(name) + value for name, value in items)
    return ORDERED + b")R(" + body + b"u" + b"}" + text("_metadata") + ORDERED + b")Rs" + b"b"


def torch_file(path, arrays, *, pickle=None, nested=False, folder="net"):
    """A zip with data.pkl and one member of numbers for each array."""
    content = pickle or pickled_dict(
        [(n, pickled_tensor(str(k), a)) for k, (n, a) in enumerate(arrays.items())]
    )
    if nested:
        content = b"}" + text("state_dict") + content + b"s"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(f"{folder}/data.pkl", b"\x80\x02" + content + b".")
        archive.writestr(f"{folder}/byteorder", "little")
        for k, array in enumerate(arrays.values()):
            archive.writestr(f"{folder}/data/{k}", np.ascontiguousarray(array).tobytes())
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
