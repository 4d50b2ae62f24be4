"""What is written of each part when it is done, and the table of all frames."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gelform.batch.outputs.places import PARTS, OutputFile
from gelform.errors import DataError
from gelform.npz_files import written_file

PARTS_IN_A_FOLDER = 1000


@dataclass(frozen=True)
class PartRecord:
    """A part that is done.

    Attributes
    ----------
    input_digest : of the files that it was made from (see `Part.input_digest`)
    rows : a dict for each frame: the table's columns, and `bytes` and `sha256` where its output is a file of its own
    files : those that hold several frames
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
        """How many frames have one."""
        return sum(bool(row["error"]) for row in self.rows)


def record_path(output: Path, number: int) -> Path:
    """Where the record of a part is."""
    return output / PARTS / f"{number // PARTS_IN_A_FOLDER:05d}" / f"{number:08d}.json"


def write_record(output: Path, number: int, record: PartRecord) -> None:
    """Write a part's record, a line with its digest and one of JSON: from then on the part is done."""
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


def read_record(output: Path, number: int) -> PartRecord | None:
    """The record of a part; None where it is not done.

    Raises
    ------
    DataError
        The record is damaged.
    """
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
            f"{path} is damaged. Delete it and run the same command: its part is done anew."
        ) from problem


def outputs_there(output: Path, record: PartRecord) -> bool:
    """Whether every output of a part is there in its full size; `gelform verify` reads them too."""
    # Of millions: no objects for each, paths as text.
    folder = os.fspath(output)
    files = [(file.path, file.bytes) for file in record.files]
    own = ((row["output"], row["bytes"]) for row in record.rows if row["output"] and "sha256" in row)
    try:
        return all(os.stat(f"{folder}/{path}").st_size == size for path, size in (*files, *own))
    except OSError:
        return False


def files_of(output: Path, parts: int) -> list[str]:
    """Those of all parts that hold several frames, in the order of the parts."""
    return [file.path for record in done_records(output, parts) for file in record.files]


def done_records(output: Path, parts: int) -> Iterator[PartRecord]:
    """Those of all parts.

    Raises
    ------
    DataError
        A part is not done.
    """
    for number in range(parts):
        record = read_record(output, number)
        if record is None:
            raise DataError(f"Part {number} of {output} is not done. Run the same command again.")
        yield record


def _digest(line: bytes) -> bytes:
    return hashlib.sha256(line).hexdigest().encode()
