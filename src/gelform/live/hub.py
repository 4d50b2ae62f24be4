"""The shared state of one `gelform live`: stations, calibrations, long work and notices, for all clients."""

from __future__ import annotations

import logging
import math
import re
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gelform import GelformError
from gelform.calibration.starters import make_name, starter_names, starter_of_source
from gelform.errors import Progress, counted
from gelform.live.lists import Calibrations, Devices, Recordings
from gelform.live.shown import ShownFrame, Snapshots
from gelform.live.station import Station
from gelform.sensors.profiles import PROFILES
from gelform.sensors.record import Recorder

if TYPE_CHECKING:
    from gelform.calibration.guide import Guide

# Seconds for which a page without a connection counts as open: a page that was reloaded or lost its network is back by
# then (it gives up a silent connection after 5 s, and tries again at least every 4 s).
GRACE_S = 10.0
BUSY = "This sensor is busy. Wait until it is done."


class Pages:
    """Connections of pages by the page's name; methods may be called in any thread. `clock` is replaceable, for tests."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._connections: Counter[str] = Counter()
        self._left_s: dict[str, float] = {}

    def came(self, name: str) -> None:
        """Note that a page has connected."""
        with self._lock:
            self._connections[name] += 1

    def left(self, name: str) -> None:
        """Note that a connection of a page has ended."""
        with self._lock:
            now = self._clock()
            self._left_s = {one: at_s for one, at_s in self._left_s.items() if now - at_s < GRACE_S}
            self._connections[name] -= 1
            if self._connections[name] <= 0:
                del self._connections[name]
                self._left_s[name] = now

    def is_open(self, name: str) -> bool:
        """Whether a page is connected, or was a moment ago and may be reloading."""
        with self._lock:
            return name in self._connections or self._clock() - self._left_s.get(name, -math.inf) < GRACE_S

    @property
    def any_connected(self) -> bool:
        """Whether any page is connected now."""
        return bool(self._connections)


def page_named(given: str) -> str:
    """The name that a page states; "" for an invalid one, and such a page has no identity."""
    return given if re.fullmatch("[0-9a-z-]{8,64}", given) else ""


@dataclass
class Hub:
    """The stations and their shared state."""

    stations: list[Station] = field(default_factory=list)  # in the order of the command line
    calibrations: Calibrations = field(default_factory=Calibrations)  # to choose from
    recordings: Recordings = field(default_factory=Recordings)  # to open and to download
    snapshots: Snapshots = field(default_factory=Snapshots)  # kept frames
    # By the station's number: what, done and total of long work; guided calibrations; current recordings.
    work: dict[int, tuple[str, int, int]] = field(default_factory=dict)
    guides: dict[int, GuideSession] = field(default_factory=dict)
    recorders: dict[int, Recorder] = field(default_factory=dict)
    pages: Pages = field(default_factory=Pages)  # that are open
    sinks: int = 0  # number of other programs that show the same results
    folder: Path = Path(".")  # for calibrations and recordings
    bgr: bool = False  # whether frames that do not state it are blue, green, red
    dataset: str = ""  # where frames are in data sets
    # (number, level, text), the newest last; level is "info", "warning" or "error".
    notices: deque[tuple[int, str, str]] = field(default_factory=lambda: deque(maxlen=20))
    _listeners: list[Callable[[], None]] = field(default_factory=list)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _noticed: int = 0

    def __post_init__(self) -> None:
        self.devices = Devices(self.stations)

    def listen(self, listener: Callable[[], None]) -> None:
        """Register a function to call, in any thread, whenever there is something new to show."""
        self._listeners.append(listener)

    def changed(self) -> None:
        """Announce that there is something new to show."""
        for listener in tuple(self._listeners):
            listener()

    def watched(self) -> bool:
        """Whether every result is needed: a page is open, or another program shows the results."""
        return self.pages.any_connected or self.sinks > 0

    def notice(self, text: str, level: str = "info") -> None:
        """Show a notice on all pages."""
        with self._lock:
            self._noticed += 1
            self.notices.append((self._noticed, level, " ".join(text.split())))
        self.changed()

    @contextmanager
    def turn(self, number: int, wait_s: float = 0.25) -> Iterator[Station]:
        """The station with a number, to change it: one at a time, whichever page asks.

        GelformError: there is none, or another change lasts longer than the wait; those that only set something take
        milliseconds.
        """
        if not 0 <= number < len(self.stations):
            raise GelformError(f"There is no sensor {number}.")
        station = self.stations[number]
        if not station.turn.acquire(timeout=wait_s):
            raise GelformError(BUSY)
        try:
            yield station
        finally:
            station.turn.release()

    def start(self, work: Callable[[Progress], None], station: Station, what: str) -> None:
        """Do long work in a new thread and show its progress; errors become notices."""

        def report(done: int, total: int, what: str) -> None:
            self.work[station.number] = (what, done, total)
            self.changed()

        def run() -> None:
            try:
                work(report)
            except Exception as problem:  # nobody waits for this thread
                self.notice(sentence_for_page(problem), "error")
            finally:
                self.work.pop(station.number, None)
                self.changed()

        self.check_idle(station)
        self.work[station.number] = (what, 0, 1)
        threading.Thread(target=run, name=what, daemon=True).start()

    def check_idle(self, station: Station) -> None:
        """Raise GelformError during long work of a station."""
        if station.number in self.work:
            raise GelformError(BUSY)

    def end_guide(self, station: Station) -> None:
        """End the guided calibration of a station; presses without a fit are discarded."""
        session = self.guides.pop(station.number, None)
        if session is not None:
            session.close()
        self.changed()

    def recorded(self, station: Station, ended: Recorder) -> None:
        """Add a finished recording to the list, once, and announce it."""
        with self._lock:
            if self.recorders.get(station.number) is not ended:
                return
            del self.recorders[station.number]
        said = f"Recorded {counted(ended.stats.frames, 'frame')}: {ended.path.name}"
        if ended.stats.frames:
            self.recordings.add(ended.path)
        elif ended.problem:
            said = ""
        gaps = ended.gaps
        text = " ".join(filter(None, (ended.problem, f"{said}. {gaps}" if gaps else said)))
        self.notice(text, "warning" if ended.problem or gaps else "info")

    def facts(self, notices_after: int = 0) -> dict[str, Any]:
        """The state for the page, besides frames."""
        return {
            "now_s": time.monotonic(),
            "stations": [one.facts() | {"starter": starter_facts(one)} for one in self.stations],
            "starters": [[name, make_name(name)] for name in starter_names()],
            "calibrations": self.calibrations.names,
            "guides": {number: session.guide.facts() for number, session in tuple(self.guides.items())},
            "files": self.recordings.facts(),
            "devices": self.devices.facts(),
            "recordings": {
                number: {"frames": one.stats.frames, "bytes": one.stats.written_bytes}
                for number, one in tuple(self.recorders.items())
            },
            "profiles": [[name, profile.name, profile.mm_per_px] for name, profile in PROFILES.items()],
            "work": {number: list(work) for number, work in tuple(self.work.items())},
            "notices": [list(notice) for notice in tuple(self.notices) if notice[0] > notices_after],
        }

    def close(self) -> None:
        """Stop everything."""
        for recorder in tuple(self.recorders.values()):
            recorder.close()
        for station in self.stations:
            station.close()


def sentence_for_page(problem: Exception) -> str:
    """What a page says about the exception of an action, on one line; one that nobody expected is logged too."""
    if isinstance(problem, (GelformError, ValueError)):
        said = str(problem)
    elif isinstance(problem, OSError) and problem.strerror:
        said = f"{problem.strerror}: {problem.filename}." if problem.filename else f"{problem.strerror}."
    else:
        logging.getLogger("gelform.live").error("An action of the page failed.", exc_info=problem)
        said = f"This is a mistake in gelform, not yours: {type(problem).__name__}: {problem}. The terminal has more."
    return " ".join(said.split())


def starter_facts(station: Station) -> dict[str, Any] | None:
    """The starter's state for the page: `ask` for the gel at rest, or `used`; None for a calibrated unit.

    `sensor` is the starter's name, empty if the make is unknown; `said` are sentences for the user.
    """
    calibration = station.setup.calibration
    problem = [station.starter_problem] if station.starter_problem else []
    if calibration is None:
        sensor = starter_of_station(station)
        return {"state": "ask", "sensor": sensor, "make": make_name(sensor), "said": problem}
    record = calibration.settings.starter
    if record is None:
        return None
    said = [finding.message for finding in calibration.findings if finding.name != "starter"]
    return {
        "state": "used",
        "sensor": record["sensor"],
        "make": calibration.sensor_name,
        "percent": 100 * calibration.unit_spread,
        "said": [*said, *problem],
    }


def starter_of_station(station: Station) -> str:
    """The starter that the station was started with, else that of its camera's make; "" if neither is known."""
    return station.sensor or (starter_of_source(station.source) if station.source is not None else None) or ""


RIM_FRACTIONS = (0.45, 0.6, 0.52)  # contact radius over ball radius of successive simulated presses
HELD_S = 20.0  # s, longest simulated press; it is lifted once accepted, which takes long on a slow machine


class GuideSession:
    """A guided calibration that gets a station's frames; the simulated sensor is pressed at the suggested places."""

    def __init__(self, hub: Hub, station: Station, guide: Guide) -> None:
        self.guide, self._hub, self._station, self._simulated = guide, hub, station, station.simulated
        self._pressed_s, self._pressed = 0.0, -1
        if self._simulated is not None:
            self._simulated.rest()
        station.taps.append(self._tap)

    def close(self) -> None:
        """Stop receiving frames; the simulated sensor continues its program."""
        if self._tap in self._station.taps:
            self._station.taps.remove(self._tap)
        if self._simulated is not None:
            self._simulated.rest(False)

    def _tap(self, shown: ShownFrame) -> None:
        """Look at a frame; if that fails, the guide gets no more of them, and can still fit its presses."""
        try:
            self._look_at(shown)
        except Exception as problem:  # the sensor's own thread
            self._hub.notice(sentence_for_page(problem), "error")
            self.close()

    def _look_at(self, shown: ShownFrame) -> None:
        """Look at a frame, and press the simulated sensor once for each target."""
        guide, now = self.guide, time.monotonic()
        guide.look_at(shown.frame)
        target, waiting = guide.target, now - self._pressed_s < HELD_S and self._pressed == guide.count
        if guide.step != "press" or self._simulated is None or target is None or waiting or guide.enough:
            return
        if self._pressed != guide.count:
            self._pressed, self._pressed_s = guide.count, now - HELD_S + 0.5  # s between presses
            self._simulated.lift()
            return
        self._pressed_s = now
        radius = guide.ball_diameter_mm / 2
        fraction = RIM_FRACTIONS[guide.count % len(RIM_FRACTIONS)]
        depth = 0.9 * radius * fraction**2 + 0.05  # mm; a spherical cap has 0.5 in the place of 0.9
        self._simulated.press_at(target.x_px, target.y_px, depth, ball_diameter_mm=2 * radius, held_s=HELD_S)
