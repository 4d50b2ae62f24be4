"""The table has every row, as CSV and as Parquet; a table that says something else is found."""

import csv

import pytest

from gelform.batch.outputs.places import OutputFile
from gelform.batch.records import PartRecord, write_record
from gelform.batch.table import COLUMNS, table_form, table_is_whole, tables_there, write_table
from gelform.errors import DataError

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
    monkeypatch.setattr("gelform.batch.table.find_spec", lambda name: None)
    assert table_form() == "csv"
    with pytest.raises(DataError, match=r"gelform\[parquet\]"):
        table_form("parquet")
    monkeypatch.setattr("gelform.batch.table.find_spec", lambda name: name)
    assert table_form() == "parquet"
    with pytest.raises(ValueError, match="Expected a table among"):
        table_form("xlsx")
