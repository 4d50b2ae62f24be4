"""The table of all frames, one row each: Parquet where pyarrow is installed, CSV else."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping, Sequence
from importlib.util import find_spec
from itertools import zip_longest
from pathlib import Path
from typing import Any

from gelform.batch.records import done_records
from gelform.errors import DataError
from gelform.npz_files import written_file

COLUMNS: dict[str, str] = {  # name -> type in Parquet
    "sequence": "string",
    "frame": "string",
    "index": "int64",
    "output": "string",
    "time_s": "float64",
    "wall_time_ns": "int64",
    "deepest_mm": "float64",
    "deepest_x_px": "int32",
    "deepest_y_px": "int32",
    "contact_mm2": "float64",
    "volume_mm3": "float64",
    "contacts": "int32",
    "health": "string",
    "error": "string",
}
TABLES = {"parquet": "frames.parquet", "csv": "frames.csv"}
PARTS_IN_A_GROUP = 100


def table_form(asked: str = "auto") -> str:
    """ "parquet" or "csv"; where it is left to us, Parquet if pyarrow is there.

    Raises
    ------
    DataError
        Parquet is asked for, and pyarrow is not installed.
    ValueError
        Another form.
    """
    if asked not in ("auto", *TABLES):
        raise ValueError(f"Expected a table among auto, {', '.join(TABLES)}, got {asked!r}.")
    there = find_spec("pyarrow") is not None
    if asked == "parquet" and not there:
        raise DataError(
            'A table as Parquet needs the extra parquet: pip install "gelform[parquet]". Or ask for csv.'
        )
    return asked if asked != "auto" else ("parquet" if there else "csv")


def write_table(output: Path, parts: int, form: str) -> None:
    """Write frames.parquet or frames.csv from the records of all parts; memory does not grow with their number."""
    with written_file(output / TABLES[form], overwrite=True) as file:
        if form == "csv":
            for line in _lines(output, parts):
                file.write(line)
            return
        from pyarrow import parquet

        with parquet.ParquetWriter(file, _schema()) as writer:
            for group in _groups(output, parts):
                writer.write_table(group)


def table_is_whole(output: Path, parts: int, form: str) -> bool:
    """Whether the table that is there says what the records say."""
    try:
        return _csv_is_whole(output, parts) if form == "csv" else _parquet_is_whole(output, parts)
    except OSError:
        return False


def tables_there(output: Path) -> list[str]:
    """The forms in which the output has a table."""
    return [form for form, name in TABLES.items() if (output / name).exists()]


def _csv_is_whole(output: Path, parts: int) -> bool:
    with (output / TABLES["csv"]).open("rb") as file:
        return all(file.read(len(piece)) == piece for piece in _lines(output, parts)) and not file.read(1)


def _parquet_is_whole(output: Path, parts: int) -> bool:
    table_form("parquet")
    from pyarrow import ArrowException, parquet

    try:
        with parquet.ParquetFile(output / TABLES["parquet"]) as file:
            there = (file.read_row_group(k) for k in range(file.num_row_groups))
            pairs = zip_longest(there, _groups(output, parts))
            return all(a is not None and b is not None and a.equals(b) for a, b in pairs)
    except ArrowException:
        return False


def _lines(output: Path, parts: int) -> Iterator[bytes]:
    """The header, then the rows of each part."""
    yield _csv([list(COLUMNS)])
    for record in done_records(output, parts):
        yield _csv([[row[column] for column in COLUMNS] for row in record.rows])


def _csv(rows: Sequence[Sequence[Any]]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode("utf-8", "backslashreplace")  # names of files may be no text


def _groups(output: Path, parts: int) -> Iterator[Any]:
    """Tables of pyarrow, one for every hundred parts."""
    group: list[Mapping[str, Any]] = []
    for number, record in enumerate(done_records(output, parts), 1):
        group += record.rows
        if (number % PARTS_IN_A_GROUP == 0 or number == parts) and group:
            yield _arrow_table(group)
            group = []


def _arrow_table(rows: Sequence[Mapping[str, Any]]) -> Any:
    import pyarrow

    schema = _schema()
    columns = [pyarrow.array([_cell(row[name]) for row in rows], schema.field(name).type) for name in COLUMNS]
    return pyarrow.table(columns, schema=schema)


def _schema() -> Any:
    import pyarrow

    return pyarrow.schema([(name, pyarrow.type_for_alias(kind)) for name, kind in COLUMNS.items()])


def _cell(value: Any) -> Any:
    if isinstance(value, str):
        return value.encode("utf-8", "backslashreplace").decode() or None
    return value
