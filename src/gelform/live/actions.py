"""What the command line's arguments and the page's buttons do to stations."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gelform import DataError, GelformError, SensorError, background_from_frames, measure, open_source
from gelform.calibration.library import (
    described,
    library_folder,
    ready_calibration,
    unit_named,
    unit_of_camera,
)
from gelform.errors import Progress, counted
from gelform.image.background import USUAL_FRAMES
from gelform.live.hub import GuideSession, Hub, starter_of_station
from gelform.live.lists import Calibrations, Recordings, shown_name
from gelform.live.shown import ShownFrame
from gelform.live.station import SETTABLE, MovedSince, Opening, Setup, Station
from gelform.sensors.containers import is_data_set
from gelform.sensors.films import is_film, open_film
from gelform.sensors.mcap import end_missing
from gelform.sensors.mjpeg import shown_address
from gelform.sensors.playback import Player
from gelform.sensors.profiles import PROFILES
from gelform.sensors.record import Recorder, attached_background, attached_calibration
from gelform.sensors.record import share as share_file
from gelform.sensors.simulated import RATE_HZ, SimulatedSource
from gelform.sensors.source import Source, device_of, simulated_sensor_of
from gelform.sensors.streams.memory import zero_from_results
from gelform.sensors.streams.stream import calibration_at_rest
from gelform.simulate import SimulatedSensor

if TYPE_CHECKING:
    from gelform.calibration.guide import Guide

NOT_CALIBRATED = "This sensor has no calibration yet. Make one on the page Calibrate."


def take_background(hub: Hub, station: Station) -> None:
    """Take the next frames as a new background image."""
    calibration = station.setup.calibration
    if calibration is None:
        raise GelformError(NOT_CALIBRATED)
    if calibration.settings.starter is not None:
        take_starter(hub, station, calibration.settings.starter["sensor"])
        return
    frames = _frames_at_rest(station)
    taken = background_from_frames([one.image for one in frames], untouched=calibration.background)
    # Whole gray levels, so that the background in a recording is exactly the image in use.
    rest = np.rint(taken.background).astype(np.float32)
    station.setup = station.setup.taking(calibration, station.setup.name, rest)
    doubt = "" if taken.touch is None else f" {taken.touch.message} Undo goes back."
    hub.notice(_taken_from(len(frames) - len(taken.left_out)) + doubt)


def _taken_from(frames: int) -> str:
    if frames == 1:
        return "Background taken from one frame, whose noise it keeps. Play the recording to average several."
    return f"Background taken: the average of {counted(frames, 'frame')}."


def take_starter(hub: Hub, station: Station, sensor: str) -> None:
    """Take the next frames as the gel at rest of an uncalibrated unit; the starter of its make then reads it.

    `sensor` is the starter's name; "" means that of the camera's make.
    """
    hub.check_idle(station)
    name = sensor or starter_of_station(station)
    if not name:
        raise GelformError("No starter is known for this camera. Choose the sensor in the list.")
    try:
        frames = [shown.frame for shown in _frames_at_rest(station)]
        serial = None if station.source is None else station.source.serial
        calibration = calibration_at_rest(name, frames, serial, station.setup.calibration)
        listed = f"starter {calibration.sensor_name}, sensor {station.number + 1}"
        station.setup = station.setup.taking(calibration, listed, calibration.background)
    except GelformError as problem:
        station.starter_problem = str(problem)  # the page shows it until the action succeeds
    else:
        station.starter_problem = ""
        hub.calibrations.put(listed, calibration)
        if len(frames) == 1:
            hub.notice(_taken_from(1))


def _frames_at_rest(station: Station) -> list[ShownFrame]:
    """The next frames for a background; a simulated sensor rests meanwhile, and the user keeps others at rest."""
    source = station.simulated
    if source is None:
        return station.next_frames(USUAL_FRAMES)
    before = source.resting
    source.rest()
    try:
        station.next_frames(4)  # that it made before it stopped
        return station.next_frames(USUAL_FRAMES)
    finally:
        source.rest(before)


def undo_background(hub: Hub, station: Station) -> None:
    """Use the background before the last one that was taken."""
    if not station.setup.earlier:
        raise GelformError("There is no background to undo. Take one first.")
    setup = station.setup = station.setup.undone()
    if setup.calibration is not None and setup.calibration.settings.starter is not None:
        hub.calibrations.put(setup.name, setup.calibration)
    hub.notice("Background undone: the one before it is in use again.")


def set_zero(hub: Hub, station: Station) -> None:
    """Take the current depth as zero; a second call undoes that."""
    memory = station.setup.memory
    if memory is None:
        raise GelformError(NOT_CALIBRATED)
    if memory.zero is not None:
        memory.zero, said = None, "Zero undone: depth is relative to the gel at rest again."
    else:
        results = [shown.result for shown in station.next_frames(8) if shown.result and shown.numbers]
        if not results:
            raise GelformError(
                "There is no depth to set as zero, because the frames could not be reconstructed."
            )
        memory.zero, said = zero_from_results(results), "Zero set: depth is relative to the last frames."
    station.show_again()
    hub.notice(said)


def use_calibration(hub: Hub, station: Station, name: str) -> None:
    """Reconstruct with another calibration of the list."""
    setup = Setup(hub.calibrations[name], name)
    if station.newest is not None and setup.memory is not None:
        # A calibration that does not fit is refused here, before its use.
        setup.memory.reconstructed(station.newest.frame, alone=True)
    station.setup = setup


def follow_motion(hub: Hub, station: Station, on: bool) -> None:
    """Follow the touching object from now on, or no more."""
    station.moved = MovedSince() if on else None
    station.show_again()


def pause(hub: Hub, station: Station, paused: bool) -> None:
    """Hold the picture, or continue."""
    station.pause(paused)


def set_camera(hub: Hub, station: Station, name: str, value: float) -> None:
    """Change one setting of the camera and tell all pages its new value. It is set again when the camera is reopened.

    GelformError: the source has no settings, the setting does not exist, or the camera rejects the value.
    """
    source: Any = station.source
    if not hasattr(source, "set_controls"):
        what = station.spec if source is None else source.name
        raise GelformError(
            f"{what} has no settings that the page can change. Only a USB camera of this machine has."
        )
    if name not in SETTABLE:
        raise GelformError(f"Expected a setting among {', '.join(SETTABLE)}.")
    value_set = float(source.set_controls({name: value})[name])
    station.opening.wanted[name] = value
    hub.notice(f"{name.replace('_', ' ').capitalize()} of {station.grabber.name}: {value_set:g}, read back.")


def show_camera(hub: Hub, station: Station, camera: int) -> None:
    """Show a camera of the list on a station, with its newest calibration if there is one."""
    device = hub.devices.camera(camera)
    hub.check_idle(station)
    setup = Setup()
    name = hub.calibrations.of_unit(unit_of_camera(device, hub.devices.cameras().values()))
    if name is not None:
        setup = Setup(hub.calibrations[name], name)
    hub.devices.show(station, device, setup)
    hub.end_guide(station)
    how = f"with its calibration {name}" if name else "without a calibration: none in the list has its serial"
    hub.notice(f"Sensor {station.number + 1} now shows {device.name}, {how}.")


def press(hub: Hub, station: Station, x_px: float, y_px: float) -> None:
    """Press the simulated sensor at a place of the image."""
    if station.simulated is None:
        raise GelformError("The page can press only a simulated sensor.")
    station.simulated.press_at(x_px, y_px)


def record(hub: Hub, station: Station, on: bool, page: str = "") -> None:
    """Start or finish recording the camera's frames; a recording ends with the page that started it, if there is one."""
    running = hub.recorders.get(station.number)
    if on and station.player is not None:
        raise GelformError("This is already a recording. Press Share to make one file of it.")
    if on and running is None:
        begun = hub.recorders[station.number] = Recorder(
            station.grabber,
            hub.folder,
            calibration=station.setup.calibration,
            background=station.setup.background,
            wanted=lambda: not page or hub.pages.is_open(page),
            on_ended=lambda ended: hub.recorded(station, ended),
        )
        begun.start()
    elif not on and running is not None:
        running.close()
        hub.recorded(station, running)


def snapshot(hub: Hub, station: Station) -> dict[str, Any]:
    """Keep the current frame; the answer has its number and the names of its files."""
    shown = station.current
    return {"kind": "snapshot", "number": hub.snapshots.add(shown), "files": hub.snapshots.names(shown)}


def measure_line(hub: Hub, station: Station, ends_px: list[float]) -> dict[str, Any]:
    """Measure along a line of the current frame; the answer has the figures in words, as `gelform measure` says them."""
    result = station.current.result
    if result is None:
        raise GelformError("This frame has no depth to measure. Choose a calibration.")
    found = measure(result, lines=[ends_px]).quantities
    doubts = dict.fromkeys(said for one in found for said in one.doubts)
    return {
        "kind": "measured",
        "ends_px": ends_px,
        "text": " ".join([", ".join(map(str, found)) + ".", *doubts]),
    }


def open_recording(hub: Hub, station: Station, name: str) -> None:
    """Show a recording of the list on a station; "" returns to the station's first source."""
    hub.check_idle(station)
    if name:
        path = hub.recordings.path(name)
        bgr = hub.bgr and path.suffix.lower() != ".mcap"  # which states its channels
        recording = open_film(path, bgr=bgr, dataset=hub.dataset * is_data_set(path), scan=True)
        if said := end_missing(recording.path):
            hub.notice(said, "warning")
        setup = attached_setup(hub, station.setup, recording.path)
        hub.end_guide(station)
        station.show(Opening(partial(Player, recording), math.inf), setup)
    else:
        hub.end_guide(station)
        station.show_first()


def attached_setup(hub: Hub, setup: Setup, path: Path) -> Setup:
    """A setup with the calibration and the background attached to a recording; without them the one that was given."""
    calibration = attached_calibration(path)
    if calibration is None:
        return replace(setup, background=None)  # it belonged to the sensor
    name = hub.calibrations.add(f"{shown_name(path.resolve().name)}: calibration", calibration)
    return Setup(calibration, name, attached_background(path))


def on_player(tell: Callable[..., None]) -> Callable[..., None]:
    """The action that tells the player of a station's recording what a button says."""
    return lambda hub, station, **said: tell(_player(station), *said.values())


def share(hub: Hub, station: Station) -> None:
    """Write one file with the recording and the current calibration, and add it to the list for download."""
    recording, setup = _player(station).recording, station.setup

    def work(progress: Progress) -> None:
        path = share_file(
            recording,
            hub.folder,
            calibration=setup.calibration,
            background=setup.background,
            progress=progress,
        )
        name = hub.recordings.add(path)
        hub.notice(f"{name} is ready to share, with its calibration. Download it from the list Recordings.")

    hub.start(work, station, "one file to share")


def _player(station: Station) -> Player:
    """The player of a station; GelformError if the station shows a sensor."""
    if station.player is None:
        raise GelformError("This is a sensor, not a recording. Open a recording first.")
    return station.player


def guide_start(hub: Hub, station: Station, ball_diameter_mm: float, profile: str, mm_per_px: float) -> None:
    """Start a guided calibration, or restart it; a recording starts from its beginning.

    The scale is the profile's, or the given one, or the simulated sensor's own.
    """
    from gelform.calibration.guide import Guide

    if station.newest is None or station.source is None:
        raise GelformError("There is no frame yet. Connect the sensor first.")
    height, width = station.newest.frame.image.shape[:2]
    guide = Guide.of(
        station.source,
        (height, width),
        ball_diameter_mm,
        profile=profile,
        mm_per_px=mm_per_px,
        begun=station.setup.calibration,
        on_changed=hub.changed,
    )
    hub.end_guide(station)
    hub.guides[station.number] = GuideSession(hub, station, guide)
    if station.player is not None:
        station.player.loop(False)
        station.player.seek(0)
        station.player.play()


def guide_click(hub: Hub, station: Station, x_px: float, y_px: float) -> None:
    """Take the clicked place of the picture as the middle of the press."""
    _guide(hub, station).click(x_px, y_px)


def guide_fit(hub: Hub, station: Station) -> None:
    """Calibrate on the accepted presses."""
    guide = _guide(hub, station)
    guide.presses()  # too few presses are reported at once
    hub.start(partial(guide.fit, hub.folder), station, "calibrating")


def guide_use(hub: Hub, station: Station) -> None:
    """Reconstruct with the guide's calibration; the guide ends."""
    made = _guide(hub, station).made
    if made is None:
        raise GelformError("There is no calibration to use yet. Press Fit now first.")
    path, kept = made.keep()
    use_calibration(hub, station, hub.calibrations.add_file(path))
    hub.end_guide(station)
    hub.notice(f"The new calibration is in use, and saved as {made.folder.name}/calibration.npz. {kept}")


def guide_more(hub: Hub, station: Station) -> None:
    """Go back from the report to the presses."""
    _guide(hub, station).press_more()


def guide_stop(hub: Hub, station: Station) -> None:
    """End the guide; a calibration that it made stays in its folder, and nothing uses it."""
    session = hub.guides.get(station.number)
    hub.end_guide(station)
    if session is not None and (made := session.guide.made) is not None:
        hub.notice(
            f"The new calibration is not used, here or later. Its presses stay in {made.folder.name}/."
        )


def _guide(hub: Hub, station: Station) -> Guide:
    if station.number not in hub.guides:
        raise GelformError("No calibration is running. Press Start first.")
    return hub.guides[station.number].guide


def start(
    sources: Sequence[str] = ("simulated",),
    calibrations: Sequence[Path] = (),
    folder: Path | None = None,
    rate_hz: float = RATE_HZ,
    sensor: str | None = None,
    bgr: bool = False,
    dataset: str = "",
) -> Hub:
    """Open the sources and reconstruct; wait for cameras that are not connected yet.

    `sources` are "simulated", serial numbers, names, paths ...; `calibrations` are files, one for all sources or one for
    each. `folder` has more calibrations and recordings, and gets the new ones. `rate_hz` is that of simulated sensors.
    `sensor` is the make whose starter is used without a calibration, by default that of the camera. `bgr` says that frames
    of cameras and files are blue, green, red, `dataset` where they are in data sets.

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
        dataset=dataset,
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
        camera, address = device_of(spec), shown_address(spec)
        if camera in named:
            both = f"{address!r} twice" if named[camera] == address else f"{named[camera]!r} and {address!r}"
            raise DataError(
                f"Expected each camera once, got {both}, which is one camera. Any number of pages may show it."
            )
        named[camera] = address


def _show(hub: Hub, number: int, spec: str, name: str, rate_hz: float, make: str) -> None:
    """Show a source, with the calibration of that name, or the one that it has or is known by; else only its images."""
    sensor, recording = simulated_sensor_of(spec), None
    if sensor is not None:
        source = partial(SimulatedSource, sensor, rate_hz=rate_hz, seed=number)
        opening = Opening(source, 10.0)  # a busy machine simulates late although nothing was unplugged
    elif is_film(spec):
        recording = open_film(Path(spec), bgr=hub.bgr, dataset=hub.dataset, scan=True)
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
        station.setup = attached_setup(hub, station.setup, recording.path)
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
        opened.append(open_source(spec, paced=True, bgr=hub.bgr, dataset=hub.dataset))
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
        use_calibration(hub, station, name)
