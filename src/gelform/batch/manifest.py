"""What an output was begun with, so that another run goes on with the same and with nothing else."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gelform import __version__
from gelform.batch.inputs.listing import Listing
from gelform.batch.outputs.hdf5_files import INDEX
from gelform.batch.outputs.places import FRAMES, PARTS
from gelform.batch.settings import BatchSettings
from gelform.batch.table import TABLES
from gelform.errors import DataError
from gelform.npz_files import written_file

NAME, KIND, FORMAT_VERSION = "manifest.json", "gelform batch", 1
_IN_WORDS = {
    "gelform_version": "the version of gelform",
    "calibration_digest": "the calibration",
    "background_digest": "the background",
    "listing_digest": "the list of input files",
}


@dataclass(frozen=True)
class Manifest:
    """Everything that decides the outputs.

    Attributes
    ----------
    settings : of the batch, as JSON has them
    calibration_digest, background_digest, listing_digest : of what it is made from; no background of its own: empty
    parts : how many there are
    images : how many images there are; frames of videos and recordings are not counted
    gelform_version : that wrote it
    """

    settings: dict[str, Any]
    calibration_digest: str
    background_digest: str
    listing_digest: str
    parts: int
    images: int
    gelform_version: str = __version__

    @classmethod
    def of(
        cls,
        settings: BatchSettings,
        calibration_digest: str,
        background_digest: str,
        listing: Listing,
        parts: int,
    ) -> Manifest:
        """That of a run which is about to begin."""
        images = sum(len(sequence.images) for sequence in listing.sequences)
        digests = calibration_digest, background_digest, listing.digest
        return cls(settings.facts(), *digests, parts, images)

    def write(self, output: Path) -> None:
        """Write it into the output folder."""
        content = {"format": KIND, "format_version": FORMAT_VERSION, **vars(self)}
        with written_file(output / NAME, overwrite=True) as file:
            file.write((json.dumps(content, indent=1) + "\n").encode())

    def differences(self, other: Manifest) -> list[str]:
        """What is not the same, in words."""
        words = [text for name, text in _IN_WORDS.items() if getattr(self, name) != getattr(other, name)]
        for name in sorted(self.settings.keys() | other.settings.keys()):
            mine, others = self.settings.get(name), other.settings.get(name)
            if mine != others:
                words.append(f"the setting {name} ({_text(mine)} then, {_text(others)} now)")
        return words


def read_manifest(output: Path) -> Manifest | None:
    """The manifest of an output folder; None where there is none.

    Raises
    ------
    DataError
        It is damaged, of something else, or of a newer format.
    """
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
            f"{path} is damaged. Give another output folder, or begin anew with --overwrite."
        ) from problem
    raise DataError(f"{path} is no manifest of a batch. Give another output folder.")


def begin(output: Path, wanted: Manifest, *, overwrite: bool) -> None:
    """See that an output folder is new, or was begun with the same; write the manifest where there is none.

    Raises
    ------
    DataError
        It was begun with something else (unless `overwrite`, which empties it), or holds what no batch wrote.
    """
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
            f"{output} was begun with something else: {'; '.join(different)}. Give another output folder, or "
            "begin anew with --overwrite, which deletes what is there."
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
