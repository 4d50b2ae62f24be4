"""Tensors in a pickle: what a state dict needs, and nothing that takes memory, time or code of a file's choice."""

import tracemalloc

import numpy as np
import pytest

import gelform
from gelform.exchange.importers.networks import read_gs_sdk
from gelform.exchange.importers.tensors import TensorReader
from made.networks import pickle_file, tensor

BACKGROUND = np.full((12, 16, 3), 90, np.float32)


def read(path):
    return read_gs_sdk(path, BACKGROUND)


def test_a_view_has_the_numbers_of_its_storage():
    numbers = np.arange(12, dtype="<f4")
    content = b"\x80\x02" + tensor(0, (2, 3), (1, 4), 1) + b"."
    found = TensorReader(content, {"0": numbers.tobytes()}).load()
    np.testing.assert_array_equal(found, [[1, 5, 9], [2, 6, 10]])
    with pytest.raises(ValueError, match="read-only"):
        found[0, 0] = 1


NESTED = b"".join(b"h" + bytes([k]) + b"h" + bytes([k]) + b"\x86q" + bytes([k + 1]) for k in range(200))
FEW = np.zeros(4, np.float32)
BOMBS = {
    "a view beyond its storage": b"}(X\x01\0\0\0a" + tensor(0, (40_000, 40_000), (40_000, 1)) + b"u",
    "a start beyond it": b"}(X\x01\0\0\0a" + tensor(0, (2,), (1,), 3) + b"u",
    "a negative start": b"}(X\x01\0\0\0a" + tensor(0, (2,), (1,), -3) + b"u",
    "a key that takes for ever to hash": b"}(K\x01q\0" + NESTED + b"K\x01u",
    "the same, one by one": b"}K\x01q\0" + NESTED + b"K\x01s",
    "the same, at once": b"(K\x01q\0" + NESTED + b"K\x01d",
    "an ordered dict of them": b"ccollections\nOrderedDict\n(K\x01q\0" + NESTED + b"tR",
    "bytes without end": b"c__builtin__\nbytearray\n(\x8a\x05\xff\xff\xff\xff\0tR",
}


@pytest.mark.parametrize("name", BOMBS)
def test_pickles_that_would_take_all_memory_or_time_are_refused(tmp_path, name):
    tracemalloc.start()
    with pytest.raises(gelform.DataError, match=r"holds more than tensors in dicts"):
        read(pickle_file(tmp_path / "net.pth", BOMBS[name], [FEW]))
    assert tracemalloc.get_traced_memory()[1] < 10e6
    tracemalloc.stop()


def test_a_memo_far_away_and_a_repeated_storage_cost_nothing(tmp_path):
    """Half of all memory for an index, a storage read again for every tensor: neither is taken."""
    far = b"K\x01r\xff\xff\xff\x7f0"
    again = tensor(0, (4,), (1,)) + b"q\x000" + b"h\x000" * 100_000
    wide = b"}(X\x0a\0\0\0fc1.weight" + tensor(0, (4, 4, 4, 4), (0, 0, 0, 0)) + b"u"
    tracemalloc.start()
    with pytest.raises(gelform.DataError, match="Expected the layers fc1 to fc4"):
        read(pickle_file(tmp_path / "net.pth", far + again + wide, [FEW]))
    assert tracemalloc.get_traced_memory()[1] < 10e6
    tracemalloc.stop()
