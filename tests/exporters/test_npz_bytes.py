"""Files of one frame: every reader of npz takes them for what `write_npz` writes."""

import io
import zipfile

import numpy as np
import pytest

from gelform.errors import DataError
from gelform.exporters import npz_bytes as module
from gelform.exporters.npz_bytes import npz_bytes
from gelform.npz_files import read_npz, write_npz

ARRAYS = {
    "depth_mm": np.arange(12, dtype=np.float32).reshape(3, 4),
    "turned": np.arange(6.0).reshape(2, 3).T,
    "known": np.array([[True, False]]),
    "mm_per_px": np.asarray(0.06),
    "words": np.array(["gel", "Höhe"]),
    "nothing": np.zeros((0, 4), dtype=np.uint16),
}
KIND = {"kind": "gelform maps", "version": 1}


def test_numpy_reads_what_was_given():
    with np.load(io.BytesIO(npz_bytes(ARRAYS, {"index": 3}, **KIND)), allow_pickle=False) as file:
        assert file.files == ["meta", *ARRAYS]
        for name, values in ARRAYS.items():
            assert file[name].dtype == values.dtype
            np.testing.assert_array_equal(file[name], values)


def test_the_archive_is_whole_and_holds_what_zipfile_would_write(tmp_path):
    in_c_order = {name: values.copy(order="C") for name, values in ARRAYS.items()}
    write_npz(tmp_path / "by_zipfile.npz", in_c_order, {"index": 3}, **KIND)
    content = npz_bytes(ARRAYS, {"index": 3}, **KIND)
    with zipfile.ZipFile(tmp_path / "by_zipfile.npz") as wanted, zipfile.ZipFile(io.BytesIO(content)) as got:
        assert got.testzip() is None
        assert got.namelist() == wanted.namelist()
        for one in wanted.infolist():
            ours = got.getinfo(one.filename)
            assert (ours.file_size, ours.CRC, ours.date_time) == (one.file_size, one.CRC, one.date_time)
            offset = ours.header_offset + 30 + len(one.filename)
            assert content[offset : offset + ours.file_size] == wanted.read(one)


def test_its_own_reader_checks_it(tmp_path):
    content = npz_bytes(ARRAYS, {"index": 3}, **KIND)
    path = tmp_path / "frame.npz"
    path.write_bytes(content)
    arrays, meta = read_npz(path, kind="gelform maps", newest_version=1)
    assert arrays.keys() == ARRAYS.keys()
    assert meta["index"] == 3
    place = content.index(ARRAYS["depth_mm"].tobytes())
    path.write_bytes(content[:place] + b"\1" + content[place + 1 :])
    with pytest.raises(DataError, match="truncated or damaged"):
        read_npz(path, kind="gelform maps", newest_version=1)


def test_more_than_a_reader_takes_is_refused(monkeypatch):
    monkeypatch.setattr(module, "MAX_BYTES", 100)
    with pytest.raises(ValueError, match=r"at most 0\.0001 MB"):
        npz_bytes(ARRAYS, {}, **KIND)
