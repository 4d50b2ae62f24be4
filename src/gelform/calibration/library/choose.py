"""Choice of a calibration from the library for a camera, a recording or a folder of images."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from gelform.calibration.library.library import Entry, date_of, entries
from gelform.calibration.library.simulated import ready_calibration
from gelform.calibration_file import Calibration, load_calibration
from gelform.errors import CalibrationError, DataError, GelformError
from gelform.sensors.cameras.camera import Camera, almost, camera_named, cameras_there
from gelform.sensors.files import read_sensor_toml
from gelform.sensors.grabber import Grabber
from gelform.sensors.mjpeg import shown_address
from gelform.sensors.profiles import PROFILES
from gelform.sensors.recordings.mcap_reader import is_bag_folder, mcap_file_in, picture_topic_of
from gelform.sensors.recordings.record import attached_calibration
from gelform.sensors.simulated.source import serial_of_simulated
from gelform.sensors.source import ADDRESSES, simulated_sensor_of
from gelform.simulate import SimulatedSensor

SENSOR_TOML = "sensor.toml"
HOW_TO = (
    "Give calibration= (--calibration), make one (gelform live, Calibrate), or add one that you have: "
    "gelform calibrations add CAL.npz --serial SERIAL."
)


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
            made = date_of(carried.created_utc)
            return Choice(carried, f"Calibration of {unit.said}: its own, gel {_gel(carried)}, of {made}.")
    there = entries(folder)
    of_unit = [one for one in there if unit.is_calibrated_by(one)]
    in_use = [one for one in of_unit if unit.digest and one.digest == unit.digest]
    if not of_unit and ready and unit.simulated is not None:
        return Choice(ready_calibration(unit.simulated), f"Calibration of {unit.said}: gelform's own.")
    if not of_unit:
        raise NoCalibration(f"No calibration of {unit.said} {_missing(unit, there)} {HOW_TO}")
    entry = (in_use or of_unit)[0]
    return Choice(
        load_calibration(entry.path), f"Calibration of {unit.said}: {entry.described()}.", entry.path
    )


def _gel(calibration: Calibration) -> str:
    return calibration.gel_id or "not named"


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
    if not isinstance(source, (str, PathLike)):
        return _unit_of_open(source)
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


def _unit_of_open(source: Any) -> Unit:
    if isinstance(source, Grabber):
        return _unit_of_open(source.source)
    if callable(source):
        with source() as opened:
            return _unit_of_open(opened)
    camera = getattr(source, "camera", None)
    if isinstance(camera, Camera):
        return unit_of_camera(camera, cameras_there())
    serial = getattr(source, "serial", None)
    return Unit(getattr(source, "name", "this source"), serial or "")


def unit_of_camera(camera: Camera, cameras: Iterable[Camera]) -> Unit:
    """The unit of a camera; without a serial it has names only if no other connected camera shares one.

    Parameters
    ----------
    cameras : all connected cameras
    """
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
    """The unit of a recording, or of images with a `sensor.toml` in or above their folder.

    Raises
    ------
    DataError
        The file that names the unit is damaged.
    """
    if path.suffix.lower() == ".mcap" or (path.is_dir() and is_bag_folder(path)):
        facts, _ = picture_topic_of(mcap_file_in(path) if path.is_dir() else path)
        serial, digest = facts.serial or "", facts.calibration_digest
        return Unit(str(path), serial, digest=digest, carries=path, simulated=_simulated(serial))
    folder = path if path.is_dir() else path.parent
    for place in (folder, folder.parent):  # a press folder has its images in a subfolder
        if (place / SENSOR_TOML).is_file():
            settings = read_sensor_toml(place / SENSOR_TOML)
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
    """The one unit of files of images, or of recordings.

    Raises
    ------
    DataError
        They are of several units.
    """
    units: dict[tuple[str, ...], Unit] = {}
    for path in dict.fromkeys(one.parent if one.is_file() and not _is_film(one) else one for one in paths):
        unit = unit_of_files(path)
        units.setdefault((unit.serial, unit.gel_id, unit.digest), unit)
    found = list(units.values())
    first, last = found[0], found[-1]
    if len(found) == 1:
        return first
    if len({(unit.serial, unit.gel_id) for unit in found}) > 1:
        both = " and ".join(f"{unit.said} ({_named(unit)})" for unit in (first, last))
        raise DataError(
            f"Expected frames of one sensor and gel, got {both}. Do them apart, or give -c CAL.npz."
        )
    return Unit(f"{first.said} ... {last.said}", first.serial, gel_id=first.gel_id)


def _named(unit: Unit) -> str:
    return (unit.serial or "no serial") + (f", gel {unit.gel_id}" if unit.gel_id else "")


def _is_film(path: Path) -> bool:
    return path.suffix.lower() == ".mcap"
