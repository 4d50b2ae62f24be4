"""The lists that the page chooses from, by names made here; no path from a client is opened."""

from __future__ import annotations

import threading
from collections.abc import Container, Iterable
from pathlib import Path
from typing import Any

from gelform.calibration.library.choose import Unit
from gelform.calibration.library.library import described, is_same
from gelform.calibration_file import Calibration, is_calibration, load_calibration
from gelform.errors import GelformError
from gelform.sensors.recordings.indexed import recordings_in

LONGEST_NAME = 150  # letters of a listed name; a page's message holds 200


class Calibrations:
    """Calibrations by name: given ones, those of a folder, those made while the page is open.

    Parameters
    ----------
    given : paths from the command line
    folder, library : more folders of calibrations, or None
    """

    def __init__(
        self, given: Iterable[Path] = (), folder: Path | None = None, library: Path | None = None
    ) -> None:
        self._lock = threading.Lock()
        self._paths: dict[str, Path | None] = {}
        self._loaded: dict[str, Calibration] = {}
        for path in given:
            self.add_file(path)
        for place in (folder, library):
            for path in files_of(place):
                if path.suffix == ".npz" and is_calibration(path):
                    self.add_file(path)

    @property
    def names(self) -> list[str]:
        """The names for the page, in the order of their addition."""
        with self._lock:
            return list(self._paths)

    def add_file(self, path: Path) -> str:
        """Add a file; return its name: the file's, with its folder if two files have the same name."""
        with self._lock:
            listed = {name: known for name, known in self._paths.items() if known is not None}
            if (known := _name_of(path, listed)) is not None:
                return known
            name = path.name if path.name not in listed else f"{path.parent.name}/{path.name}"
            name = _free(shown_name(name), self._paths)
            self._paths[name] = path
            return name

    def add(self, name: str, calibration: Calibration) -> str:
        """Add a calibration without a file; return its name. The same calibration is added once."""
        with self._lock:
            known = self._loaded.get(name)
            if known is None or not is_same(known, calibration):
                name = _free(name, self._paths)
                self._loaded[name], self._paths[name] = calibration, None
            return name

    def put(self, name: str, calibration: Calibration) -> None:
        """Add a calibration without a file, in the place of one of that name."""
        with self._lock:
            self._loaded[name], self._paths[name] = calibration, None

    def of_unit(self, unit: Unit) -> str | None:
        """The name of the newest listed calibration of a unit, or of the one that was in use; None if there is none."""
        found: list[tuple[bool, str, str]] = []
        for name in self.names:
            try:
                calibration = self[name]
            except GelformError:
                continue  # the error of its file is reported when it is chosen
            if unit.is_calibrated_by(calibration):
                in_use = bool(unit.digest) and calibration.digest == unit.digest
                found.append((in_use, calibration.created_utc, name))
        return max(found)[2] if found else None

    def described(self, name: str) -> str:
        """The name of a calibration, its gel and date, for a sentence."""
        return described(name, self[name])

    def __getitem__(self, name: str) -> Calibration:
        """The calibration with a name.

        Raises
        ------
        GelformError
            The name is unknown, or the file cannot be read.
        """
        with self._lock:
            if name in self._loaded:
                return self._loaded[name]
            path = self._paths.get(name)
        if path is None:
            raise GelformError(f"There is no calibration {name!r}. Choose one in the list.")
        calibration = load_calibration(path)
        with self._lock:
            self._loaded[name] = calibration
        return calibration


class Recordings:
    """Recordings by name: those of the command line, those of a folder, those made while the page is open.

    Parameters
    ----------
    given : paths from the command line
    folder : a folder with more recordings (*.mcap, videos), or None
    """

    def __init__(self, given: Iterable[Path] = (), folder: Path | None = None) -> None:
        self._lock, self._folder = threading.Lock(), folder
        self._paths: dict[str, Path] = {}
        for path in given:
            self.add(path)
        own = set(files_of(folder))
        for path in recordings_in(folder) if folder is not None else ():
            if path in own:
                self.add(path)

    def add(self, path: Path) -> str:
        """Add a recording; return its name: the file's, with a number if that name is taken."""
        with self._lock:
            name = _name_of(path, self._paths) or _free(shown_name(_resolved(path).name), self._paths)
            self._paths.setdefault(name, path)
            return name

    def path(self, name: str) -> Path:
        """The file or folder with a name; GelformError if there is none."""
        with self._lock:
            path = self._paths.get(name)
        if path is None or self._left(path):
            raise GelformError(f"There is no recording {name!r}. Choose one in the list.")
        return path

    def file(self, number: int) -> Path:
        """The file with a number of the list, for download; GelformError if there is none, or it is a folder."""
        with self._lock:
            paths = list(self._paths.values())
        if not 0 <= number < len(paths) or not paths[number].is_file() or self._left(paths[number]):
            raise GelformError("There is no such file. Press Share first to make one file of the recording.")
        return paths[number]

    def _left(self, path: Path) -> bool:
        """Whether a path in the folder is a link out of it by now."""
        return path.parent == self._folder and path.is_symlink() and not _is_below(path, self._folder)

    def facts(self) -> list[dict[str, Any]]:
        """The list for the page: names, and sizes in bytes of single files, which are downloaded by their position."""
        with self._lock:
            listed = list(self._paths.items())
        return [{"name": name, "bytes": _bytes(path)} for name, path in listed]


def files_of(folder: Path | None) -> list[Path]:
    """The regular files of a folder, sorted: no pipes, no links to themselves or out of the folder; [] without a folder."""
    if folder is None or not folder.is_dir():
        return []
    return sorted(path for path in folder.iterdir() if path.is_file() and _is_below(path, folder))


def shown_name(name: str) -> str:
    """A name that every page can show and send back: no control codes, no bytes that are no text, not too long."""
    shown = "".join(one if one.isprintable() else ascii(one)[1:-1] for one in name)
    return (
        shown
        if len(shown) <= LONGEST_NAME
        else f"{shown[: LONGEST_NAME // 2]}...{shown[-LONGEST_NAME // 2 :]}"
    )


def _is_below(path: Path, folder: Path) -> bool:
    return _resolved(folder) in _resolved(path).parents


def _resolved(path: Path) -> Path:
    try:
        return path.resolve()
    except (OSError, RuntimeError):  # a link to itself, before Python 3.13
        return path


def _name_of(path: Path, listed: dict[str, Path]) -> str | None:
    return next((name for name, known in listed.items() if _resolved(known) == _resolved(path)), None)


def _free(name: str, taken: Container[str]) -> str:
    number, free = 2, name
    while free in taken:
        free, number = f"{name} ({number})", number + 1
    return free


def _bytes(path: Path) -> int | None:
    try:
        return path.stat().st_size if path.is_file() else None
    except OSError:
        return None  # it was removed meanwhile
