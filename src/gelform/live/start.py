"""From the command line's arguments to a hub with running stations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from gelform import DataError, SensorError, open_source
from gelform.calibration.library import described, library_folder, ready_calibration, unit_named
from gelform.foundations.findings import Progress
from gelform.live import actions
from gelform.live.hub import Hub
from gelform.live.lists import Calibrations, Recordings
from gelform.live.station import Opening, Setup, Station
from gelform.sensors.films import is_film, open_film
from gelform.sensors.mjpeg import shown_address
from gelform.sensors.profiles import PROFILES
from gelform.sensors.recordings.mcap_reader import end_missing
from gelform.sensors.recordings.player import Player
from gelform.sensors.simulated import RATE_HZ, SimulatedSource
from gelform.sensors.source import Source, device_of, simulated_sensor_of
from gelform.simulate import SimulatedSensor


def start(
    sources: Sequence[str] = ("simulated",),
    calibrations: Sequence[Path] = (),
    folder: Path | None = None,
    rate_hz: float = RATE_HZ,
    sensor: str | None = None,
    bgr: bool = False,
) -> Hub:
    """Open the sources and reconstruct; wait for cameras that are not connected yet.

    `sources` are "simulated", serial numbers, names, paths ...; `calibrations` are files, one for all sources or one for
    each. `folder` has more calibrations and recordings, and gets the new ones. `rate_hz` is that of simulated sensors.
    `sensor` is the make whose starter is used without a calibration, by default that of the camera. `bgr` says that frames
    of cameras and files are blue, green, red.

    DataError: several calibrations, but not one for each source; a missing file; a camera named twice. CalibrationError:
    a calibration cannot be read.
    """
    if len(calibrations) not in (0, 1, len(sources)):
        raise DataError(
            f"Expected one calibration for all sources or one for each of the {len(sources)}, "
            f"got {len(calibrations)}."
        )
    _check_named_once(sources)
    library, problem = None, ""
    try:
        library = library_folder()
    except DataError as said:  # the page works without a library
        problem = str(said)
    given = [Path(spec) for spec in sources if is_film(spec)]
    hub = Hub(
        calibrations=Calibrations(calibrations, folder, library),
        recordings=Recordings(given, folder),
        folder=folder or Path("."),
        bgr=bgr,
    )
    if problem:
        hub.notice(problem, "warning")
    names = [hub.calibrations.add_file(path) for path in calibrations]
    for name in names:
        hub.calibrations[name]  # an unreadable one is reported before anything opens
    for number, spec in enumerate(sources):
        name = names[number % len(names)] if names else ""
        _show(hub, number, spec, name, rate_hz, sensor or "")
    return hub


def _check_named_once(specs: Sequence[str]) -> None:
    """Refuse a camera that is named twice, even by two names. A recording may be named twice."""
    named: dict[str, str] = {}
    for spec in specs:
        if simulated_sensor_of(spec) or is_film(spec):
            continue
        camera, shown = device_of(spec), shown_address(spec)
        if camera in named:
            both = f"{shown!r} twice" if named[camera] == shown else f"{named[camera]!r} and {shown!r}"
            raise DataError(
                f"Expected each camera once, got {both}, which is one camera. Any number of pages may show it."
            )
        named[camera] = shown


def _show(hub: Hub, number: int, spec: str, name: str, rate_hz: float, make: str) -> None:
    """Show a source, with the calibration of that name, or the one that it has or is known by; else only its images."""
    sensor, recording = simulated_sensor_of(spec), None
    if sensor is not None:
        source = partial(SimulatedSource, sensor, rate_hz=rate_hz, seed=number)
        opening = Opening(source, 10.0)  # a busy machine simulates late although nothing was unplugged
    elif is_film(spec):
        recording = open_film(Path(spec), bgr=hub.bgr, scan=True)
        opening = Opening(partial(Player, recording, may_begin=hub.watched), math.inf)
        if said := end_missing(recording.path):
            hub.notice(said, "warning")
    else:
        opening = _opening_of_camera(hub, spec)
    station = Station(number, shown_address(spec), opening, hub.changed, hub.watched)
    station.sensor = make
    hub.stations.append(station)
    if name:
        station.setup = Setup(hub.calibrations[name], name)
    elif recording is not None:
        station.setup = actions.attached_setup(hub, station.setup, recording.path)
    if station.setup.calibration is None:
        unit = unit_named(spec)
        if (known := hub.calibrations.of_unit(unit)) is not None:
            station.setup = Setup(hub.calibrations[known], known)
            hub.notice(f"Calibration of {unit.said}: {described(known, hub.calibrations[known])}.")
    station.start()
    if sensor is not None and station.setup.calibration is None and not make:
        hub.start(partial(_make_ready, hub, station, sensor), station, "calibrating the simulated sensor")


def _opening_of_camera(hub: Hub, spec: str) -> Opening:
    """How to open a camera. It is opened once now, so that a mistake is also reported in the terminal."""
    wanted: dict[str, float | str] = {}
    opened: list[Source] = []
    try:
        opened.append(open_source(spec, paced=True, bgr=hub.bgr))
    except SensorError as problem:
        if not _may_be_camera(hub, spec):
            raise DataError(
                f"No camera, file or folder {shown_address(spec)}. Check the path, or plug the camera in. Only a serial "
                "number, an address or a device is waited for."
            ) from problem
        hub.notice(f"{problem} gelform tries again every second.", "warning")
    return Opening(
        lambda: opened.pop() if opened else open_source(spec, paced=True, settings=wanted, bgr=hub.bgr),
        wanted=wanted,
    )


def _may_be_camera(hub: Hub, spec: str) -> bool:
    """Whether a source that is not there may come: an address, a device, a make, a serial number, or a known unit's name."""
    is_serial = spec == spec.upper() and any(one.isdigit() for one in spec)
    if is_serial or "://" in spec or spec.startswith("/dev/") or spec in ("", *PROFILES):
        return True
    return hub.calibrations.of_unit(unit_named(spec)) is not None


def _make_ready(hub: Hub, station: Station, sensor: SimulatedSensor, progress: Progress) -> None:
    """Calibrate a simulated sensor, and use that; an action of a page may keep it waiting for a minute."""
    calibration = ready_calibration(sensor, progress=progress)
    name = hub.calibrations.add(f"simulated sensor {sensor.name}", calibration)
    with hub.turn(station.number, 60.0):
        actions.use_calibration(hub, station, name)
