"""What the buttons of a replay do: open, play, seek, step, speed, loop, share."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from gelform.errors import GelformError
from gelform.live.calibrations import Origin
from gelform.live.hub import Hub
from gelform.live.replay.indexed import indexed
from gelform.live.replay.player import Player
from gelform.live.replay.share import share as share_file
from gelform.live.setup import Setup
from gelform.live.station import NEVER_S, Opening, Station
from gelform.live.take.recorder import named_by_time
from gelform.progress import Progress
from gelform.sensors.recordings.record import attached_background, attached_calibration


def open_recording(hub: Hub, station: int, name: str) -> None:
    """Show a recording of the list in place of what a station shows; "" shows again what it was started with."""
    chosen = hub.station(station)
    hub.check_idle(station)
    if name:
        recording = indexed(hub.recordings.path(name))
        setup = attached_setup(hub, chosen.setup, recording.path)
        hub.end_guide(station)
        chosen.show(Opening(lambda: Player(recording), NEVER_S), setup)
    else:
        hub.end_guide(station)
        chosen.show_given()
    hub.changed()


def attached_setup(hub: Hub, setup: Setup, path: Path) -> Setup:
    """A setup with the calibration, and the background, that a recording carries; the same where it carries none."""
    calibration = attached_calibration(path)
    if calibration is None:
        return replace(setup, background=None, zero_mm=None)  # those were of the sensor
    origin = Origin(
        f"attached_calibration({str(path)!r})",
        ("from gelform.sensors.recordings import attached_calibration",),
    )
    name = f"{path.resolve().name}: calibration"
    name = hub.calibrations.add_once(name, calibration, origin)
    setup = setup.with_calibration(calibration, name)
    background = attached_background(path)
    return setup if background is None else setup.with_background(background)


def play(hub: Hub, station: int, playing: bool) -> None:
    """Go on, or hold."""
    player_of(hub.station(station)).play(playing)
    hub.changed()


def seek(hub: Hub, station: int, frame: float) -> None:
    """Show a frame by its number."""
    player_of(hub.station(station)).seek(int(frame))


def step(hub: Hub, station: int, by: float) -> None:
    """Show the next frame or the one before, and hold."""
    player_of(hub.station(station)).step(int(by))


def speed(hub: Hub, station: int, speed: float) -> None:
    """Play faster or slower."""
    player_of(hub.station(station)).set_speed(speed)
    hub.changed()


def loop(hub: Hub, station: int, loop: bool) -> None:
    """Begin again at the end, or not."""
    player_of(hub.station(station)).loop(loop)
    hub.changed()


def share(hub: Hub, station: int) -> None:
    """Make one file of the recording and the calibration in use; it joins the list, from which it is fetched."""
    chosen = hub.station(station)
    recording, setup = player_of(chosen).recording, chosen.setup
    path = hub.folder / f"{named_by_time('shared')}.mcap"

    def work(progress: Progress) -> None:
        share_file(
            recording,
            path,
            calibration=setup.calibration,
            background=setup.background,
            progress=progress,
        )
        name = hub.recordings.add(path)
        hub.notice(f"Ready to share: {name}, with the calibration in it. Download it below Recordings.")

    hub.start(work, station, "one file to share")


def player_of(station: Station) -> Player:
    """The player of a station; GelformError where it shows a sensor."""
    source: Any = station.source
    if not isinstance(source, Player):
        raise GelformError("This is a sensor, not a recording. Open a recording first.")
    return source
