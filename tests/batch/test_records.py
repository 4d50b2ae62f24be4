"""Records of parts: read as written, damage noticed; the table is all of them."""

import csv

import pytest

from gelform.batch.records import (
    COLUMNS,
    PartRecord,
    outputs_there,
    read_record,
    record_path,
    write_record,
    write_table,
)
from gelform.errors import DataError


def row(frame, error="", **more):
    return {**dict.fromkeys(COLUMNS, ""), "sequence": "a", "frame": frame, "error": error, **more}


RECORD = PartRecord("digest", (row("0"), row("1", "it is empty, so")))


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


def test_the_table_has_every_row(tmp_path):
    for number in range(3):
        write_record(tmp_path, number, RECORD)
    write_table(tmp_path, 3)
    with (tmp_path / "frames.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [one["frame"] for one in rows] == ["0", "1"] * 3
    assert rows[1]["error"] == "it is empty, so"
    with pytest.raises(DataError, match=r"Part 3 .* is not done"):
        write_table(tmp_path, 4)


def test_outputs_that_went_or_shrank(tmp_path):
    record = PartRecord("", (row("0", output="0.npz", bytes=3), row("1", "no output")))
    assert not outputs_there(tmp_path, record)
    (tmp_path / "0.npz").write_bytes(b"abc")
    assert outputs_there(tmp_path, record)
    (tmp_path / "0.npz").write_bytes(b"ab")
    assert not outputs_there(tmp_path, record)
