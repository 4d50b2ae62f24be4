"""Weights files: the same numbers as torch's, nothing executed, everything except a dict of tensors refused."""

import pickle
import zipfile

import numpy as np
import pytest

import gelform
from gelform.importers.torch_files import MAX_PICKLE_BYTES, read_tensors
from made.networks import ORDERED, network_arrays, pickled_dict, pickled_tensor, text, torch_file

ARRAYS = network_arrays((5, 8, 2))


def test_tensors_come_back_by_name_and_by_their_strides(tmp_path):
    for nested in (False, True):
        found = read_tensors(torch_file(tmp_path / "net.pth", ARRAYS, nested=nested))
        assert list(found) == [f"{'state_dict.' if nested else ''}{name}" for name in ARRAYS]
        for array, wanted in zip(found.values(), ARRAYS.values()):
            np.testing.assert_array_equal(array, wanted)
    stored = np.arange(6, dtype=np.float32).reshape(2, 3)
    content = pickled_dict([("w", pickled_tensor("0", stored, size=(3, 2), stride=(1, 3)))])
    found = read_tensors(torch_file(tmp_path / "net.pth", {"w": stored}, pickle=content))
    np.testing.assert_array_equal(found["w"], stored.T)


def test_what_torch_writes_is_read(tmp_path):
    torch = pytest.importorskip("torch", reason="torch, the extra `torch`, is not installed")
    net = torch.nn.Sequential(torch.nn.Linear(5, 4), torch.nn.Linear(4, 2).double())
    torch.save({"epoch": 3, "state_dict": net.state_dict()}, tmp_path / "net.pt")
    found = read_tensors(tmp_path / "net.pt")
    assert len(found) == 4
    for name, tensor in net.state_dict().items():
        np.testing.assert_array_equal(found[f"state_dict.{name}"], tensor.numpy())
    torch.save(net, tmp_path / "module.pt")
    with pytest.raises(gelform.DataError, match=r"names torch\.nn\.modules.*could run code"):
        read_tensors(tmp_path / "module.pt")
    torch.save(net.state_dict(), tmp_path / "old.pth", _use_new_zipfile_serialization=False)
    with pytest.raises(gelform.DataError, match=r"before version 1.6.*save it again"):
        read_tensors(tmp_path / "old.pth")


class Bomb:
    def __init__(self, made):
        self.made = made

    def __reduce__(self):
        return open, (str(self.made), "w")


def test_a_pickled_object_is_refused_and_nothing_runs(tmp_path):
    made = tmp_path / "made"
    for protocol in (0, 2, 4):
        with zipfile.ZipFile(tmp_path / "bomb.ckpt", "w") as archive:
            archive.writestr("archive/data.pkl", pickle.dumps(Bomb(made), protocol=protocol))
        with pytest.raises(gelform.DataError, match=r"refused|could run code"):
            read_tensors(tmp_path / "bomb.ckpt")
        (tmp_path / "raw.ckpt").write_bytes(pickle.dumps(Bomb(made), protocol=protocol))
        with pytest.raises(gelform.DataError):
            read_tensors(tmp_path / "raw.ckpt")
    assert not made.exists()


def test_a_tensor_outside_its_storage_is_refused(tmp_path):
    for size, stride, offset in (
        ((3, 3), (3, 1), 0),
        ((2, 3), (3, 1), 1),
        ((2, 3), (3, 1), -1),
        ((2**30,), (0,), 0),
        ((2, 3), (-3, 1), 3),
    ):
        stored = np.zeros((2, 3), dtype=np.float32)
        content = pickled_dict([("w", pickled_tensor("0", stored, size=size, stride=stride, offset=offset))])
        with pytest.raises(gelform.DataError, match="damaged"):
            read_tensors(torch_file(tmp_path / "net.pth", {"w": stored}, pickle=content))


def test_a_damaged_description_is_refused(tmp_path):
    empty, odd = (b"(", b"]", b"\x88R", b"h\x07"), (b"X\xff\xff\xff\x7f", ORDERED)
    for content in (*empty, *odd, text("a") + b"b", b"}(" + text("a") + b"u"):
        with pytest.raises(gelform.DataError):
            read_tensors(torch_file(tmp_path / "net.pth", {}, pickle=content))


def test_sizes_are_checked_before_reading(tmp_path):
    path = tmp_path / "bomb.pth"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a/data.pkl", b"\x80\x02}.")
        archive.writestr("a/data/0", bytes(65 * 2**20))
    assert path.stat().st_size < 2**20
    with pytest.raises(gelform.DataError, match=r"declares 68\.2 MB"):
        read_tensors(path)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a/data.pkl", bytes(MAX_PICKLE_BYTES + 1))
    with pytest.raises(gelform.DataError, match="more than 1 MB"):
        read_tensors(path)


def test_truncated_and_other_files_are_refused(tmp_path):
    path = torch_file(tmp_path / "net.pth", ARRAYS)
    whole = path.read_bytes()
    for keep in (0, 10, 300, -30):
        path.write_bytes(whole[:keep])
        with pytest.raises(gelform.DataError, match="truncated or damaged"):
            read_tensors(path)
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with zipfile.ZipFile(tmp_path / "big.pth", "w") as archive:
        archive.writestr("a/data.pkl", b"\x80\x02}.")
        archive.writestr("a/byteorder", "big")
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("é/data.pkl", b"")
    path.write_bytes(path.read_bytes().replace("é".encode(), b"\xff\xfe"))  # a name that is no text
    for name, said in (
        ("none.pth", "No file"),
        ("other.npz", r"data\.pkl"),
        ("big.pth", "little-endian"),
        ("net.pth", "damaged"),
    ):
        with pytest.raises(gelform.DataError, match=said):
            read_tensors(tmp_path / name)
