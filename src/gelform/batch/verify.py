"""A full check of an output: missing, changed, damaged and extra files."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from gelform.batch.manifest import read_manifest
from gelform.batch.outputs.files import FRAMES, output_file
from gelform.batch.records import PartRecord, read_record, record_path
from gelform.errors import DataError
from gelform.foundations.checks import check_path
from gelform.foundations.progress import Progress, no_progress

NOT_FINISHED = "is missing, with the table and the contact sheet. Run the same command again."


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
                problems.append(Problem(record_path(output, None), NOT_FINISHED))
            continue
        errors += record.errors
        expected |= {file.path for file in record.outputs}
        here = list(_problems_of_part(output, record))
        good += _whole_frames(output, record, {one.path for one in here})
        problems += here
    if missing:
        what = f"{missing} of {manifest.parts} parts are not done. Run the same command again."
        problems.append(Problem(output, what))
    else:  # a part in work has no record of its files yet
        problems += [Problem(path, "no part knows of it.") for path in _others(output, expected)]
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


def _whole_frames(output: Path, record: PartRecord, wrong: set[Path]) -> int:
    """Number of intact frames in their own files; a damaged file of several frames counts for none."""
    if record.files and wrong:
        return 0
    return sum(bool(row["output"]) and output / row["output"] not in wrong for row in record.rows)


def _others(output: Path, expected: set[str]) -> Iterator[Path]:
    """Files among the frames that no part wrote; hidden files are leftovers of a killed run."""
    for folder, _, files in os.walk(output / FRAMES):
        for name in sorted(files):
            path = Path(folder) / name
            if not name.startswith(".") and path.relative_to(output).as_posix() not in expected:
                yield path
