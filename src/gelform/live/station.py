"""One sensor of the page: the pipeline of its frames, its reconstruction, and the displayed results."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from itertools import takewhile
from typing import Any

from gelform.errors import GelformError
from gelform.image.frame import Frame
from gelform.live.player import Player
from gelform.live.setup import Setup
from gelform.live.shown import Shown, measures_of
from gelform.sensors.cameras.camera import Camera
from gelform.sensors.grabber import STALL_S, Grabber
from gelform.sensors.playback import Playback
from gelform.sensors.recordings.record import KEPT_FRAMES
from gelform.sensors.simulated.source import SimulatedSource
from gelform.sensors.source import Source
from gelform.sensors.streams.feed import NewestFrames
from gelform.sensors.streams.memory import Timed, Work
from gelform.sensors.streams.pipeline import Pipeline

KEPT_NUMBERS = 18_000  # results whose numbers are kept for the curves: five minutes at 60 per second
RETRY_S = 1.0  # s between attempts to open an unavailable source
WAIT_S = 0.25  # s, longest wait for a result before a request to stop is checked
RATE_OVER, STALE_S = 60, 1.0  # results for the rate; s without a result until it is 0
CLOSE_S = 10.0  # s for the threads of the pipeline and of the device, 2 s each
# s between reconstructed frames while no page is open. The memory learns means over a second and more, and its
# findings take at least a quarter of a second, so eight frames per second are enough.
UNWATCHED_S = 0.125
MADE_HERE = (
    SimulatedSource,
    Playback,
)  # they leave out what comes too late: no frame of theirs is lost on its way
NEVER_S = float("inf")  # a held recording has not stalled
STAGES = ("view", "reconstruct")  # stages whose times add up to the displayed time of reconstruction


@dataclass(frozen=True)
class Opening:
    """How a station opens its source.

    Attributes
    ----------
    open_it : opens the source; called again after a loss
    stall_s : seconds without a frame until the source counts as lost
    camera : the camera of this machine that it opens; None for other sources
    wanted : camera settings chosen here; `open_it` sets them again
    """

    open_it: Callable[[], Source]
    stall_s: float = STALL_S
    camera: Camera | None = None
    wanted: dict[str, float | str] = field(default_factory=dict)


class Station:
    """A source, its reconstruction, and the displayed results.

    Parameters
    ----------
    number : the page's name for it
    spec : the user's spec: "simulated", a serial number, a path
    opening : how to open its source, or the function that opens it
    on_shown : called in the station's thread when there is something new to show
    watched : whether every frame is needed, as for a tap; else eight per second are reconstructed, for the memory

    Attributes
    ----------
    setup : Setup; assign another one to change it: a held recording is then reconstructed again
    newest : Shown or None
    taps : called with each shown frame, in the station's thread: guides
    paused : whether a sensor's picture is held
    sensor : the requested starter; "" for that of the camera's make
    starter_problem : why there is no starter's calibration; "" if there is nothing to report
    """

    def __init__(
        self,
        number: int,
        spec: str,
        opening: Opening | Callable[[], Source],
        on_shown: Callable[[], None],
        watched: Callable[[], bool] = lambda: True,
    ) -> None:
        self.number, self.spec = number, spec
        self._setup = Setup()
        self.newest: Shown | None = None
        self.taps: list[Callable[[Shown], None]] = []
        self.paused = False
        self.sensor = self.starter_problem = ""
        self._given = self._opening = opening if isinstance(opening, Opening) else Opening(opening)
        self._given_setup = self._setup
        self._on_shown, self._watched = on_shown, watched
        self._grabber: Grabber | None = None
        self._pipeline: Pipeline[Shown] | None = None
        self._run_by: tuple[Any, Any] | None = None
        self._missing = ""
        self._stop, self._switched = threading.Event(), threading.Event()
        self._serial, self._begun_s = 0, -NEVER_S
        self._skipped, self._counted, self._waited = 0, (-1, 0), True
        self._times_s: deque[float] = deque(maxlen=RATE_OVER)
        self._numbers: deque[tuple[float, ...]] = deque(maxlen=KEPT_NUMBERS)
        self._thread = threading.Thread(target=self._run, name=f"station {number}", daemon=True)

    def start(self) -> None:
        """Start; an unavailable source is tried again every second, and the page shows that."""
        self._thread.start()

    def close(self) -> None:
        """Stop and release the device."""
        self._stop.set()
        self._switched.set()
        if self._thread.ident is not None:
            self._thread.join(CLOSE_S)

    @property
    def setup(self) -> Setup:
        """The setup of the reconstruction."""
        return self._setup

    @setup.setter
    def setup(self, setup: Setup) -> None:
        if setup.memory is not None and self._run_by is not None and setup.memory is not self._setup.memory:
            setup.memory.run_by(*self._run_by)
        self._setup = setup
        if self.player is not None:
            self.player.again()

    def show(self, opening: Opening, setup: Setup) -> None:
        """Show another source in place of the first one."""
        if not self.opened:
            self._given_setup = self._setup
        self._opening, self._setup, self.starter_problem = opening, setup, ""
        self._switched.set()

    def show_given(self) -> None:
        """Return to the first source, with its setup of that time."""
        if self.opened:
            self._opening, self._setup = self._given, self._given_setup
            self._switched.set()

    @property
    def opened(self) -> bool:
        """Whether the station shows another source than its first one."""
        return self._opening is not self._given

    @property
    def camera(self) -> Camera | None:
        """The camera of this machine that it shows or is about to open."""
        return self._opening.camera or getattr(self.source, "camera", None)

    @property
    def wanted(self) -> dict[str, float | str]:
        """The camera settings chosen here."""
        return self._opening.wanted

    @property
    def source(self) -> Source | None:
        """The source, once it is open."""
        return None if self._grabber is None else self._grabber.source

    @property
    def player(self) -> Player | None:
        """The source if it is a recording with controls; None for a sensor."""
        return self.source if isinstance(self.source, Player) else None

    @property
    def grabber(self) -> Grabber:
        """The running grabber; GelformError if there is no sensor."""
        if self._grabber is None:
            raise GelformError("The sensor is not connected. Plug it in.")
        return self._grabber

    def pause(self, paused: bool) -> None:
        """Hold the picture, or continue; a recording is held itself."""
        if self.player is None:
            self.paused = paused
        else:
            self.player.play(not paused)

    def numbers_since(self, serial: int) -> list[tuple[float, ...]]:
        """(serial, time_s, peak, area, volume) of all kept results after the one with that serial."""
        newest_first = takewhile(lambda row: row[0] > serial, reversed(self._numbers.copy()))
        return list(newest_first)[::-1]

    def facts(self) -> dict[str, Any]:
        """The station's state for the page."""
        grabber, setup, calibration, player = self._grabber, self.setup, self.setup.calibration, self.player
        stage_ms = {} if self._pipeline is None else self._pipeline.stats().stage_ms
        facts: dict[str, Any] = {
            "number": self.number,
            "spec": self.spec,
            "name": self.spec if grabber is None else grabber.name,
            "serial": None if grabber is None else grabber.serial,
            "settings": {} if grabber is None else dict(grabber.settings),
            "state": "missing" if grabber is None else grabber.state,
            "reason": self._missing if grabber is None else grabber.reason,
            "rate_hz": self.rate_hz,
            "took_ms": sum(stage_ms.get(name, 0.0) for name in STAGES),
            "simulated": hasattr(self.source, "press_at"),
            "calibration": setup.name,
            "image_shape": None if calibration is None else list(calibration.image_shape),
            "background": "taken on this page" if setup.background is not None else "from the calibration",
            "zero": setup.zero_mm is not None,
            "solver": setup.solver,
            "paused": self.paused,
            "replay": None if player is None else player.facts(),
            "opened": self.opened,
        }
        if grabber is not None:
            stats = grabber.stats
            facts |= {"camera_hz": stats.rate_hz, "reopened": stats.reopened}
        return facts | {"lost": self.lost, "skipped": self.skipped}

    @property
    def lost(self) -> int:
        """Number of camera frames lost on the way, by the gaps in the camera's own count."""
        return 0 if self._grabber is None or isinstance(self.source, MADE_HERE) else self._grabber.stats.drops

    @property
    def skipped(self) -> int:
        """Number of needed frames that a newer one replaced: neither drawn nor in any figure."""
        return max(0, self._skipped)

    @property
    def rate_hz(self) -> float:
        """Results per second over the last 60; 0 if the last one is older than a second."""
        times_s = tuple(self._times_s)
        if len(times_s) < 2 or time.monotonic() - times_s[-1] > STALE_S:
            return 0.0
        return (len(times_s) - 1) / max(times_s[-1] - times_s[0], 1e-9)

    # -- the thread, and functions that the pipeline's threads call -------------------------------------------------

    def _run(self) -> None:
        while not self._stop.is_set():
            self._switched.clear()
            try:
                opening, self._setup = self._opening, self._setup.anew()
                with Grabber(opening.open_it, stall_s=opening.stall_s, keep=KEPT_FRAMES) as self._grabber:
                    self._show_all(self._grabber)
            except (GelformError, OSError) as problem:
                self._missing, self._grabber = str(problem), None
                self._on_shown()
                self._switched.wait(RETRY_S)
            except Exception as problem:  # a bug: the page shows that this sensor has stopped, and why
                self._missing, self._grabber = f"bug: {type(problem).__name__}: {problem}", None
                self._on_shown()
                raise

    def _show_all(self, grabber: Grabber) -> None:
        """Show results until another source is chosen; after the source's end its last frame stays."""
        feed = NewestFrames(grabber, owned=False, paused=self._waits)
        pipeline = self._pipeline = Pipeline(feed, self)
        pipeline.start()
        after, self._waited = -1, True
        try:
            while not self._switched.is_set():
                shown = pipeline.results.newest(after, WAIT_S)
                if shown is not None:
                    after = shown.frame.index
                    if not self.paused:  # frames in work when it was held are not shown
                        self._show(shown)
                elif pipeline.results.ended:
                    self._switched.wait(WAIT_S)
        finally:
            pipeline.close()
            self._pipeline = self._run_by = None

    def _waits(self) -> bool:
        """Whether to skip frames now: the picture is held, or no page is open and a result is recent."""
        if self._watched() or self.taps:
            waits = self.paused
        else:
            waits = self.paused or time.monotonic() - self._begun_s < UNWATCHED_S
        self._waited |= waits
        return waits

    def _count_skipped(self, index: int) -> None:
        """Count the frames between the last reconstructed one and this one, except those that were not needed."""
        before, lost_before = self._counted
        self._counted = index, self.lost
        if not self._waited:
            self._skipped += index - before - 1 - (self.lost - lost_before)
        self._waited = False

    def _show(self, shown: Shown) -> None:
        self.newest = shown
        self._times_s.append(time.monotonic())
        for tap in tuple(self.taps):
            tap(shown)
        self._on_shown()

    def run_by(self, helper: Callable[[Work], Work], examine: Callable[[Work], None] | None) -> None:
        """Run slow work of this and later setups elsewhere."""
        self._run_by = helper, examine
        if self._setup.memory is not None:
            self._setup.memory.run_by(helper, examine)

    def reconstructed(self, frame: Frame, timed: Timed) -> Shown:
        """The setup's result of a frame; if reconstruction fails, the frame and the reason."""
        setup, self._serial, self._begun_s = self._setup, self._serial + 1, time.monotonic()
        self._count_skipped(frame.index)
        image = frame.image
        try:
            with timed("view"):
                image = setup.image_of(frame)
            with timed("reconstruct"):
                found = setup.result_of(frame, image, alone=self.player is not None)
        except (GelformError, ValueError) as problem:
            return Shown(self._serial, frame, image, problem=str(problem))
        if found is None or setup.memory is None:
            return Shown(self._serial, frame, image)
        result = setup.against_zero(found)
        measures = measures_of(result)
        if measures is not None:
            self._numbers.append((self._serial, frame.time_s, *measures.numbers.values()))
        return Shown(
            self._serial,
            frame,
            image,
            result,
            measures,
            explain=partial(setup.memory.reconstruct.explain, image),
            learn=None if self.player is not None else partial(setup.memory.learn, image, found),
        )

    def learn_from(self, shown: Shown) -> None:
        """Learn from the result of a sensor; frames of a recording are not learned from."""
        if shown.learn is not None:
            shown.learn()
