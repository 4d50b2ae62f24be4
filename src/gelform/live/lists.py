"""The lists that the page chooses from, by names made here: devices, calibrations, recordings."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from gelform import Calibration, GelformError, load_calibration
from gelform.calibration.library import Unit, is_same
from gelform.calibration_file import is_calibration
from gelform.live.station import Opening, Setup, Station
from gelform.sensors.cameras import Camera, UsbCamera, cameras_in_sysfs
from gelform.sensors.films import films_in
from gelform.sensors.source import Source


def listed_cameras() -> list[Camera]:
    """The connected cameras, if the system lists them; elsewhere each would have to be opened for that."""
    return cameras_in_sysfs() if sys.platform.startswith("linux") else []


class Devices:
    """The connected cameras, and the sources of the hub's stations except recordings.

    A camera's number is assigned at its first appearance, and stays with its USB socket. Pages never send a path.
    `cameras` lists the connected ones, and `open_camera` opens one of them, with settings.
    """

    def __init__(
        self,
        stations: Sequence[Station],
        cameras: Callable[[], Sequence[Camera]] = listed_cameras,
        open_camera: Callable[[Camera, Mapping[str, float | str]], Source] = UsbCamera,
    ) -> None:
        self._stations, self._cameras, self._open_camera = stations, cameras, open_camera
        self._lock, self._showing = threading.Lock(), threading.Lock()
        self._numbers: dict[str, int] = {}
        self._looked_s, self._there = float("-inf"), dict[int, Camera]()

    def cameras(self) -> dict[int, Camera]:
        """The connected cameras by their numbers, searched for at most twice a second."""
        with self._lock:
            if time.monotonic() - self._looked_s > 0.5:
                self._looked_s, numbers = time.monotonic(), self._numbers
                self._there = {numbers.setdefault(_key(one), len(numbers)): one for one in self._cameras()}
            return self._there

    def camera(self, number: int) -> Camera:
        """The camera with a number of the list; GelformError if it is not connected."""
        if (camera := self.cameras().get(number)) is None:
            raise GelformError("That camera is no longer plugged in. Choose another one in the list.")
        return camera

    def show(self, station: Station, camera: Camera, setup: Setup) -> None:
        """Show a camera on a station; if several pages ask at once, the first one gets it.

        GelformError: the camera is already shown, and only one reader can have its pictures.
        """
        with self._showing:
            for other in tuple(self._stations):
                if other.camera is not None and _key(other.camera) == _key(camera):
                    raise GelformError(
                        f"Sensor {other.number + 1} already shows {camera.name}. Any number of pages may show it."
                    )
            wanted: dict[str, float | str] = {}
            opening = Opening(partial(self._open_camera, camera, wanted), camera=camera, wanted=wanted)
            station.show(opening, setup)

    def facts(self) -> list[dict[str, Any]]:
        """The rows of the page's list: the stations' sources, and the connected cameras that no station shows."""
        stations = tuple(self._stations)
        shown_keys = {_key(one.camera) for one in stations if one.camera is not None}
        return [_row_of_station(one) for one in stations if one.player is None] + [
            _row(f"camera {number}", one.name, one.serial, "not shown", camera=number)
            for number, one in self.cameras().items()
            if _key(one) not in shown_keys
        ]


def _row_of_station(station: Station) -> dict[str, Any]:
    key = f"station {station.number}"
    if station.source is None:
        return _row(key, station.spec, None, "missing", station=station.number)
    grabber, stats = station.grabber, station.grabber.stats
    age_ms = None if stats.age_s is None else 1e3 * stats.age_s
    figures = {"rate_hz": stats.rate_hz, "age_ms": age_ms, "lost": station.lost, "skipped": station.skipped}
    return _row(key, grabber.name, grabber.serial, grabber.state, station=station.number, **figures)


def _row(key: str, name: str, serial: str | None, state: str, **known: Any) -> dict[str, Any]:
    """A row of the list; `known` contains its station or its camera, and figures of a station."""
    unknown = dict.fromkeys(("station", "camera", "rate_hz", "age_ms", "lost", "skipped"))
    return {**unknown, "key": key, "name": name, "serial": serial, "state": state, **known}


def _key(camera: Camera) -> str:
    """An identifier that stays with the camera's USB socket, if the system states it."""
    return camera.by_path or camera.path


class Calibrations:
    """Calibrations by name: given files, those of two folders, those made while the page is open."""

    def __init__(
        self, given: Iterable[Path] = (), folder: Path | None = None, library: Path | None = None
    ) -> None:
        self._lock = threading.Lock()
        self._paths: dict[str, Path | None] = {}
        self._loaded: dict[str, Calibration] = {}
        found = [path for place in (folder, library) for path in files_of(place) if path.suffix == ".npz"]
        for path in (*given, *filter(is_calibration, found)):
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
        matches: list[tuple[bool, str, str]] = []
        for name in self.names:
            try:
                calibration = self[name]
            except GelformError:
                continue  # the error of its file is reported when it is chosen
            if unit.is_calibrated_by(calibration):
                in_use = bool(unit.digest) and calibration.digest == unit.digest
                matches.append((in_use, calibration.created_utc, name))
        return max(matches)[2] if matches else None

    def __getitem__(self, name: str) -> Calibration:
        """The calibration with a name; GelformError if the name is unknown, or the file cannot be read."""
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
    """Recordings by name: given files, those of a folder (*.mcap, videos), those made while the page is open."""

    def __init__(self, given: Iterable[Path] = (), folder: Path | None = None) -> None:
        self._lock, self._folder = threading.Lock(), folder
        self._paths: dict[str, Path] = {}
        own = set(files_of(folder))
        found = films_in(folder) if folder is not None else ()
        for path in (*given, *(one for one in found if one in own)):
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
    printable = "".join(one if one.isprintable() else ascii(one)[1:-1] for one in name)
    # A page's message holds 200 letters.
    return printable if len(printable) <= 150 else f"{printable[:75]}...{printable[-75:]}"


def _is_below(path: Path, folder: Path) -> bool:
    return _resolved(folder) in _resolved(path).parents


def _resolved(path: Path) -> Path:
    return Path(os.path.realpath(path))  # a link to itself stays what it is


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
