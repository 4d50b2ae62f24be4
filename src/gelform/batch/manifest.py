"""The conditions of an output, the lock against other writers, and a full check of its files."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gelform import __version__
from gelform.batch.outputs.array_files import INDEX
from gelform.batch.outputs.files import FRAMES, PARTS, output_file
from gelform.batch.records import TABLES, PartRecord, read_record, record_path
from gelform.errors import DataError
from gelform.foundations.checks import check_path
from gelform.foundations.files import written_file
from gelform.foundations.findings import Progress, no_progress

NAME, KIND, FORMAT_VERSION = "manifest.json", "gelform batch", 1
LOCK, WAIT_S = ".gelform-batch.lock", 5.0
_IN_WORDS = {
    "gelform_version": "the version of gelform",
    "calibration_digest": "the calibration",
    "background_digest": "the background",
    "listing_digest": "the list of input files",
}


@dataclass(frozen=True)
class Manifest:
    """Everything that determines the outputs.

    Attributes
    ----------
    settings : of the batch, as in JSON
    calibration_digest, background_digest, listing_digest : of the inputs; empty without a background of its own
    parts : number of parts
    images : number of images; frames of videos and recordings are not counted
    gelform_version : version that wrote it
    """

    settings: dict[str, Any]
    calibration_digest: str
    background_digest: str
    listing_digest: str
    parts: int
    images: int
    gelform_version: str = __version__

    def write(self, output: Path) -> None:
        """Write the manifest into the output folder."""
        content = {"format": KIND, "format_version": FORMAT_VERSION, **vars(self)}
        with written_file(output / NAME, overwrite=True) as file:
            file.write((json.dumps(content, indent=1) + "\n").encode())

    def differences(self, other: Manifest) -> list[str]:
        """The differences, as text."""
        words = [text for name, text in _IN_WORDS.items() if getattr(self, name) != getattr(other, name)]
        for name in sorted(self.settings.keys() | other.settings.keys()):
            mine, others = self.settings.get(name), other.settings.get(name)
            if mine != others:
                words.append(f"the setting {name} ({_text(mine)} then, {_text(others)} now)")
        return words


def read_manifest(output: Path) -> Manifest | None:
    """The manifest of an output folder; None if there is none. DataError if it is damaged or of a newer format."""
    path = output / NAME
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
    if overwrite:
        _remove(output)
    there = read_manifest(output)
    if there is None:
        others = [name for name in os.listdir(output) if not name.startswith(".")]
        if others:
            raise DataError(
                f"{output} holds {sorted(others)[0]}, but no manifest of a batch. Give a new or an empty folder."
            )
        wanted.write(output)
        return
    different = there.differences(wanted)
    if different:
        raise DataError(
            f"{output} was started with something else: {'; '.join(different)}. Give another output folder, or "
            "start again with --overwrite, which deletes the old output."
        )


def _remove(output: Path) -> None:
    """Empty a folder that a batch wrote; the manifest goes last, so that an interrupted removal can be repeated."""
    if not (output / NAME).exists():
        return
    for name in (FRAMES, PARTS):
        if (output / name).is_dir():
            shutil.rmtree(output / name)
    for name in (*TABLES.values(), INDEX, "sheet.png", NAME):
        (output / name).unlink(missing_ok=True)


def _text(value: Any) -> str:
    return ",".join(map(str, value)) if isinstance(value, list) else str(value)


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
