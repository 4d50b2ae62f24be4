"""The shared state of one `gelform live`: stations, calibrations, long work and notices, for all clients."""

from __future__ import annotations

import logging
import re
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any

from gelform import __version__
from gelform.calibration.starters import make_name, starter_names, starter_of_source
from gelform.depth.solvers import SOLVERS
from gelform.errors import GelformError
from gelform.foundations.findings import Progress
from gelform.live.lists import Calibrations, Devices, Recordings, camera_facts
from gelform.live.shown import Shown, Snapshots
from gelform.live.station import Station
from gelform.sensors.profiles import PROFILES
from gelform.sensors.record import Recorder

if TYPE_CHECKING:
    from gelform.live.guide import GuideSession

# Seconds for which a page without a connection counts as open: a page that was reloaded or lost its network is back by
# then (it gives up a silent connection after 5 s, and tries again at least every 4 s).
GRACE_S = 10.0
NAME = re.compile(r"[0-9a-z-]{8,64}")
NOTICES = 20  # notices that are kept
TURN_S = 0.25  # s that an action waits for another one of its sensor; those that only set something take milliseconds
LOOK_S = 0.25  # s between looks at a sensor whose frames are awaited
BUSY = "This sensor is busy. Wait until it is done."


class Pages:
    """Connections of pages by the page's name; methods may be called in any thread.

    Parameters
    ----------
    clock : replaceable, to run faster or slower than real time
    """

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
            if name in self._connections:
                return True
            left_s = self._left_s.get(name)
            return left_s is not None and self._clock() - left_s < GRACE_S

    @property
    def any_connected(self) -> bool:
        """Whether any page is connected now."""
        return bool(self._connections)


def page_named(given: str) -> str:
    """The name that a page states; "" for an invalid one, and such a page has no identity."""
    return given if NAME.fullmatch(given) else ""


@dataclass
class Hub:
    """The stations and their shared state.

    Attributes
    ----------
    stations : in the order of the command line
    calibrations : to choose from
    recordings : to open and to download
    snapshots : kept frames
    guides : guided calibrations by the station's number
    recorders : current recordings by the station's number
    pages : the open pages
    sinks : number of other programs that show the same results
    folder : folder for calibrations and recordings
    bgr : whether frames that do not state it are blue, green, red
    work : (what, done, total) of long work by the station's number, for the progress display
    notices : (number, level, text), the newest last; level is "info", "warning" or "error"
    """

    stations: list[Station] = field(default_factory=list)
    calibrations: Calibrations = field(default_factory=Calibrations)
    recordings: Recordings = field(default_factory=Recordings)
    work: dict[int, tuple[str, int, int]] = field(default_factory=dict)
    snapshots: Snapshots = field(default_factory=Snapshots)
    guides: dict[int, GuideSession] = field(default_factory=dict)
    recorders: dict[int, Recorder] = field(default_factory=dict)
    pages: Pages = field(default_factory=Pages)
    sinks: int = 0
    folder: Path = Path(".")
    bgr: bool = False
    notices: deque[tuple[int, str, str]] = field(default_factory=lambda: deque(maxlen=NOTICES))
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

    def station(self, number: int) -> Station:
        """The station with a number; GelformError if there is none."""
        if not 0 <= number < len(self.stations):
            raise GelformError(f"There is no sensor {number}.")
        return self.stations[number]

    @contextmanager
    def turn(self, number: int, wait_s: float = TURN_S) -> Iterator[None]:
        """Context for a change of a station: one at a time, whichever page asks; GelformError if another one lasts."""
        lock = self.station(number).turn
        if not lock.acquire(timeout=wait_s):
            raise GelformError(BUSY)
        try:
            yield
        finally:
            lock.release()

    def start(self, work: Callable[[Progress], None], station: int, what: str) -> None:
        """Do long work in a new thread and show its progress; errors become notices."""

        def report(done: int, total: int, what: str) -> None:
            self.work[station] = (what, done, total)
            self.changed()

        def run() -> None:
            try:
                work(report)
            except Exception as problem:  # nobody waits for this thread
                self.notice(sentence_for_page(problem), "error")
            finally:
                self.work.pop(station, None)
                self.changed()

        self.check_idle(station)
        self.work[station] = (what, 0, 1)
        threading.Thread(target=run, name=what, daemon=True).start()

    def end_guide(self, station: int) -> None:
        """End the guided calibration of a station; presses without a fit are discarded."""
        session = self.guides.pop(station, None)
        if session is not None:
            session.close()
        self.changed()

    def recorded(self, station: int, ended: Recorder) -> None:
        """Add a finished recording to the list, once, and announce it."""
        with self._lock:
            if self.recorders.get(station) is not ended:
                return
            del self.recorders[station]
        said = f"Recorded {ended.stats.frames} frames: {ended.path.name}"
        if ended.stats.frames:
            self.recordings.add(ended.path)
        elif ended.problem:
            said = ""
        self.notice(f"{ended.problem} {said}".strip(), "warning" if ended.problem else "info")

    def check_idle(self, station: int) -> None:
        """Raise GelformError during long work of a station."""
        if station in self.work:
            raise GelformError(BUSY)

    def facts(self, notices_after: int = 0) -> dict[str, Any]:
        """The state for the page, besides frames."""
        return {
            "version": __version__,
            "now_s": time.monotonic(),
            "stations": [
                station.facts() | camera_facts(station) | {"starter": starter_facts(station)}
                for station in self.stations
            ],
            "starters": starters(),
            "calibrations": self.calibrations.names,
            "solvers": ["auto", *SOLVERS],
            "guides": {number: session.guide.facts() for number, session in tuple(self.guides.items())},
            "files": self.recordings.facts(),
            "devices": self.devices.facts(),
            "recordings": {
                number: {
                    "frames": one.stats.frames,
                    "seconds": one.stats.duration_s,
                    "bytes": one.stats.written_bytes,
                }
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


def wait_for_frames(station: Station, count: int, timeout_s: float = 15.0) -> list[Shown]:
    """The next frames of a station, from the camera.

    Raises
    ------
    GelformError
        They do not arrive in time, or the station shows no frames now; the message says why.
    """
    got: SimpleQueue[Shown] = SimpleQueue()
    found: list[Shown] = []
    until_s = time.monotonic() + timeout_s
    station.taps.append(got.put)
    try:
        while len(found) < count:
            if why := station.silence:
                raise GelformError(why)
            if (left_s := until_s - time.monotonic()) <= 0:
                raise GelformError(
                    f"Expected {count} frames within {timeout_s:g} s, got {len(found)}. Is the camera connected?"
                )
            with suppress(Empty):
                found.append(got.get(timeout=min(LOOK_S, left_s)))
    finally:
        station.taps.remove(got.put)
    return found


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


def starters() -> list[list[str]]:
    """[name, display name] of the makes with a starter."""
    return [[name, make_name(name)] for name in starter_names()]


def starter_facts(station: Station) -> dict[str, Any] | None:
    """The starter's state for the page: `ask` for the gel at rest, or `used`; None for a calibrated unit.

    `sensor` is the starter's name, empty if the make is unknown; `said` are sentences for the user.
    """
    calibration, problem = station.setup.calibration, station.starter_problem
    if calibration is None:
        sensor = starter_of_station(station)
        return {
            "state": "ask",
            "sensor": sensor,
            "make": make_name(sensor),
            "said": [problem] if problem else [],
        }
    record = calibration.settings.starter
    if record is None:
        return None
    said = [finding.message for finding in calibration.findings if finding.name != "starter"]
    return {
        "state": "used",
        "sensor": record["sensor"],
        "make": calibration.sensor_name,
        "percent": 100 * calibration.unit_spread,
        "said": [*said, *([problem] if problem else [])],
    }


def starter_of_station(station: Station) -> str:
    """The starter that the station was started with, else that of its camera's make; "" if neither is known."""
    return station.sensor or (starter_of_source(station.source) if station.source is not None else None) or ""
