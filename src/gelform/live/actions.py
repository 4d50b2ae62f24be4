"""The effect of the page's buttons on a station. Calibration is imported when a guide starts, after the first picture."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gelform.calibration.library.library import unit_of_camera
from gelform.depth.solvers import SOLVERS
from gelform.errors import GelformError
from gelform.foundations.findings import Progress
from gelform.image.agreement import check_untouched
from gelform.image.background import USUAL_FRAMES, background_from_frames
from gelform.live import lists
from gelform.live.hub import Hub, starter_of_station, wait_for_frames
from gelform.live.lists import shown_name
from gelform.live.shown import Shown
from gelform.live.station import NEVER_S, MovedSince, Opening, Setup, Station
from gelform.sensors.films import open_film
from gelform.sensors.record import Recorder, attached_background, attached_calibration
from gelform.sensors.record import share as share_file
from gelform.sensors.recordings.mcap_reader import end_missing
from gelform.sensors.recordings.player import Player
from gelform.sensors.streams.memory import zero_from_results
from gelform.sensors.streams.stream import calibration_at_rest

if TYPE_CHECKING:
    from gelform.calibration.guide import Guide

ZERO_FRAMES = 8  # frames that are averaged
NOT_CALIBRATED = "This sensor has no calibration yet. Make one on the page Calibrate."
ON_THEIR_WAY = 4  # frames that a simulated sensor made before it stopped


def take_background(hub: Hub, station: int) -> None:
    """Take the next frames as a new background image."""
    chosen = hub.station(station)
    calibration = chosen.setup.calibration
    if calibration is None:
        raise GelformError(NOT_CALIBRATED)
    if calibration.settings.starter is not None:
        take_starter(hub, station, calibration.settings.starter["sensor"])
        return
    with _at_rest(chosen):
        shown = _frames(chosen, USUAL_FRAMES)
    taken = background_from_frames([one.image for one in shown])
    contacts = [one.result.contact for one in shown if one.result is not None]
    check_untouched(taken.background, calibration.background, np.any(contacts, axis=0) if contacts else None)
    # Whole gray levels, so that the background in a recording is exactly the image in use.
    rest = np.rint(taken.background).astype(np.float32)
    chosen.setup = chosen.setup.taking(calibration, chosen.setup.name, rest)
    hub.notice(_taken_from(len(shown) - len(taken.left_out)))


def _taken_from(frames: int) -> str:
    if frames == 1:
        return "Background taken from one frame, whose noise it keeps. Play the recording to average several."
    return f"Background taken: the average of {frames} frames."


def take_starter(hub: Hub, station: int, sensor: str) -> None:
    """Take the next frames as the gel at rest of an uncalibrated unit; the starter of its make then reads it.

    Parameters
    ----------
    sensor : the starter's name; "": that of the camera's make
    """
    chosen = hub.station(station)
    hub.check_idle(station)
    name = sensor or starter_of_station(chosen)
    if not name:
        raise GelformError("No starter is known for this camera. Choose the sensor in the list.")
    try:
        with _at_rest(chosen):
            frames = [shown.frame for shown in _frames(chosen, USUAL_FRAMES)]
        serial = None if chosen.source is None else chosen.source.serial
        calibration = calibration_at_rest(name, frames, serial, chosen.setup.calibration)
        listed = f"starter {calibration.sensor_name}, sensor {station + 1}"
        chosen.setup = chosen.setup.taking(calibration, listed, calibration.background)
    except GelformError as problem:
        chosen.starter_problem = str(problem)  # the page shows it until the action succeeds
    else:
        chosen.starter_problem = ""
        hub.calibrations.put(listed, calibration)
        if len(frames) == 1:
            hub.notice(_taken_from(1))
    hub.changed()


@contextmanager
def _at_rest(station: Station) -> Iterator[None]:
    """Keep a simulated sensor at rest meanwhile; the user keeps other sensors at rest."""
    source = station.simulated
    if source is None:
        yield
        return
    before = source.resting
    source.rest()
    try:
        wait_for_frames(station, ON_THEIR_WAY)
        yield
    finally:
        source.rest(before)


def undo_background(hub: Hub, station: int) -> None:
    """Use the background before the last one that was taken."""
    chosen = hub.station(station)
    if not chosen.setup.earlier:
        raise GelformError("There is no background to undo. Take one first.")
    setup = chosen.setup = chosen.setup.undone()
    if setup.calibration is not None and setup.calibration.settings.starter is not None:
        hub.calibrations.put(setup.name, setup.calibration)
    hub.notice("Background undone: the one before it is in use again.")


def set_zero(hub: Hub, station: int) -> None:
    """Take the current depth as zero; a second call undoes that."""
    chosen = hub.station(station)
    memory = chosen.setup.memory
    if memory is None:
        raise GelformError(NOT_CALIBRATED)
    if memory.zero is not None:
        memory.zero, said = None, "Zero undone: depth is relative to the gel at rest again."
    else:
        results = [shown.result for shown in _frames(chosen, ZERO_FRAMES) if shown.result and shown.numbers]
        if not results:
            raise GelformError(
                "There is no depth to set as zero, because the frames could not be reconstructed."
            )
        memory.zero, said = zero_from_results(results), "Zero set: depth is relative to the last frames."
    chosen.show_again()
    hub.notice(said)


def use_calibration(hub: Hub, station: int, name: str) -> None:
    """Reconstruct with another calibration of the list."""
    chosen = hub.station(station)
    calibration = hub.calibrations[name]
    setup = chosen.setup.with_calibration(calibration, name)
    if chosen.newest is not None and setup.memory is not None:
        # A calibration that does not fit is refused here, before its use.
        setup.memory.reconstructed(chosen.newest.frame, alone=True)
    chosen.setup = setup
    hub.changed()


def use_solver(hub: Hub, station: int, name: str) -> None:
    """Integrate with another solver."""
    if name not in ("auto", *SOLVERS):
        raise GelformError(f"Expected a solver among auto, {', '.join(SOLVERS)}, got {name!r}.")
    chosen = hub.station(station)
    chosen.setup = chosen.setup.with_solver(name)
    hub.changed()


def follow_motion(hub: Hub, station: int, on: bool) -> None:
    """Follow the touching object from now on, or no more."""
    chosen = hub.station(station)
    chosen.moved = MovedSince() if on else None
    chosen.show_again()
    hub.changed()


def pause(hub: Hub, station: int, paused: bool) -> None:
    """Hold the picture, or continue."""
    hub.station(station).pause(paused)
    hub.changed()


def set_camera(hub: Hub, station: int, name: str, value: float) -> None:
    """Change one setting of the camera and tell all pages its new value."""
    found = lists.set_camera(hub.station(station), name, value)
    hub.notice(
        f"{name.replace('_', ' ').capitalize()} of {hub.station(station).grabber.name}: {found:g}, read back."
    )


def show_camera(hub: Hub, station: int, camera: int) -> None:
    """Show a camera of the list on a station, with its newest calibration if there is one."""
    chosen, found = hub.station(station), hub.devices.camera(camera)
    hub.check_idle(station)
    setup = Setup(solver=chosen.setup.solver)
    name = hub.calibrations.of_unit(unit_of_camera(found, hub.devices.cameras()))
    if name is not None:
        setup = setup.with_calibration(hub.calibrations[name], name)
    hub.devices.show(chosen, found, setup)
    hub.end_guide(station)
    how = f"with its calibration {name}" if name else "without a calibration: none in the list has its serial"
    hub.notice(f"Sensor {station + 1} now shows {found.name}, {how}.")


def press(hub: Hub, station: int, x_px: float, y_px: float) -> None:
    """Press the simulated sensor at a place of the image."""
    simulated = hub.station(station).simulated
    if simulated is None:
        raise GelformError("The page can press only a simulated sensor.")
    simulated.press_at(x_px, y_px)


def record(hub: Hub, station: int, on: bool, page: str = "") -> None:
    """Start or finish recording the camera's frames; a recording ends with the page that started it, if there is one."""
    chosen = hub.station(station)
    if on and chosen.player is not None:
        raise GelformError("This is already a recording. Press Share to make one file of it.")
    if on and station not in hub.recorders:
        begun = hub.recorders[station] = Recorder(
            chosen.grabber,
            hub.folder,
            calibration=chosen.setup.calibration,
            background=chosen.setup.background,
            wanted=lambda: not page or hub.pages.is_open(page),
            on_ended=lambda ended: hub.recorded(station, ended),
        )
        begun.start()
    elif not on and (running := hub.recorders.get(station)) is not None:
        running.close()
        hub.recorded(station, running)
    hub.changed()


def snapshot(hub: Hub, station: int) -> dict[str, Any]:
    """Keep the current frame; the answer has its number and the names of its files."""
    shown = hub.station(station).newest
    if shown is None:
        raise GelformError("There is no frame yet. Wait for the first one.")
    return {"kind": "snapshot", "number": hub.snapshots.add(shown), "files": hub.snapshots.names(shown)}


def _frames(station: Station, count: int) -> Sequence[Shown]:
    """The next frames; of a held recording the current frame."""
    if station.player is not None and not station.player.playing:
        if station.newest is None:
            raise GelformError("There is no frame yet. Wait for the first one.")
        return [station.newest]
    return wait_for_frames(station, count)


def open_recording(hub: Hub, station: int, name: str) -> None:
    """Show a recording of the list on a station; "" returns to the station's first source."""
    chosen = hub.station(station)
    hub.check_idle(station)
    if name:
        path = hub.recordings.path(name)
        bgr = hub.bgr and path.suffix.lower() != ".mcap"  # which states its channels
        recording = open_film(path, bgr=bgr, scan=True)
        if said := end_missing(recording.path):
            hub.notice(said, "warning")
        setup = attached_setup(hub, chosen.setup, recording.path)
        hub.end_guide(station)
        chosen.show(Opening(lambda: Player(recording), NEVER_S), setup)
    else:
        hub.end_guide(station)
        chosen.show_given()
    hub.changed()


def attached_setup(hub: Hub, setup: Setup, path: Path) -> Setup:
    """A setup with the calibration and the background attached to a recording; unchanged if there are none."""
    calibration = attached_calibration(path)
    if calibration is None:
        return setup.with_background(None)  # it belonged to the sensor
    name = hub.calibrations.add(f"{shown_name(path.resolve().name)}: calibration", calibration)
    setup = setup.with_calibration(calibration, name)
    background = attached_background(path)
    return setup if background is None else setup.with_background(background)


def _player_action(tell: Callable[..., None]) -> Callable[..., None]:
    def act(hub: Hub, station: int, *value: Any, **named: Any) -> None:
        tell(player_of(hub.station(station)), *value, *named.values())
        hub.changed()

    return act


play, seek = _player_action(Player.play), _player_action(Player.seek)
step, loop = _player_action(Player.step), _player_action(Player.loop)
speed = _player_action(Player.set_speed)


def share(hub: Hub, station: int) -> None:
    """Write one file with the recording and the current calibration, and add it to the list for download."""
    chosen = hub.station(station)
    recording, setup = player_of(chosen).recording, chosen.setup

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


def player_of(station: Station) -> Player:
    """The player of a station; GelformError if the station shows a sensor."""
    if station.player is None:
        raise GelformError("This is a sensor, not a recording. Open a recording first.")
    return station.player


def guide_start(hub: Hub, station: int, ball_diameter_mm: float, profile: str, mm_per_px: float) -> None:
    """Start a guided calibration, or restart it; a recording starts from its beginning.

    The scale is the profile's, or the given one, or the simulated sensor's own.
    """
    from gelform.calibration.guide import Guide
    from gelform.live.guide import GuideSession

    chosen = hub.station(station)
    if chosen.newest is None or chosen.source is None:
        raise GelformError("There is no frame yet. Connect the sensor first.")
    height, width = chosen.newest.frame.image.shape[:2]
    guide = Guide.of(
        chosen.source,
        (height, width),
        ball_diameter_mm,
        profile=profile,
        mm_per_px=mm_per_px,
        begun=chosen.setup.calibration,
        on_changed=hub.changed,
    )
    hub.end_guide(station)
    hub.guides[station] = GuideSession(chosen, guide)
    if chosen.player is not None:
        chosen.player.loop(False)
        chosen.player.seek(0)
        chosen.player.play()
    hub.changed()


def guide_click(hub: Hub, station: int, x_px: float, y_px: float) -> None:
    """Take the clicked place of the picture as the middle of the press."""
    _guide(hub, station).click(x_px, y_px)


def guide_fit(hub: Hub, station: int) -> None:
    """Calibrate on the accepted presses."""
    guide = _guide(hub, station)
    guide.presses()  # too few presses are reported at once
    hub.start(partial(guide.fit, hub.folder), station, "calibrating")


def guide_use(hub: Hub, station: int) -> None:
    """Reconstruct with the guide's calibration; the guide ends."""
    made = _guide(hub, station).made
    if made is None:
        raise GelformError("There is no calibration to use yet. Press Fit now first.")
    path, kept = made.keep()
    use_calibration(hub, station, hub.calibrations.add_file(path))
    hub.end_guide(station)
    hub.notice(f"The new calibration is in use, and saved as {made.folder.name}/calibration.npz. {kept}")


def guide_more(hub: Hub, station: int) -> None:
    """Go back from the report to the presses."""
    _guide(hub, station).press_more()


def guide_stop(hub: Hub, station: int) -> None:
    """End the guide; a calibration that it made stays in its folder, and nothing uses it."""
    made = hub.guides[station].guide.made if station in hub.guides else None
    hub.end_guide(station)
    if made is not None:
        hub.notice(
            f"The new calibration is not used, here or later. Its presses stay in {made.folder.name}/."
        )


def _guide(hub: Hub, station: int) -> Guide:
    if station not in hub.guides:
        raise GelformError("No calibration is running. Press Start first.")
    return hub.guides[station].guide
