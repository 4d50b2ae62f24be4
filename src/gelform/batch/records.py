"""What an output says of itself: its manifest, a record of each finished part, the table of frames; its lock and check."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import chain
from pathlib import Path
from typing import Any

from gelform import DataError, __version__
from gelform.batch.outputs.files import FRAMES, INDEX, PARTS, SHEET, OutputFile, output_file
from gelform.errors import Progress, no_progress
from gelform.foundations.checks import check_choice, check_path
from gelform.foundations.files import table_text, written_file

MANIFEST, KIND, FORMAT_VERSION = "manifest.json", "gelform batch", 1
LOCK, WAIT_S = ".gelform-batch.lock", 5.0
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


@dataclass(frozen=True)
class Manifest:
    """Everything that determines the outputs."""

    settings: dict[str, Any]  # of the batch, as in JSON
    calibration_digest: str
    background_digest: str  # empty without a background of its own
    listing_digest: str
    parts: int
    images: int  # frames of videos and recordings are not counted
    gelform_version: str = __version__  # that wrote it


def read_manifest(output: Path) -> Manifest | None:
    """The manifest of an output folder; None if there is none. DataError if it is damaged or of a newer format."""
    path = output / MANIFEST
    try:
        content = json.loads(path.read_bytes())
        kind, version = content.pop("format"), content.pop("format_version")
        if kind == KIND and version > FORMAT_VERSION:
            writer = content["gelform_version"]
            raise DataError(
                f"{path} has format version {version}, of gelform {writer}. Install that release."
            )
        if kind == KIND:
            return Manifest(**content)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as problem:
        raise DataError(f"Cannot read {path}: {problem.strerror}.") from problem
    except (ValueError, KeyError, TypeError, AttributeError) as problem:
        raise DataError(
            f"{path} is damaged. Give another output folder, or start again with --overwrite."
        ) from problem
    raise DataError(f"{path} is no manifest of a batch. Give another output folder.")


def begin(output: Path, wanted: Manifest, *, overwrite: bool) -> None:
    """Check that an output is new or has the same manifest (DataError), then write it; `overwrite` empties the output."""
    if overwrite and (output / MANIFEST).exists():
        for name in (FRAMES, PARTS):
            if (output / name).is_dir():
                shutil.rmtree(output / name)
        # The manifest goes last, so that an interrupted removal can be repeated.
        for name in (*TABLES.values(), INDEX, SHEET, MANIFEST):
            (output / name).unlink(missing_ok=True)
    there = read_manifest(output)
    if there is None:
        others = [name for name in os.listdir(output) if not name.startswith(".")]
        if others:
            raise DataError(
                f"{output} holds {sorted(others)[0]}, but no manifest of a batch. Give a new or an empty folder."
            )
        content = {"format": KIND, "format_version": FORMAT_VERSION, **vars(wanted)}
        with written_file(output / MANIFEST, overwrite=True) as file:
            file.write((json.dumps(content, indent=1) + "\n").encode())
        return
    words = {
        "gelform_version": "the version of gelform",
        "calibration_digest": "the calibration",
        "background_digest": "the background",
        "listing_digest": "the list of input files",
    }
    different = [text for name, text in words.items() if getattr(there, name) != getattr(wanted, name)]
    for name in sorted(there.settings.keys() | wanted.settings.keys()):
        both = there.settings.get(name), wanted.settings.get(name)
        if both[0] != both[1]:
            then, now = (",".join(map(str, one)) if isinstance(one, list) else one for one in both)
            different.append(f"the setting {name} ({then} then, {now} now)")
    if different:
        raise DataError(
            f"{output} was started with something else: {'; '.join(different)}. Give another output folder, or "
            "start again with --overwrite, which deletes the old output."
        )


@contextmanager
def only_run(output: Path, shard: tuple[int, int] = (1, 1)) -> Iterator[bool]:
    """Lock an output folder during a run; yields whether no other run writes to it. DataError if the lock is taken.

    A run of all parts holds the folder's lock, and a shard its own; each looks at the other's as it begins. The system
    releases a lock however the process ends.
    """
    from filelock import FileLock, Timeout  # takes a tenth of a second, and most commands lock nothing

    alone, whole = shard[1] == 1, output / LOCK
    own = whole if alone else output / f"{LOCK}-{shard[0]}-of-{shard[1]}"
    with ExitStack() as held:
        try:
            held.enter_context(FileLock(own, timeout=0))
            for other in output.glob(f"{LOCK}-*") if alone else (whole,):
                # Other shards look at the folder's lock too, for a moment.
                with FileLock(other, timeout=0 if alone else WAIT_S):
                    pass
        except Timeout as problem:
            raise DataError(
                f"Another run of gelform batch writes to {output} now. Wait for it, or give another output folder."
            ) from problem
        except (OSError, NotImplementedError) as problem:
            raise DataError(
                f"Cannot lock {own}: {problem}. Give an output folder that can be written to, on a file system with locks."
            ) from problem
        yield alone


@dataclass(frozen=True)
class PartRecord:
    """A finished part, or the end of a batch, which has files and no rows."""

    input_digest: str  # of the part's files (see `Part.input_digest`)
    # Of each frame the table's columns; and `bytes` and `sha256` if it has a file of its own.
    rows: tuple[dict[str, Any], ...]
    files: tuple[OutputFile, ...] = ()  # with several frames

    @property
    def outputs(self) -> list[OutputFile]:
        """Every file that the part wrote."""
        own = [row for row in self.rows if row["output"] and "sha256" in row]
        return [OutputFile(row["output"], row["bytes"], row["sha256"]) for row in own] + list(self.files)

    @property
    def errors(self) -> int:
        """Number of frames with an error."""
        return sum(bool(row["error"]) for row in self.rows)

    @property
    def counts(self) -> tuple[int, int]:
        """Numbers of frames, and of those with an error."""
        return len(self.rows), self.errors


def record_path(output: Path, number: int | None) -> Path:
    """The path of a part's record; None: of the record of the files that are written once all parts are done."""
    if number is None:
        return output / PARTS / "finished.json"
    # A folder has a thousand: those with millions of files are slow.
    return output / PARTS / f"{number // 1000:05d}" / f"{number:08d}.json"


def write_record(output: Path, number: int | None, record: PartRecord) -> None:
    """Write a part's record, one line with its digest and one of JSON; this marks the part as done."""
    path = record_path(output, number)
    path.parent.mkdir(parents=True, exist_ok=True)
    line = json.dumps({**vars(record), "files": [vars(file) for file in record.files]}).encode()
    with written_file(path, overwrite=True) as file:
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
    check_choice(asked, ("auto", *TABLES), "a table")
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
            rows = (row for record in done_records(output, parts) for row in record.rows)
            for cells in chain([list(COLUMNS)], ([row[name] for name in COLUMNS] for row in rows)):
                # File names may not be valid text.
                file.write(table_text([cells]).encode("utf-8", "backslashreplace"))
            return
        import pyarrow
        from pyarrow import parquet

        schema = pyarrow.schema([(name, pyarrow.type_for_alias(kind)) for name, kind in COLUMNS.items()])
        with parquet.ParquetWriter(file, schema) as writer:
            group: list[dict[str, Any]] = []
            for number, record in enumerate(done_records(output, parts), 1):
                group += record.rows
                # A row group of a hundred parts is in memory at once.
                if group and (number % 100 == 0 or number == parts):
                    columns = (([_cell(row[one.name]) for row in group], one.type) for one in schema)
                    writer.write_table(pyarrow.table([pyarrow.array(*one) for one in columns], schema=schema))
                    group = []


def _cell(value: Any) -> Any:
    """A value for Parquet: no text is null."""
    if isinstance(value, str):
        return value.encode("utf-8", "backslashreplace").decode() or None
    return value


@dataclass(frozen=True)
class Problem:
    """A fault of an output: the file and its problem."""

    path: Path
    what: str


def verify_output(
    output: str | os.PathLike[str], progress: Progress = no_progress
) -> tuple[int, int, list[Problem]]:
    """Read everything that a batch wrote and compare it with its records.

    Returns
    -------
    frames : number of unchanged outputs
    errors : number of frames without output because of an error, which the table states
    problems : the faults; empty if the batch is done and complete

    Raises
    ------
    DataError
        No batch wrote the folder, or its manifest is damaged.
    """
    output = check_path(output)
    manifest = read_manifest(output)
    if manifest is None and output.is_dir() and all(one.name.startswith(".") for one in output.iterdir()):
        raise DataError(f"{output} has no frame: its batch ended before the first one. Run the batch again.")
    if manifest is None:
        raise DataError(f"{output} has no manifest.json. Expected the output folder of gelform batch.")
    problems: list[Problem] = []
    expected: set[str] = set()
    good = errors = missing = 0
    for number in (*range(manifest.parts), None):
        progress(manifest.parts if number is None else number, manifest.parts, "verifying")
        try:
            record = read_record(output, number)
        except DataError as problem:
            problems.append(Problem(output, str(problem)))
            continue
        if record is None:
            if number is not None:
                missing += 1
            elif not missing:
                what = "is missing, with the table and the contact sheet. Run the same command again."
                problems.append(Problem(record_path(output, None), what))
            continue
        errors += record.errors
        expected |= {file.path for file in record.outputs}
        here = list(_problems_of_part(output, record))
        problems += here
        wrong = {one.path for one in here}
        if not (record.files and wrong):  # a damaged file of several frames leaves none whole
            good += sum(bool(row["output"]) and output / row["output"] not in wrong for row in record.rows)
    if missing:
        what = f"{missing} of {manifest.parts} parts are not done. Run the same command again."
        problems.append(Problem(output, what))
    else:  # a part in work has no record of its files yet
        for folder, _, files in os.walk(output / FRAMES):
            for path in (Path(folder) / name for name in sorted(files)):
                is_hidden = path.name.startswith(".")  # a leftover of a killed run
                if not is_hidden and path.relative_to(output).as_posix() not in expected:
                    problems.append(Problem(path, "no part knows of it."))
    return good, errors, problems


def _problems_of_part(output: Path, record: PartRecord) -> Iterator[Problem]:
    for file in record.outputs:
        path = output / file.path
        try:
            there = output_file(output, path)
        except FileNotFoundError:
            yield Problem(path, "is missing. Run the same command again.")
        except OSError as problem:
            yield Problem(path, f"cannot be read: {problem.strerror}.")
        else:
            if there.bytes != file.bytes:
                yield Problem(path, f"has {there.bytes} of {file.bytes} bytes. Run the same command again.")
            elif there != file:
                yield Problem(path, "was altered. Delete it and run the same command again.")
