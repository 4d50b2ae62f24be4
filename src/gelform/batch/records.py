"""The record of each finished part, and the table of all frames.

The table has one row per frame: as Parquet if pyarrow is installed, else as CSV.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from gelform.batch.outputs.files import PARTS, OutputFile
from gelform.errors import DataError
from gelform.foundations.files import table_text, written_file

PARTS_IN_A_FOLDER = 1000  # records in one folder: folders with millions of files are slow
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
    **dict.fromkeys(("normal_n", "normal_sigma_n", "shear_x_n", "shear_y_n", "shear_sigma_n"), "float64"),
    **dict.fromkeys(("torsion_n_mm", "torsion_sigma_n_mm"), "float64"),
    "force_reason": "string",
    "health": "string",
    "error": "string",
}
TABLES = {"parquet": "frames.parquet", "csv": "frames.csv"}
PARTS_IN_A_GROUP = 100  # parts per row group of Parquet, which is in memory at once


@dataclass(frozen=True)
class PartRecord:
    """A finished part, or the end of a batch, which has files and no rows.

    Attributes
    ----------
    input_digest : digest of the part's files (see `Part.input_digest`)
    rows : a dict per frame: the table's columns, and `bytes` and `sha256` if the frame has its own file
    files : files with several frames
    """

    input_digest: str
    rows: tuple[dict[str, Any], ...]
    files: tuple[OutputFile, ...] = ()

    @property
    def outputs(self) -> list[OutputFile]:
        """Every file that the part wrote."""
        own = [row for row in self.rows if row["output"] and "sha256" in row]
        return [OutputFile(row["output"], row["bytes"], row["sha256"]) for row in own] + list(self.files)

    @property
    def errors(self) -> int:
        """Number of frames with an error."""
        return sum(bool(row["error"]) for row in self.rows)


def record_path(output: Path, number: int | None) -> Path:
    """The path of a part's record; None: of the record of the files that are written once all parts are done."""
    if number is None:
        return output / PARTS / "finished.json"
    return output / PARTS / f"{number // PARTS_IN_A_FOLDER:05d}" / f"{number:08d}.json"


def write_record(output: Path, number: int | None, record: PartRecord) -> None:
    """Write a part's record, one line with its digest and one of JSON; this marks the part as done."""
    path = record_path(output, number)
    path.parent.mkdir(parents=True, exist_ok=True)
    content = {
        "input_digest": record.input_digest,
        "rows": list(record.rows),
        "files": [vars(file) for file in record.files],
    }
    with written_file(path, overwrite=True) as file:
        line = json.dumps(content).encode()
        file.write(_digest(line) + b"\n" + line)


def read_record(output: Path, number: int | None) -> PartRecord | None:
    """The record of a part; None if the part is not done. DataError if the record is damaged."""
    path = record_path(output, number)
    try:
        digest, _, line = path.read_bytes().partition(b"\n")
        if digest != _digest(line):
            raise ValueError("altered")
        content = json.loads(line)
        files = tuple(OutputFile(**file) for file in content["files"])
        return PartRecord(content["input_digest"], tuple(content["rows"]), files)
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, TypeError, AttributeError) as problem:
        raise DataError(
            f"{path} is damaged. Delete it and run the same command: its part is then done again."
        ) from problem


def outputs_there(output: Path, record: PartRecord) -> bool:
    """Whether every output of a part exists with its full size; `gelform verify` also reads the content."""
    # There may be millions: paths as text, no object for each.
    folder = os.fspath(output)
    files = [(file.path, file.bytes) for file in record.files]
    own = ((row["output"], row["bytes"]) for row in record.rows if row["output"] and "sha256" in row)
    try:
        return all(os.stat(f"{folder}/{path}").st_size == size for path, size in (*files, *own))
    except OSError:
        return False


def files_of(output: Path, parts: int) -> list[str]:
    """Files with several frames of all parts, in the order of the parts."""
    return [file.path for record in done_records(output, parts) for file in record.files]


def done_records(output: Path, parts: int) -> Iterator[PartRecord]:
    """The records of all parts; DataError if a part is not done."""
    for number in range(parts):
        record = read_record(output, number)
        if record is None:
            raise DataError(f"Part {number} of {output} is not done. Run the same command again.")
        yield record


def _digest(line: bytes) -> bytes:
    return hashlib.sha256(line).hexdigest().encode()


def table_form(asked: str = "auto") -> str:
    """The form of the table: "auto" is "parquet" if pyarrow is installed, else "csv". DataError for Parquet without it."""
    if asked not in ("auto", *TABLES):
        raise ValueError(f"Expected a table among auto, {', '.join(TABLES)}, got {asked!r}.")
    there = find_spec("pyarrow") is not None
    if asked == "parquet" and not there:
        raise DataError(
            'A table as Parquet needs the extra data: pip install "gelform[data]". Or ask for csv.'
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


def _lines(output: Path, parts: int) -> Iterator[bytes]:
    """The header, then the rows of each part."""
    yield _csv([list(COLUMNS)])
    for record in done_records(output, parts):
        yield _csv([[row[column] for column in COLUMNS] for row in record.rows])


def _csv(rows: Sequence[Sequence[Any]]) -> bytes:
    return table_text(rows).encode("utf-8", "backslashreplace")  # file names may not be valid text


def _groups(output: Path, parts: int) -> Iterator[Any]:
    """pyarrow tables, one per hundred parts."""
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
