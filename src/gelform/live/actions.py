"""What the page's buttons do to a station."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from gelform.background.average import background_from_frames
from gelform.errors import GelformError
from gelform.live import devices
from gelform.live.hub import Hub, wait_for_frames
from gelform.live.replay.player import Player, ReplayedFrame
from gelform.live.setup import Setup
from gelform.live.station import Station
from gelform.live.take.code import Situation, code_of
from gelform.live.take.recorder import Recorder
from gelform.solvers import SOLVERS

BACKGROUND_FRAMES, ZERO_FRAMES = 15, 8


def take_background(hub: Hub, station: int) -> None:
    """Take the next frames as the untouched gel of today."""
    chosen = hub.station(station)
    _check_calibrated(chosen.setup.calibration)
    images = [shown.image for shown in _frames(chosen, BACKGROUND_FRAMES)]
    taken = background_from_frames(images)
    # In whole grey levels: what the file background.png of a snapshot or a recording holds is what was used.
    chosen.setup = chosen.setup.with_background(np.rint(taken.background).astype(np.float32))
    hub.notice(f"Background taken: the average of {len(images) - len(taken.left_out)} frames.")


def own_background(hub: Hub, station: int) -> None:
    """Use the calibration's own background again."""
    chosen = hub.station(station)
    chosen.setup = chosen.setup.with_background(None)


def set_zero(hub: Hub, station: int) -> None:
    """Take the depth of now as zero; a second time takes that back."""
    chosen = hub.station(station)
    _check_calibrated(chosen.setup.calibration)
    if chosen.setup.zero_mm is not None:
        chosen.setup = replace(chosen.setup, zero_mm=None)
        hub.notice("Zero is the untouched gel again.")
        return
    results = [shown.result for shown in _frames(chosen, ZERO_FRAMES) if shown.result is not None]
    if not results:
        raise GelformError("There is no depth to set as zero: the frames could not be reconstructed.")
    mean = np.mean([result.depth for result in results], axis=0).astype(np.float32)
    chosen.setup = replace(chosen.setup, zero_mm=mean)
    hub.notice("Zero set: depth is shown against what was there just now.")


def use_calibration(hub: Hub, station: int, name: str) -> None:
    """Reconstruct with another calibration of the list."""
    chosen = hub.station(station)
    calibration = hub.calibrations[name]
    setup = chosen.setup.with_calibration(calibration, name)
    newest = chosen.newest
    if newest is not None:
        setup.result_of(
            newest.frame, setup.image_of(newest.frame)
        )  # one that does not fit is refused, not used
    chosen.setup = setup
    hub.changed()


def compare_with(hub: Hub, station: int, name: str) -> None:
    """Show the depth by a second calibration beside the first; "" shows the first alone."""
    chosen = hub.station(station)
    other = hub.calibrations[name] if name else None
    chosen.setup = chosen.setup.with_other(other, name)
    hub.changed()


def use_solver(hub: Hub, station: int, name: str) -> None:
    """Integrate with another solver."""
    if name not in ("auto", *SOLVERS):
        raise GelformError(f"Expected a solver among auto, {', '.join(SOLVERS)}, got {name!r}.")
    chosen = hub.station(station)
    chosen.setup = chosen.setup.with_solver(name)
    hub.changed()


def pause(hub: Hub, station: int, paused: bool) -> None:
    """Hold the picture, or let it go on."""
    chosen = hub.station(station)
    if isinstance(chosen.source, Player):
        chosen.source.play(not paused)
    else:
        chosen.paused = paused
    hub.changed()


def set_camera(hub: Hub, station: int, name: str, value: float) -> None:
    """Change one setting of the camera; everybody is told what it has now."""
    found = devices.set_camera(hub.station(station), name, value)
    hub.notice(
        f"{name.replace('_', ' ').capitalize()} of {hub.station(station).grabber.name}: {found:g}, read back."
    )


def show_camera(hub: Hub, station: int, camera: int) -> None:
    """Show a camera of the list in place of what a station shows, with the calibration of its serial if there is one."""
    chosen, found = hub.station(station), hub.devices.camera(camera)
    hub.check_idle(station)
    setup, name = Setup(solver=chosen.setup.solver), hub.calibrations.of_serial(found.serial)
    if name is not None:
        setup = setup.with_calibration(hub.calibrations[name], name)
    hub.devices.show(chosen, found, setup)
    hub.end_guide(station)
    how = f"with its calibration {name}" if name else "without a calibration: none on the list has its serial"
    hub.notice(f"Sensor {station + 1} shows {found.name} now, {how}.")


def identify(hub: Hub, on: bool) -> None:
    """Name the device that is unplugged from now on."""
    hub.devices.identify(on)
    hub.changed()


def press(hub: Hub, station: int, x_px: float, y_px: float) -> None:
    """Press the simulated sensor at a place of the image."""
    source: Any = hub.station(station).source
    if not hasattr(source, "press_at"):
        raise GelformError("Only a simulated sensor can be pressed from here.")
    source.press_at(x_px, y_px)


def record(hub: Hub, station: int, on: bool) -> None:
    """Begin to record the frames as the camera gives them, or finish."""
    chosen, running = hub.station(station), hub.recorders.get(station)
    if on and isinstance(chosen.source, Player):
        raise GelformError("This is a recording already. Share makes one file of it, with the calibration.")
    if on and running is None:
        hub.recorders[station] = Recorder(chosen.grabber, hub.folder, chosen.setup)
    elif not on and running is not None:
        del hub.recorders[station]
        running.close()
        if running.stats.frames:
            hub.recordings.add(running.path)
        hub.notice(running.problem or f"Recorded {running.stats.frames} frames: {running.path.name}")
    hub.changed()


def snapshot(hub: Hub, station: int) -> dict[str, Any]:
    """Keep what is shown now; the answer has its number and the names of its files."""
    shown = hub.station(station).newest
    if shown is None:
        raise GelformError("There is no picture yet. Wait for the first one.")
    number = hub.snapshots.add(shown)
    return {"kind": "snapshot", "number": number, "files": hub.snapshots.names(number)}


def code(hub: Hub, station: int, view: str, x_px: float, y_px: float) -> dict[str, Any]:
    """What reproduces a view, a profile through a point: the answer has it in Python and as command lines."""
    chosen = hub.station(station)
    setup, frame = chosen.setup, None if chosen.newest is None else chosen.newest.frame
    mine, other = (
        hub.calibrations.origin_of(name) if name else None for name in (setup.name, setup.other_name)
    )
    now = Situation(
        str(chosen.source.recording.path) if isinstance(chosen.source, Player) else chosen.spec,
        mine,
        other,
        setup.background is not None,
        setup.zero_mm is not None,
        setup.solver,
        frame.number if isinstance(frame, ReplayedFrame) else None,
        (int(x_px), int(y_px)),
    )
    title, parts = code_of(view, now)
    return {"kind": "code", "title": title, "parts": parts}


def _frames(station: Station, count: int) -> Sequence[Any]:
    """The next frames; of a recording that is held the one that is shown."""
    source = station.source
    if isinstance(source, Player) and not source.playing:
        if station.newest is None:
            raise GelformError("There is no picture yet. Wait for the first one.")
        return [station.newest]
    return wait_for_frames(station, count)


def _check_calibrated(calibration: Any) -> None:
    if calibration is None:
        raise GelformError("This sensor has no calibration yet. Choose one, or make one: Calibrate.")
