"""Records of parts: read as written, damage noticed; the table is all of them."""

import csv

import pytest

from gelform.batch.outputs.files import OutputFile
from gelform.batch.records import (
    COLUMNS,
    PartRecord,
    files_of,
    outputs_there,
    read_record,
    record_path,
    table_form,
    table_is_whole,
    tables_there,
    write_record,
    write_table,
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


def test_damage_is_noticed(tmp_path):
    for damage in [lambda text: text[:-9], lambda text: text.replace(b'"1"', b'"2"'), bytes]:
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


PARTS = 203


@pytest.fixture
def output(tmp_path):
    def row(frame, **more):
        return {**dict.fromkeys(COLUMNS, ""), "sequence": "a", "frame": frame, **more}

    for number in range(PARTS):
        good = row("0", index=2 * number, deepest_mm=0.25, contacts=1, wall_time_ns=1 << 60, output="x")
        bad = row("\udcff", index=2 * number + 1, error="it is empty, so")
        write_record(tmp_path, number, PartRecord("", (good, bad), (OutputFile("x", 1, ""),)))
    return tmp_path


def test_csv(output):
    write_table(output, PARTS, "csv")
    with (output / "frames.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [int(one["index"]) for one in rows] == list(range(2 * PARTS))
    assert rows[1]["error"] == "it is empty, so"
    with pytest.raises(DataError, match=rf"Part {PARTS} .* is not done"):
        write_table(output, PARTS + 1, "csv")


def test_parquet(output):
    parquet = pytest.importorskip("pyarrow.parquet", reason="the extra parquet is not installed")
    write_table(output, PARTS, "parquet")
    read = parquet.read_table(output / "frames.parquet")
    assert read.column_names == list(COLUMNS)
    assert read["index"].to_pylist() == list(range(2 * PARTS))
    first, second = read.slice(0, 2).to_pylist()
    assert (first["deepest_mm"], first["wall_time_ns"], first["error"]) == (0.25, 1 << 60, None)
    assert (second["deepest_mm"], second["frame"], second["error"]) == (None, "\\udcff", "it is empty, so")


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_a_table_that_says_something_else_is_found(output, form):
    if form == "parquet":
        pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
    write_table(output, PARTS, form)
    assert tables_there(output) == [form]
    assert table_is_whole(output, PARTS, form)
    assert not table_is_whole(output, PARTS - 1, form)
    path = output / f"frames.{form}"
    path.write_bytes(path.read_bytes()[:-9])
    assert not table_is_whole(output, PARTS, form)


def test_which_is_written(monkeypatch):
    monkeypatch.setattr("gelform.batch.records.find_spec", lambda name: None)
    assert table_form() == "csv"
    with pytest.raises(DataError, match=r"gelform\[parquet\]"):
        table_form("parquet")
    monkeypatch.setattr("gelform.batch.records.find_spec", lambda name: name)
    assert table_form() == "parquet"
    with pytest.raises(ValueError, match="Expected a table among"):
        table_form("xlsx")
