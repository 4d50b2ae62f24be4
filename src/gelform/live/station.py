"""One sensor of the page: a thread that takes the newest frame, reconstructs it and shows it."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from gelform.errors import GelformError, SensorError
from gelform.frames import Frame
from gelform.live.measures import measures_of
from gelform.live.replay.player import Player
from gelform.live.setup import Setup
from gelform.live.shown import Shown
from gelform.sensors.cameras.camera import Camera
from gelform.sensors.grabber import STALL_S, Grabber
from gelform.sensors.recordings.record import KEPT_FRAMES
from gelform.sensors.source import Source

KEPT = 600  # results whose numbers are kept for the curves: ten seconds at 60 a second
RATE_OVER = 60
RETRY_S = 1.0
WAIT_S = 0.25
NEVER_S = float("inf")  # a recording that is held has not stalled

Tap = Callable[[Frame, Shown], None]


@dataclass(frozen=True)
class Opening:
    """How a station comes to its source.

    Attributes
    ----------
    open_it : opens the source; called again when it is lost
    stall_s : after so many seconds without a frame the source counts as lost
    camera : of this machine, which it opens; None for anything else
    wanted : settings of the camera that were chosen here: `open_it` sets them again
    """

    open_it: Callable[[], Source]
    stall_s: float = STALL_S
    camera: Camera | None = None
    wanted: dict[str, float | str] = field(default_factory=dict)


class Station:
    """A source, how it is reconstructed, and what it shows.

    Parameters
    ----------
    number : how the page names it
    spec : what the user asked for: "simulated", a serial, a path
    opening : how it comes to its source, or what opens it
    on_shown : called in the station's thread when there is something newer to show

    Attributes
    ----------
    setup : Setup; assign another one to change it: a recording that is held is reconstructed anew
    newest : Shown or None
    taps : called with every frame and what is shown of it: recorders, guides
    """

    def __init__(
        self,
        number: int,
        spec: str,
        opening: Opening | Callable[[], Source],
        on_shown: Callable[[], None],
    ) -> None:
        self.number, self.spec = number, spec
        self._setup = Setup()
        self.newest: Shown | None = None
        self.taps: list[Tap] = []
        self.paused = False
        self._given = self._opening = opening if isinstance(opening, Opening) else Opening(opening)
        self._given_setup = self._setup
        self._on_shown = on_shown
        self._grabber: Grabber | None = None
        self._missing = ""
        self._stop, self._switched = threading.Event(), threading.Event()
        self._serial = 0
        self._times: deque[float] = deque(maxlen=RATE_OVER)
        self._numbers: deque[tuple[int, float, float, float, float]] = deque(maxlen=KEPT)
        self._took_s = 0.0
        self._thread = threading.Thread(target=self._run, name=f"station {number}", daemon=True)

    def start(self) -> None:
        """Begin; a source that is not there yet is tried again every second, and the page says so."""
        self._thread.start()

    def close(self) -> None:
        """Stop and give the device back."""
        self._stop.set()
        self._switched.set()
        if self._thread.ident is not None:
            self._thread.join(3.0)

    @property
    def setup(self) -> Setup:
        """How frames are reconstructed."""
        return self._setup

    @setup.setter
    def setup(self, setup: Setup) -> None:
        self._setup = setup
        if isinstance(self.source, Player):
            self.source.again()

    def show(self, opening: Opening, setup: Setup) -> None:
        """Show another source in place of the one it was started with."""
        if not self.opened:
            self._given_setup = self._setup
        self._opening, self._setup = opening, setup
        self._switched.set()

    def show_given(self) -> None:
        """Show again what it was started with, reconstructed as it was then."""
        if self.opened:
            self._opening, self._setup = self._given, self._given_setup
            self._switched.set()

    @property
    def opened(self) -> bool:
        """Whether it shows another source than the one it was started with."""
        return self._opening is not self._given

    @property
    def camera(self) -> Camera | None:
        """The camera of this machine that it shows or is about to open."""
        return self._opening.camera or getattr(self.source, "camera", None)

    @property
    def wanted(self) -> dict[str, float | str]:
        """Settings of the camera that were chosen here."""
        return self._opening.wanted

    @property
    def source(self) -> Source | None:
        """The source, once it is open."""
        return None if self._grabber is None else self._grabber.source

    @property
    def grabber(self) -> Grabber:
        """The running grabber; GelformError where there is no sensor."""
        if self._grabber is None:
            raise GelformError("The sensor is not there. Plug it in.")
        return self._grabber

    def numbers_since(self, serial: int) -> list[tuple[int, float, float, float, float]]:
        """(serial, time_s, peak, area, volume) of each result after the one of that serial; all that are kept."""
        return [row for row in tuple(self._numbers) if row[0] > serial]

    def facts(self) -> dict[str, Any]:
        """How the station is doing, as the page shows it."""
        grabber, setup, calibration = self._grabber, self.setup, self.setup.calibration
        facts: dict[str, Any] = {
            "number": self.number,
            "spec": self.spec,
            "name": self.spec if grabber is None else grabber.name,
            "serial": None if grabber is None else grabber.serial,
            "settings": {} if grabber is None else dict(grabber.settings),
            "state": "missing" if grabber is None else grabber.state,
            "reason": self._missing if grabber is None else grabber.reason,
            "rate_hz": self.rate_hz,
            "took_ms": 1e3 * self._took_s,
            "simulated": hasattr(self.source, "press_at"),
            "calibration": setup.name,
            "image_shape": None if calibration is None else list(calibration.image_shape),
            "background": "taken here" if setup.background is not None else "of the calibration",
            "zero": setup.zero_mm is not None,
            "solver": setup.solver,
            "other": setup.other_name,
            "paused": self.paused,
            "replay": self.source.facts() if isinstance(self.source, Player) else None,
            "opened": self.opened,
        }
        if grabber is not None:
            stats = grabber.stats
            facts |= {"drops": stats.drops, "camera_hz": stats.rate_hz, "reopened": stats.reopened}
        return facts

    @property
    def rate_hz(self) -> float:
        """Results a second over the last 60; 0 where the last one is older than a second."""
        times = tuple(self._times)
        if len(times) < 2 or time.monotonic() - times[-1] > 1.0:
            return 0.0
        return (len(times) - 1) / max(times[-1] - times[0], 1e-9)

    # -- the thread ---------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while not self._stop.is_set():
            self._switched.clear()
            try:
                opening, self._setup = self._opening, self._setup.anew()
                with Grabber(opening.open_it, stall_s=opening.stall_s, keep=KEPT_FRAMES) as self._grabber:
                    self._show_all(self._grabber)
            except (SensorError, GelformError, OSError) as problem:
                self._missing, self._grabber = str(problem), None
                self._on_shown()
                self._switched.wait(RETRY_S)
            except Exception as problem:  # a bug: the page says that this sensor has stopped, and why
                self._missing, self._grabber = f"bug: {type(problem).__name__}: {problem}", None
                self._on_shown()
                raise

    def _show_all(self, grabber: Grabber) -> None:
        """Show frames until another source is wanted; when the source ends, its last frame stays."""
        after = -1
        while not self._stop.is_set() and not self._switched.is_set():
            frame = None if self.paused else grabber.newest(after, timeout_s=WAIT_S)
            if frame is not None:
                after = frame.index
                self._show(frame)
            elif self.paused or grabber.state == "ended":
                self._switched.wait(WAIT_S)

    def _show(self, frame: Frame) -> None:
        started = time.monotonic()
        self._serial += 1
        shown = _shown(self._serial, frame, self.setup)
        self._took_s = time.monotonic() - started
        if shown.measures is not None:
            m = shown.measures
            self._numbers.append((shown.serial, frame.time_s, m.peak, m.area, m.volume))
        self._times.append(time.monotonic())
        self.newest = shown
        for tap in tuple(self.taps):
            tap(frame, shown)
        self._on_shown()


def _shown(serial: int, frame: Frame, setup: Setup) -> Shown:
    """What a setup makes of a frame; where that cannot be reconstructed, the frame and the reason."""
    try:
        image = setup.image_of(frame)
    except (GelformError, ValueError) as problem:
        return Shown(serial, frame, frame.image, problem=str(problem))
    try:
        result = setup.result_of(frame, image)
    except (GelformError, ValueError) as problem:
        return Shown(serial, frame, image, problem=str(problem))
    if result is None:
        return Shown(serial, frame, image, problem="")
    run = setup.reconstruct
    return Shown(
        serial,
        frame,
        image,
        result,
        setup.other_of(frame),
        measures_of(result),
        explain=None if run is None else partial(run.explain, image),
        background=setup.background,
        zero_mm=setup.zero_mm,
    )
