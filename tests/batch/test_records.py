"""Records of parts: read as written, damage noticed; the table is all of them."""

import pytest

from gelform.batch.outputs.places import OutputFile
from gelform.batch.records import (
    PartRecord,
    files_of,
    outputs_there,
    read_record,
    record_path,
    write_record,
)
from gelform.errors import DataError


def row(frame, error="", **more):
    return {"output": "", "sequence": "a", "frame": frame, "error": error, **more}


FILE = OutputFile("0.h5", 3, "abc")
RECORD = PartRecord("digest", (row("0"), row("1", "it is empty, so")), (FILE,))


def test_as_written(tmp_path):
    assert read_record(tmp_path, 1234) is None
    write_record(tmp_path, 1234, RECORD)
    assert read_record(tmp_path, 1234) == RECORD
    assert RECORD.errors == 1


@pytest.mark.parametrize("damage", [lambda text: text[:-9], lambda text: text.replace(b'"1"', b'"2"'), bytes])
def test_damage_is_noticed(tmp_path, damage):
    write_record(tmp_path, 0, RECORD)
    path = record_path(tmp_path, 0)
    path.write_bytes(damage(path.read_bytes()) if damage is not bytes else b"")
    with pytest.raises(DataError, match="Delete it and run the same command"):
        read_record(tmp_path, 0)


def test_files_of_all_parts(tmp_path):
    write_record(tmp_path, 0, RECORD)
    assert files_of(tmp_path, 1) == ["0.h5"]
    with pytest.raises(DataError, match=r"Part 1 .* is not done"):
        files_of(tmp_path, 2)


def test_outputs_that_went_or_shrank(tmp_path):
    record = PartRecord("", (row("0", output="0.npz", bytes=3, sha256="a"), row("1", "no output")))
    assert not outputs_there(tmp_path, record)
    (tmp_path / "0.npz").write_bytes(b"abc")
    assert outputs_there(tmp_path, record)
    (tmp_path / "0.npz").write_bytes(b"ab")
    assert not outputs_there(tmp_path, record)
