"""What is written of each part when it is done, and the table of all frames."""

from __future__ import annotations

import csv
import hashlib
import io
import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gelform.errors import DataError
from gelform.npz_files import written_file

COLUMNS = (
    "sequence",
    "frame",
    "index",
    "output",
    "time_s",
    "wall_time_ns",
    "deepest_mm",
    "contact_mm2",
    "volume_mm3",
    "contacts",
    "findings",
    "error",
)
FRAMES, PARTS, TABLE = "frames", "parts", "frames.csv"
PARTS_IN_A_FOLDER = 1000


@dataclass(frozen=True)
class PartRecord:
    """A part that is done.

    Attributes
    ----------
    input_digest : of the files that it was made from (see `Part.input_digest`)
    rows : a dict for each frame: the table's columns, and `bytes` and `sha256` of its output
    """

    input_digest: str
    rows: tuple[dict[str, Any], ...]

    @property
    def errors(self) -> int:
        """How many frames have one."""
        return sum(bool(row["error"]) for row in self.rows)


def record_path(output: Path, number: int) -> Path:
    """Where the record of a part is."""
    return output / PARTS / f"{number // PARTS_IN_A_FOLDER:05d}" / f"{number:08d}.json"


def write_record(output: Path, number: int, record: PartRecord) -> None:
    """Write a part's record: from then on the part is done."""
    path = record_path(output, number)
    path.parent.mkdir(parents=True, exist_ok=True)
    content = {"input_digest": record.input_digest, "rows": list(record.rows)}
    with written_file(path, overwrite=True) as file:
        file.write(json.dumps({**content, "digest": _digest(content)}).encode())


def read_record(output: Path, number: int) -> PartRecord | None:
    """The record of a part; None where it is not done.

    Raises
    ------
    DataError
        The record is damaged.
    """
    path = record_path(output, number)
    try:
        content = json.loads(path.read_bytes())
        digest = content.pop("digest")
        if digest != _digest(content):
            raise ValueError("altered")
        return PartRecord(content["input_digest"], tuple(content["rows"]))
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, TypeError, AttributeError) as problem:
        raise DataError(
            f"{path} is damaged. Delete it and run the same command: its part is done anew."
        ) from problem


def outputs_there(output: Path, record: PartRecord) -> bool:
    """Whether every output of a part is there in its full size; `gelform verify` reads them too."""
    for row in record.rows:
        if row["output"]:
            try:
                if (output / row["output"]).stat().st_size != row["bytes"]:
                    return False
            except OSError:
                return False
    return True


def write_table(output: Path, parts: int) -> None:
    """The table of all frames, from the records of all parts."""
    with written_file(output / TABLE, overwrite=True) as file:
        for line in table_lines(output, range(parts)):
            file.write(line)


def table_lines(output: Path, numbers: Iterable[int]) -> Iterator[bytes]:
    """The header and the rows of some parts as CSV, a piece for each part."""
    yield _csv([COLUMNS])
    for number in numbers:
        record = read_record(output, number)
        if record is None:
            raise DataError(f"Part {number} of {output} is not done. Run the same command again.")
        yield _csv([[row[column] for column in COLUMNS] for row in record.rows])


def _csv(rows: Iterable[Iterable[Any]]) -> bytes:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue().encode("utf-8", "backslashreplace")  # names of files may be no text


def _digest(content: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
