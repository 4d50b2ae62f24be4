"""The calibrations that the page may choose from, by names that are made here: no path of a client's is opened."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from gelform.calibration_file import KIND, Calibration, load_calibration
from gelform.errors import GelformError
from gelform.npz_files import kind_of_npz


@dataclass(frozen=True)
class Origin:
    """Where a calibration comes from, as Python says it.

    Attributes
    ----------
    expression : gives the calibration, beside `import gelform`
    imports : lines that it needs
    path : of its file, where it has one of its own
    """

    expression: str
    imports: tuple[str, ...] = ()
    path: Path | None = None


class Calibrations:
    """Calibrations by name: those given, those of a folder, those made while the page is open.

    Parameters
    ----------
    given : paths from the command line
    folder : whose calibrations are offered too, or None
    """

    def __init__(self, given: Iterable[Path] = (), folder: Path | None = None) -> None:
        self._lock = threading.Lock()
        self._paths: dict[str, Path] = {}
        self._loaded: dict[str, Calibration] = {}
        self._origins: dict[str, Origin] = {}
        for path in given:
            self.add_file(path)
        for path in sorted(folder.glob("*.npz")) if folder is not None else ():
            if kind_of_npz(path) == KIND:
                self.add_file(path)

    @property
    def names(self) -> list[str]:
        """What the page lists, in the order in which they came."""
        with self._lock:
            return list(dict.fromkeys([*self._paths, *self._loaded]))

    def origin_of(self, name: str) -> Origin:
        """Where the calibration of a name comes from."""
        with self._lock:
            return self._origins[name]

    def add_file(self, path: Path) -> str:
        """Offer a file; gives its name: the file's, with its folder where two are called alike."""
        with self._lock:
            if path.resolve() in (known.resolve() for known in self._paths.values()):
                return next(n for n, known in self._paths.items() if known.resolve() == path.resolve())
            name = self._free(
                path.name if path.name not in self._paths else f"{path.parent.name}/{path.name}"
            )
            self._paths[name] = path
            self._origins[name] = Origin(f"gelform.load_calibration({str(path)!r})", (), path)
            return name

    def add(self, name: str, calibration: Calibration, origin: Origin) -> str:
        """Offer a calibration that has no file of its own; gives the name that it got."""
        with self._lock:
            name = self._free(name)
            self._loaded[name], self._origins[name] = calibration, origin
            return name

    def add_once(self, name: str, calibration: Calibration, origin: Origin) -> str:
        """As `add`, but not where the name is taken by the same calibration already."""
        with self._lock:
            known = self._loaded.get(name)
            if known is None or known.digest != calibration.digest:
                name = self._free(name)
                self._loaded[name], self._origins[name] = calibration, origin
            return name

    def of_serial(self, serial: str | None) -> str | None:
        """The name of the last one on the list that was made with the camera of a serial number; None where none was."""
        for name in reversed(self.names if serial else []):
            try:
                if self[name].serial == serial:
                    return name
            except GelformError:
                continue  # what is wrong with its file is said when it is chosen
        return None

    def __getitem__(self, name: str) -> Calibration:
        """The calibration of a name.

        Raises
        ------
        GelformError
            No such name, or its file cannot be read.
        """
        with self._lock:
            if name in self._loaded:
                return self._loaded[name]
            path = self._paths.get(name)
        if path is None:
            raise GelformError(f"There is no calibration {name!r}. Choose one of the list.")
        calibration = load_calibration(path)
        with self._lock:
            self._loaded[name] = calibration
        return calibration

    def _free(self, name: str) -> str:
        taken = {*self._paths, *self._loaded}
        number = 2
        free = name
        while free in taken:
            free, number = f"{name} ({number})", number + 1
        return free
