"""The library: a folder of the user's calibrations, in files named by sensor, unit and gel."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from platformdirs import user_data_path

from gelform.calibration_file import Calibration, load_calibration
from gelform.errors import CalibrationError, DataError, GelformError
from gelform.foundations.npz_files import DIGEST_SHOWN, sweep
from gelform.sensors.cameras.camera import almost

FOLDER_VARIABLE = "GELFORM_CALIBRATIONS"
# Characters of a sensor's name, a serial or a gel in a file name; file systems allow 255 in all.
MAX_PART = 40


def library_folder() -> Path:
    """The folder of this user's calibrations: `GELFORM_CALIBRATIONS`, else in the system's folder for data of programs.

    Raises
    ------
    DataError
        The variable does not name an absolute path, the user has no home folder, or a file is there.
    """
    given = os.environ.get(FOLDER_VARIABLE)
    try:
        folder = (
            Path(given).expanduser() if given else user_data_path("gelform", appauthor=False) / "calibrations"
        )
    except (RuntimeError, OSError):  # neither HOME nor an entry for the user
        folder = Path(given or "")
    if not folder.is_absolute():
        if given:
            raise DataError(
                f"Expected an absolute path in {FOLDER_VARIABLE}, got {folder}. Begin it at the root."
            )
        raise DataError(
            "Expected a home folder for the library of calibrations, got none that begins at the root. "
            f"Name a folder in {FOLDER_VARIABLE}."
        )
    if folder.is_file():
        raise DataError(
            f"Expected a folder for the library of calibrations, got the file {folder}. Name a folder in {FOLDER_VARIABLE}."
        )
    return folder


@dataclass(frozen=True)
class Entry:
    """A file of the library.

    Attributes
    ----------
    path : of the file
    problem : the reason that it cannot be read; empty if it can
    sensor_name, serial, gel_id, created_utc, digest, held_out : from the `Calibration`; empty if it cannot be read
    """

    path: Path
    problem: str = ""
    sensor_name: str = ""
    serial: str | None = None
    gel_id: str | None = None
    created_utc: str = ""
    digest: str = ""
    held_out: Mapping[str, float] = field(default_factory=dict)

    def described(self) -> str:
        """File, gel and date, for a sentence."""
        return described(self.path.name, self)

    def answers_to(self, word: str) -> bool:
        """Whether a serial, a file name or the beginning of a digest identifies it."""
        by_digest = bool(self.digest) and len(word) >= 4 and self.digest.startswith(word.lower())
        return word in (self.serial, self.path.name, self.path.stem) or by_digest


def date_of(created_utc: str) -> str:
    """Date and minute of a calibration for people, UTC."""
    return created_utc[:16].replace("T", " ") or "an unknown date"


def described(name: str, one: Entry | Calibration) -> str:
    """Name, gel and date of a calibration, for a sentence."""
    return f"{name} (gel {one.gel_id or 'not named'}, of {date_of(one.created_utc)})"


def entry_of(path: Path) -> Entry:
    """The entry of a file of the library; for an unreadable file it has the reason."""
    try:
        return _entry(path, load_calibration(path))
    except GelformError as problem:
        return Entry(path, str(problem))


def _entry(path: Path, calibration: Calibration) -> Entry:
    return Entry(
        path,
        "",
        calibration.sensor_name,
        calibration.serial,
        calibration.gel_id,
        calibration.created_utc,
        calibration.digest,
        dict(calibration.held_out),
    )


def entries(folder: Path | None = None) -> list[Entry]:
    """All files of the library, the newest calibration first, those that cannot be read last.

    Parameters
    ----------
    folder : folder of the library; the user's by default
    """
    folder = library_folder() if folder is None else folder
    try:
        paths = sorted(folder.glob("*.npz"))
    except OSError as problem:
        raise DataError(f"Cannot list {folder}: {problem.strerror or problem}.") from problem
    return sorted(map(entry_of, paths), key=lambda one: one.created_utc, reverse=True)


def matching(word: str, gel_id: str | None = None, folder: Path | None = None) -> list[Entry]:
    """The entries that a serial, a file name or the beginning of a digest identifies, the newest first.

    Raises
    ------
    DataError
        There is none; the message lists the entries.
    """
    there = entries(folder)
    found = [one for one in there if one.answers_to(word) and gel_id in (None, one.gel_id)]
    if not found:
        gel = "" if gel_id is None else f" and gel {gel_id!r}"
        raise DataError(
            f"No calibration in the library with serial, file name or digest {word!r}{gel}. There: {listed(there)}."
            f"{almost(word, (one.serial for one in there))}"
        )
    return found


def listed(there: Sequence[Entry]) -> str:
    """Names of entries, for the end of a sentence."""
    return ", ".join(one.path.name for one in there) or "nothing"


def add_calibration(calibration: Calibration, folder: Path | None = None) -> tuple[Path, bool]:
    """Add a calibration to the library; one that is already there (`is_same`) is not written again.

    The file appears completely or not at all, and no file is replaced, so any number of processes can add at once.

    Returns
    -------
    path : path of its file
    new : whether this call wrote it

    Raises
    ------
    DataError, CalibrationError
        The folder cannot be made or written to.
    """
    folder = library_folder() if folder is None else folder
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise DataError(f"Cannot make the folder {folder}: {problem.strerror or problem}.") from problem
    sweep(folder)
    for entry in entries(folder):
        if is_same(entry, calibration):
            return entry.path, False
    number = 1
    while True:
        path = folder / file_name(calibration, number)
        try:
            calibration.save(path)
        except CalibrationError:
            if not os.path.lexists(path):
                raise
            if is_same(entry_of(path), calibration):  # another process was faster
                return path, False
            number += 1  # the file with this name is damaged; it stays
        else:
            return path, True


def is_same(one: Entry | Calibration, other: Entry | Calibration) -> bool:
    """Whether two calibrations have the same content, for the same camera and gel."""
    return (one.digest, one.serial, one.gel_id) == (other.digest, other.serial, other.gel_id)


def file_name(calibration: Calibration, number: int = 1) -> str:
    """Sensor, serial, gel, date and beginning of the digest; numbered from the second file of the same name on."""
    made = re.sub(r"[^0-9T]", "", calibration.created_utc[:16])
    parts = [calibration.sensor_name, calibration.serial or "no-serial", calibration.gel_id or "no-gel", made]
    named = "_".join(_plain(part) for part in parts)
    return f"{named}_{calibration.digest[:DIGEST_SHOWN]}{f'_{number}' if number > 1 else ''}.npz"


def _plain(text: str) -> str:
    """The text with only the characters that every file system accepts in a name."""
    return re.sub(r"[^A-Za-z0-9.]+", "-", text).strip("-.")[:MAX_PART] or "unnamed"


def remove_calibration(entry: Entry) -> None:
    """Delete a file of the library.

    DataError: it cannot be deleted.
    """
    try:
        entry.path.unlink(missing_ok=True)
    except OSError as problem:
        raise DataError(f"Cannot remove {entry.path}: {problem.strerror or problem}.") from problem


def facts_of(entry: Entry) -> dict[str, Any]:
    """An entry, as JSON holds it."""
    return {
        "file": str(entry.path),
        "sensor": entry.sensor_name or None,
        "serial": entry.serial,
        "gel_id": entry.gel_id,
        "created_utc": entry.created_utc or None,
        "digest": entry.digest or None,
        "held_out": dict(entry.held_out),
        "problem": entry.problem or None,
    }
