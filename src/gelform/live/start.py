"""From the command line's arguments to a hub with running stations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from gelform.calibration.library.library import library_folder, ready_calibration, unit_named
from gelform.errors import DataError, SensorError
from gelform.foundations.findings import Progress
from gelform.live import actions
from gelform.live.hub import Hub
from gelform.live.lists import Calibrations, Recordings
from gelform.live.station import NEVER_S, Opening, Station
from gelform.sensors.films import is_film, open_film
from gelform.sensors.grabber import STALL_S
from gelform.sensors.mjpeg import shown_address
from gelform.sensors.playback import Film
from gelform.sensors.profiles import PROFILES
from gelform.sensors.recordings.mcap_reader import end_missing
from gelform.sensors.recordings.player import Player
from gelform.sensors.simulated import RATE_HZ, SimulatedSource
from gelform.sensors.source import Source, device_of, open_source, simulated_sensor_of
from gelform.simulate import SimulatedSensor

READY = "simulated sensor"
LONGEST_TURN_S = 60.0  # s that the finished calibration waits for an action of a page
SIMULATED_STALL_S = 10.0  # s; a busy machine simulates late although nothing was unplugged


@dataclass(frozen=True)
class Options:
    """The options of `gelform live`.

    Attributes
    ----------
    sources : "simulated", serial numbers, names, paths ...
    calibrations : files, one for all sources or one for each
    folder : its calibrations are offered too
    rate_hz : frames per second of simulated sensors
    sensor : the make whose starter is used for sources without a calibration; None: that of the camera
    bgr : whether frames of cameras and files are blue, green, red
    """

    sources: Sequence[str] = ("simulated",)
    calibrations: Sequence[Path] = ()
    folder: Path | None = None
    rate_hz: float = RATE_HZ
    sensor: str | None = None
    bgr: bool = False


def start(options: Options) -> Hub:
    """Open the sources and reconstruct; wait for cameras that are not connected yet.

    Raises
    ------
    DataError
        Several calibrations, but not one for each source; a missing file; a camera named twice.
    CalibrationError
        A calibration cannot be read.
    """
    if len(options.calibrations) not in (0, 1, len(options.sources)):
        raise DataError(
            f"Expected one calibration for all sources or one for each of the {len(options.sources)}, "
            f"got {len(options.calibrations)}."
        )
    _check_named_once(options.sources)
    given = [Path(spec) for spec in options.sources if is_film(spec)]
    library, problem = _library()
    hub = Hub(
        calibrations=Calibrations(options.calibrations, options.folder, library),
        recordings=Recordings(given, options.folder),
        folder=options.folder or Path("."),
        bgr=options.bgr,
    )
    if problem:
        hub.notice(problem, "warning")
    names = [hub.calibrations.add_file(path) for path in options.calibrations]
    for name in names:
        hub.calibrations[name]  # an unreadable one is reported before anything opens
    for number, spec in enumerate(options.sources):
        sensor = simulated_sensor_of(spec)
        is_recorded = sensor is None and is_film(spec)
        recording = open_film(Path(spec), bgr=options.bgr, scan=True) if is_recorded else None
        opening = _opening(hub, spec, sensor or recording, options, number)
        station = Station(number, shown_address(spec), opening, hub.changed, hub.watched)
        station.sensor = options.sensor or ""
        if recording is not None and (said := end_missing(recording.path)):
            hub.notice(said, "warning")
        hub.stations.append(station)
        if names:
            name = names[number % len(names)]
            station.setup = station.setup.with_calibration(hub.calibrations[name], name)
        elif recording is not None:
            station.setup = actions.attached_setup(hub, station.setup, recording.path)
        if not names and station.setup.calibration is None:
            _take_known(hub, station, spec)
        station.start()
        if sensor is not None and station.setup.calibration is None and not options.sensor:
            hub.start(_made_ready(hub, number, sensor), number, "calibrating the simulated sensor")
    return hub


def _library() -> tuple[Path | None, str]:
    """The library's folder, or None and the reason; the page works without one."""
    try:
        return library_folder(), ""
    except DataError as problem:
        return None, str(problem)


def _take_known(hub: Hub, station: Station, spec: str) -> None:
    """Use the newest listed calibration of the source's unit; without one the station shows only images."""
    unit = unit_named(spec)
    name = hub.calibrations.of_unit(unit)
    if name is not None:
        station.setup = station.setup.with_calibration(hub.calibrations[name], name)
        hub.notice(f"Calibration of {unit.said}: {hub.calibrations.described(name)}.")


def _check_named_once(specs: Sequence[str]) -> None:
    """Refuse a camera that is named twice, even by two names. A recording may be named twice."""
    named: dict[str, str] = {}
    for spec in specs:
        if simulated_sensor_of(spec) or is_film(spec):
            continue
        camera = device_of(spec)
        if camera in named:
            shown = shown_address(spec)
            both = f"{shown!r} twice" if named[camera] == shown else f"{named[camera]!r} and {shown!r}"
            raise DataError(
                f"Expected each camera once, got {both}, which is one camera. Any number of pages may show it."
            )
        named[camera] = shown_address(spec)


def _opening(
    hub: Hub, spec: str, known: SimulatedSensor | Film | None, options: Options, number: int
) -> Opening:
    """How to open the source. It is opened once now, so that a mistake is also reported in the terminal."""
    if isinstance(known, Film):
        return Opening(partial(Player, known, may_begin=hub.watched), NEVER_S)
    if known is not None:
        return Opening(
            lambda: SimulatedSource(known, rate_hz=options.rate_hz, seed=number), SIMULATED_STALL_S
        )
    wanted: dict[str, float | str] = {}
    opened: list[Source] = []
    try:
        opened.append(open_source(spec, paced=True, bgr=options.bgr))
    except SensorError as problem:
        if not _may_be_camera(hub, spec):
            raise DataError(
                f"No camera, file or folder {shown_address(spec)}. Check the path, or plug the camera in. Only a serial "
                "number, an address or a device is waited for."
            ) from problem
        hub.notice(f"{problem} gelform tries again every second.", "warning")
    return Opening(
        lambda: opened.pop() if opened else open_source(spec, paced=True, settings=wanted, bgr=options.bgr),
        STALL_S,
        None,
        wanted,
    )


def _may_be_camera(hub: Hub, spec: str) -> bool:
    """Whether a source that is not there may come: an address, a device, a make, a serial number, or a known unit's name."""
    is_serial = spec == spec.upper() and any(one.isdigit() for one in spec)
    if is_serial or "://" in spec or spec.startswith("/dev/") or spec in ("", *PROFILES):
        return True
    return hub.calibrations.of_unit(unit_named(spec)) is not None


def _made_ready(hub: Hub, number: int, sensor: SimulatedSensor) -> Callable[[Progress], None]:
    def work(progress: Progress) -> None:
        calibration = ready_calibration(sensor, progress=progress)
        name = hub.calibrations.add(f"{READY} {sensor.name}", calibration)
        with hub.turn(number, LONGEST_TURN_S):
            actions.use_calibration(hub, number, name)

    return work
