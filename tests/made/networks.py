"""Small random networks, in plain numpy too, and files of them."""

import struct
from itertools import pairwise
from zipfile import ZipFile

import numpy as np

from gelform.slopes.color_models._shared.layers import Layers


def torch_file(path, arrays, *, nested=False):
    """A file as `torch.save` writes it, without torch."""
    items = b"".join(
        _text(name) + tensor(k, np.shape(array), strides_of(array))
        for k, (name, array) in enumerate(arrays.items())
    )
    content = b"}(" + items + b"u"
    if nested:
        content = b"}(" + _text("epoch") + b"K\x03" + _text("state_dict") + content + b"u"
    return pickle_file(path, content, [np.asarray(array, "<f4") for array in arrays.values()])


def pickle_file(path, content, storages):
    """A zip as `torch.save` writes it, with a pickle of one's own between its first and its last operation."""
    with ZipFile(path, "w") as archive:
        archive.writestr("net/data.pkl", b"\x80\x02" + content + b".")
        archive.writestr("net/byteorder", b"little")
        for k, storage in enumerate(storages):
            archive.writestr(f"net/data/{k}", storage.tobytes())
    return path


def strides_of(array):
    """Numbers between neighbors along each axis, as torch counts strides."""
    return [int(np.prod(np.shape(array)[k + 1 :])) for k in range(np.ndim(array))]


def tensor(storage, shape, strides, start=0):
    """The operations of a pickle that make a tensor of a storage."""
    pid = (
        b"("
        + _text("storage")
        + b"ctorch\nFloatStorage\n"
        + _text(str(storage))
        + _text("cpu")
        + _int(1)
        + b"tQ"
    )
    places = _int(start) + b"".join(b"(" + b"".join(map(_int, one)) + b"t" for one in (shape, strides))
    return b"ctorch._utils\n_rebuild_tensor_v2\n(" + pid + places + b"\x89ccollections\nOrderedDict\n)RtR"


def _int(number):
    code = number.to_bytes(number.bit_length() // 8 + 1, "little", signed=True)
    return b"\x8a" + bytes([len(code)]) + code


def _text(text):
    return b"X" + struct.pack("<I", len(text)) + text.encode()


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
