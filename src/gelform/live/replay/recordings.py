"""The recordings that the page may open and fetch, by names that are made here: no path of a client's is opened."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from gelform.errors import GelformError
from gelform.sensors.recordings.image_folder import is_recorded_folder
from gelform.sensors.video_files import is_video


class Recordings:
    """Recordings by name: those of the command line, those of a folder, those made while the page is open.

    Parameters
    ----------
    given : paths from the command line
    folder : whose recordings (*.mcap, videos, folders that were recorded) are offered too, or None
    """

    def __init__(self, given: Iterable[Path] = (), folder: Path | None = None) -> None:
        self._lock = threading.Lock()
        self._paths: dict[str, Path] = {}
        for path in given:
            self.add(path)
        for path in sorted(folder.iterdir()) if folder is not None and folder.is_dir() else ():
            if path.suffix.lower() == ".mcap" or is_video(path) or is_recorded_folder(path):
                self.add(path)

    def add(self, path: Path) -> str:
        """Offer a recording; gives its name: the file's, numbered where several are called alike."""
        with self._lock:
            for name, known in self._paths.items():
                if known.resolve() == path.resolve():
                    return name
            name, count = path.resolve().name, 2
            while name in self._paths:
                name, count = f"{path.resolve().name} ({count})", count + 1
            self._paths[name] = path
            return name

    def path(self, name: str) -> Path:
        """The file or folder of a name; GelformError where there is none."""
        with self._lock:
            if name not in self._paths:
                raise GelformError(f"There is no recording {name!r}. Choose one of the list.")
            return self._paths[name]

    def file(self, number: int) -> Path:
        """The file that is fetched under a number of the list; GelformError where there is none, or a folder."""
        with self._lock:
            paths = list(self._paths.values())
        if not 0 <= number < len(paths) or not paths[number].is_file():
            raise GelformError("There is no such file. Share the recording first: that makes one file of it.")
        return paths[number]

    def facts(self) -> list[dict[str, Any]]:
        """What the page lists: name, and the bytes of those that are one file; they are fetched by their place here."""
        with self._lock:
            listed = list(self._paths.items())
        return [{"name": name, "bytes": _bytes(path)} for name, path in listed]


def _bytes(path: Path) -> int | None:
    try:
        return path.stat().st_size if path.is_file() else None
    except OSError:
        return None  # it was removed meanwhile
