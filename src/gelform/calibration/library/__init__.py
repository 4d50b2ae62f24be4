"""The library: the user's calibrations in a folder, those of simulated sensors, and the choice for a source of frames."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from platformdirs import user_cache_path, user_data_path

from gelform import __version__
from gelform.calibration_file import FORMAT_VERSION, Calibration, load_calibration
from gelform.errors import CalibrationError, DataError, GelformError, Progress, cannot, no_progress
from gelform.foundations.files import DIGEST_SHOWN, made_folder, sweep
from gelform.sensors.cameras import Camera, almost, camera_named, cameras_there
from gelform.sensors.files import read_sensor_toml
from gelform.sensors.grabber import Grabber
from gelform.sensors.mcap import is_bag_folder, mcap_file_in, picture_topic_of
from gelform.sensors.mjpeg import shown_address
from gelform.sensors.profiles import PROFILES
from gelform.sensors.record import attached_calibration
from gelform.sensors.simulated import serial_of_simulated, simulated_sensor_named
from gelform.sensors.source import ADDRESSES, DEFAULT_SENSOR, simulated_sensor_of, spec_of
from gelform.simulate import SimulatedPresses, SimulatedSensor, simulate_ball_presses

__all__ = [
    "Choice",
    "Entry",
    "Unit",
    "add_calibration",
    "choose_calibration",
    "entries",
    "library_folder",
    "matching",
    "unit_of",
]

SHIPPED = f"{DEFAULT_SENSOR}.npz"  # made by `benchmarks/live.py --calibration`
FOLDER_VARIABLE = "GELFORM_CALIBRATIONS"


def ready_calibration(sensor: SimulatedSensor, *, progress: Progress = no_progress) -> Calibration:
    """The calibration of a simulated sensor: shipped for the default one, cached, or made in about ten seconds."""
    if sensor == simulated_sensor_named(DEFAULT_SENSOR):
        with resources.as_file(resources.files(__package__) / SHIPPED) as shipped:
            return load_calibration(shipped)
    kept = kept_path(sensor)
    if kept is not None and kept.is_file():
        try:
            return load_calibration(kept)
        except CalibrationError:
            kept.unlink(missing_ok=True)  # damaged; it is gelform's own file, and is made again
    from gelform.calibration.fit import calibrate  # importing it takes longer than the first picture
    from gelform.calibration.presses.press_set import presses_from_simulated

    presses = presses_from_simulated(simulated_presses(sensor, 16, progress=progress))
    # half the time of choosing a model; 0.2 degrees worse than the best model here
    calibration = calibrate(presses, color_model="polynomial", progress=progress)
    if kept is not None:
        calibration.save(kept, overwrite=True)
    return calibration


def kept_path(sensor: SimulatedSensor) -> Path | None:
    """The path of the cached calibration of a sensor; None if the user's cache is not writable."""
    folder, (height, width) = cache_folder(), sensor.shape
    return (
        None
        if folder is None
        else folder / f"{sensor.name}-{height}x{width}-{__version__}-{FORMAT_VERSION}.npz"
    )


def cache_folder(part: str = "") -> Path | None:
    """gelform's folder in the user's cache, or a part of it; None if it is not writable."""
    folder = user_cache_path("gelform", appauthor=False) / part
    if not folder.is_absolute():  # a user without a home folder
        return None
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK) else None


def simulated_presses(
    sensor: SimulatedSensor, count: int, *, progress: Progress = no_progress
) -> SimulatedPresses:
    """Presses of two balls all over the gel, simulated as the live page's objects."""
    rng = np.random.default_rng(11)
    return simulate_ball_presses(
        sensor, ball_diameters_mm=(4.0, 6.0), count=count, rng=rng, oversample=1, progress=progress
    )


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
        one = load_calibration(path)
    except GelformError as problem:
        return Entry(path, str(problem))
    named = one.sensor_name, one.serial, one.gel_id
    return Entry(path, "", *named, one.created_utc, one.digest, dict(one.held_out))


def entries(folder: Path | None = None) -> list[Entry]:
    """All files of the library, the newest calibration first, those that cannot be read last.

    Parameters
    ----------
    folder : folder of the library; the user's by default
    """
    folder = library_folder() if folder is None else folder
    with cannot(f"list {folder}"):
        paths = sorted(folder.glob("*.npz"))
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
    sweep(made_folder(folder))
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
    # only characters that every file system accepts, which allow 255 in all
    plain = [re.sub(r"[^A-Za-z0-9.]+", "-", part).strip("-.")[:40] or "unnamed" for part in parts]
    again = f"_{number}" if number > 1 else ""
    return f"{'_'.join(plain)}_{calibration.digest[:DIGEST_SHOWN]}{again}.npz"


def remove_calibration(entry: Entry) -> None:
    """Delete a file of the library.

    DataError: it cannot be deleted.
    """
    with cannot(f"remove {entry.path}"):
        entry.path.unlink(missing_ok=True)


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


@dataclass(frozen=True)
class Unit:
    """The sensor that gave frames, as far as they identify it.

    Attributes
    ----------
    said : name for messages, such as "camera DIGIT D20123" or "session.mcap"
    serial : serial number of the camera; empty if it has none
    names : names of the sensor, if it has no serial and no other such sensor could be meant
    digest : digest of the calibration that was in use; empty if unknown
    gel_id : gel that was on it; empty if unknown
    carries : the recording that contains a calibration, or None
    simulated : the simulated sensor that it is, or None
    """

    said: str
    serial: str = ""
    names: tuple[str, ...] = ()
    digest: str = ""
    gel_id: str = ""
    carries: Path | None = None
    simulated: SimulatedSensor | None = None

    def is_calibrated_by(self, entry: Entry | Calibration) -> bool:
        """Whether the calibration belongs to this unit and to no other gel."""
        if self.gel_id and entry.gel_id not in (None, self.gel_id):
            return False
        if self.serial:
            return entry.serial == self.serial
        return not entry.serial and entry.sensor_name in self.names


class NoCalibration(CalibrationError):
    """The library has no calibration of a unit."""


@dataclass(frozen=True)
class Choice:
    """A selected calibration, and the message about it."""

    calibration: Calibration
    said: str
    path: Path | None = None


def choose_calibration(unit: Unit, folder: Path | None = None, *, ready: bool = True) -> Choice:
    """The calibration in the recording, else the one that was in use, else the newest one of the unit.

    A unit without a serial uses calibrations without a serial that have its sensor's name. A simulated sensor without any
    uses the one that gelform has ready, or makes in about ten seconds.

    Parameters
    ----------
    unit : see `unit_of`
    folder : folder of the library; the user's by default
    ready : whether a simulated sensor may use the one that gelform has ready

    Raises
    ------
    NoCalibration
        There is none; the message lists the library and says what to do.
    CalibrationError
        The selected one cannot be read.
    """
    if unit.carries is not None:
        carried = attached_calibration(unit.carries)
        if carried is not None:
            gel, made = carried.gel_id or "not named", date_of(carried.created_utc)
            return Choice(carried, f"Calibration of {unit.said}: its own, gel {gel}, of {made}.")
    there = entries(folder)
    of_unit = [one for one in there if unit.is_calibrated_by(one)]
    in_use = [one for one in of_unit if unit.digest and one.digest == unit.digest]
    if not of_unit and ready and unit.simulated is not None:
        return Choice(ready_calibration(unit.simulated), f"Calibration of {unit.said}: gelform's own.")
    if not of_unit:
        raise NoCalibration(
            f"No calibration of {unit.said} {_missing(unit, there)} Give calibration= (--calibration), make one (gelform "
            "live, Calibrate), or add one that you have: gelform calibrations add CAL.npz --serial SERIAL."
        )
    entry = (in_use or of_unit)[0]
    return Choice(
        load_calibration(entry.path),
        f"Calibration of {unit.said}: {described(entry.path.name, entry)}.",
        entry.path,
    )


def _missing(unit: Unit, there: Sequence[Entry]) -> str:
    """The end of a sentence about the reason that the library has none."""
    if not unit.serial and not unit.names:
        return "was given, and nothing says which unit it is of, so none of the library is taken."
    damaged = sum(bool(one.problem) for one in there)
    known = sorted({one.serial for one in there if one.serial})
    gel = f" and gel {unit.gel_id}" if unit.gel_id else ""
    by = f"serial {unit.serial}{gel}" if unit.serial else f"no serial, of a sensor {' or '.join(unit.names)}"
    listed = f"it has calibrations of {', '.join(known)}" if known else "it has none with a serial"
    unread = f"; {damaged} cannot be read (gelform calibrations list)" if damaged else ""
    return f"was given, and the library has none with {by}: {listed}{unread}.{almost(unit.serial, known)}"


def unit_of(source: Any) -> Unit:
    """The sensor of a source; this opens no camera.

    Parameters
    ----------
    source : an argument of `open_source`; an open Source or Grabber; or a function that opens one, which is called to open
        it for a moment

    Raises
    ------
    SensorError, DataError
        There is no such camera, file or folder, or it cannot be read.
    """
    source = spec_of(source)
    if isinstance(source, Grabber):
        return unit_of(source.source)
    if callable(source):
        with source() as opened:
            return unit_of(opened)
    if not isinstance(source, (str, PathLike)):
        camera, serial = getattr(source, "camera", None), getattr(source, "serial", None)
        if isinstance(camera, Camera):
            return unit_of_camera(camera, cameras_there())
        return Unit(getattr(source, "name", "this source"), serial or "")
    spec = str(source)
    try:
        sensor = simulated_sensor_of(spec)
    except ValueError as problem:
        raise DataError(str(problem)) from problem
    if sensor is not None:
        return Unit(f"the simulated sensor {sensor.name}", serial_of_simulated(sensor), simulated=sensor)
    if spec.startswith(ADDRESSES):
        return Unit(shown_address(spec))
    if os.path.exists(spec) and not spec.startswith("/dev/"):
        return unit_of_files(Path(source))
    return unit_of_camera(camera_named(spec), cameras_there())


def unit_named(spec: str) -> Unit:
    """As `unit_of`; a source that is not connected yet may be named by its serial number."""
    try:
        return unit_of(spec)
    except GelformError:
        return Unit(f"camera {shown_address(spec)}", spec)


def unit_of_camera(camera: Camera, cameras: Iterable[Camera]) -> Unit:
    """The unit of a camera; without a serial it has names only if no other of all connected cameras shares one."""
    if camera.serial:
        return Unit(f"camera {camera.name} {camera.serial}", camera.serial)
    alike = [one for one in cameras if set(_names(one)) & set(_names(camera)) and one.path != camera.path]
    if alike:
        return Unit(f"camera {camera.name} ({camera.path}, no serial, one of {len(alike) + 1} of that name)")
    return Unit(f"camera {camera.name} ({camera.path}, no serial)", "", _names(camera))


def _names(camera: Camera) -> tuple[str, ...]:
    """Names of the camera's sensor that a calibration may use: its own, and that of the known sensor."""
    known = PROFILES.get(camera.kind or "")
    return tuple(dict.fromkeys((camera.name, *([known.name] if known else []))))


def unit_of_files(path: Path) -> Unit:
    """The unit of a recording, or of images with a `sensor.toml` in or above their folder; DataError if that is damaged."""
    if path.suffix.lower() == ".mcap" or (path.is_dir() and is_bag_folder(path)):
        facts, _ = picture_topic_of(mcap_file_in(path))
        serial, digest = facts.serial or "", facts.calibration_digest
        return Unit(str(path), serial, digest=digest, carries=path, simulated=_simulated(serial))
    folder = path if path.is_dir() else path.parent
    for place in (folder, folder.parent):  # a press folder has its images in a subfolder
        if (place / "sensor.toml").is_file():
            settings = read_sensor_toml(place / "sensor.toml")
            return Unit(str(place), settings.serial, gel_id=settings.gel_id)
    return Unit(str(path))


def _simulated(serial: str) -> SimulatedSensor | None:
    """The ready-made simulated sensor whose frames have this serial number; None for a camera."""
    try:
        sensor = simulated_sensor_of(serial.replace("-", ":", 1))
    except ValueError:
        return None
    return sensor if sensor is not None and serial_of_simulated(sensor) == serial else None


def unit_of_all(paths: Iterable[Path]) -> Unit:
    """The one unit of files of images, or of recordings; DataError if they are of several."""
    units: dict[tuple[str, ...], Unit] = {}
    apart = (one if one.suffix.lower() == ".mcap" or not one.is_file() else one.parent for one in paths)
    for path in dict.fromkeys(apart):
        unit = unit_of_files(path)
        units.setdefault((unit.serial, unit.gel_id, unit.digest), unit)
    found = list(units.values())
    first, last = found[0], found[-1]
    if len(found) == 1:
        return first
    if len({(unit.serial, unit.gel_id) for unit in found}) > 1:
        both = []
        for unit in (first, last):
            gel = f", gel {unit.gel_id}" if unit.gel_id else ""
            both.append(f"{unit.said} ({unit.serial or 'no serial'}{gel})")
        raise DataError(
            f"Expected frames of one sensor and gel, got {' and '.join(both)}. Do them apart, or give -c CAL.npz."
        )
    return Unit(f"{first.said} ... {last.said}", first.serial, gel_id=first.gel_id)
