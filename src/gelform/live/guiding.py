"""What the buttons of the guided calibration do; calibration is imported when a guide starts, after the first picture."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from gelform.checks import check_sensor_pitch
from gelform.errors import GelformError
from gelform.live import actions
from gelform.live.hub import Hub
from gelform.live.replay.player import Player
from gelform.live.station import Station
from gelform.sensors.profiles import profile_named
from gelform.view import View

if TYPE_CHECKING:
    from gelform.live.guide.guide import Asked
    from gelform.live.guide.session import GuideSession


def start(hub: Hub, station: int, ball_diameter_mm: float, profile: str, mm_per_px: float) -> None:
    """Begin, or begin again; of a recording from its start.

    The scale is the profile's, or the one given, or the simulated sensor's own.
    """
    from gelform.live.guide.session import GuideSession

    chosen = hub.station(station)
    if chosen.newest is None:
        raise GelformError("There is no picture yet. Connect the sensor first.")
    asked = _asked(chosen, ball_diameter_mm, profile, mm_per_px)
    stop(hub, station)
    hub.guides[station] = GuideSession(chosen, asked, hub.folder, hub.changed)
    if isinstance(chosen.source, Player):
        chosen.source.loop(False)
        chosen.source.seek(0)
        chosen.source.play()
    hub.changed()


def fit(hub: Hub, station: int) -> None:
    """Calibrate on the presses that were accepted."""
    session = _session(hub, station)
    session.guide.presses()  # too few are said at once
    hub.start(session.fit, station, "calibrating")


def use(hub: Hub, station: int) -> None:
    """Reconstruct with the calibration that was made; the guide ends."""
    session = _session(hub, station)
    if session.calibration is None:
        raise GelformError("There is nothing to use yet. Fit first.")
    name = hub.calibrations.add_file(session.path)
    actions.use_calibration(hub, station, name)
    stop(hub, station)
    hub.notice(f"In use, and saved: {session.name}/calibration.npz")


def stop(hub: Hub, station: int) -> None:
    """End the guide."""
    hub.end_guide(station)


def _session(hub: Hub, station: int) -> GuideSession:
    if station not in hub.guides:
        raise GelformError("No calibration is under way. Start one.")
    return hub.guides[station]


def _asked(station: Station, ball_diameter_mm: float, profile: str, mm_per_px: float) -> Asked:
    from gelform.calibration.presses.press_set import check_ball_diameter
    from gelform.live.guide.guide import Asked

    assert station.newest is not None
    shape = station.newest.frame.image.shape[:2]
    source: Any = station.source
    try:
        diameter = check_ball_diameter(ball_diameter_mm)
        if hasattr(source, "press_at"):
            return Asked(diameter, source.sensor.mm_per_px, None, View(), source.sensor.name)
        if profile:
            known = profile_named(profile)
            view = known.view((shape[0], shape[1]))
            return Asked(diameter, known.mm_per_px, known.mm_per_px_sigma, view, known.name, source.serial)
        return Asked(diameter, check_sensor_pitch(mm_per_px), None, View(), source.name, source.serial)
    except (ValueError, TypeError) as problem:
        raise GelformError(str(problem)) from problem
