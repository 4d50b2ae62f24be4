"""The conditions of an output: a later run continues it only under the same ones. Also the lock against other writers."""

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
from gelform.batch.outputs.files import FRAMES, PARTS
from gelform.batch.outputs.hdf5_files import INDEX
from gelform.batch.records import TABLES
from gelform.errors import DataError
from gelform.foundations.npz_files import written_file

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
