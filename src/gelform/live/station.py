"""One sensor of the page: the pipeline of its frames, the displayed results, and where the object moved."""

from __future__ import annotations

import logging
import math
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import takewhile
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform import Calibration, Frame, GelformError, Grabber, Motion, Reconstruction, Reconstructor
from gelform.live.shown import ShownFrame
from gelform.motion.between import FOUND, LEAST_PX, LOST, NO_PRIOR, lost, moved, sensor_of
from gelform.motion.track import Follower
from gelform.sensors.cameras import CONTROLS, Camera
from gelform.sensors.grabber import STALL_S
from gelform.sensors.playback import Player
from gelform.sensors.record import KEPT_FRAMES
from gelform.sensors.source import Source
from gelform.sensors.streams.memory import LOOK_S, Memory, Timed, Work
from gelform.sensors.streams.pipeline import NewestFrames, Pipeline
from gelform.sensors.streams.sensor_health import camera_findings


class MovedSince:
    """Follows the touching object from frame to frame; begins anew when nothing touches, or with another calibration."""

    def __init__(self) -> None:
        self._sensor: tuple[object, ...] = ()
        self._follow = Follower()
        self._places: deque[tuple[float, float] | None] = deque(maxlen=256)  # are sent with each frame

    def __call__(self, result: Reconstruction, place_error: float | None) -> dict[str, Any]:
        """The motion up to the next frame, for the page; `place_error` as in `gelform.track`. What is not known is None.

        `state`, `why` and `blind` are the motion's, in words. `path` has places (x, y) in px of the contact's middle, and
        None between two of them where the object was lost. `shift_mm` is that of the contact's middle along x and y,
        `turn_deg` about z, clockwise in the image, each with its sigma. `axes` are the object's x, y and z on the picture,
        1 long if not tilted; z is None if the tilt is not known.
        """
        if result.mm_per_px is None:
            return _facts(lost("the calibration has no scale")) | {"path": []}
        touches, places = np.count_nonzero(result.contact & result.known) >= LEAST_PX, self._places
        if not touches or self._sensor != sensor_of(result):
            self._sensor, self._follow = sensor_of(result), Follower(place_error=place_error)
            places.clear()
        motion = self._follow(result).motion if touches else lost("nothing touches")
        facts, last = _facts(motion), places[-1] if places else None
        if facts["shift_mm"] is not None and motion.center_mm is not None:
            middle = (np.array(result.shape[::-1]) - 1) / 2
            place = (motion.center_mm[:2] / result.mm_per_px + middle).round(2).tolist()
            if last is None or np.hypot(*np.subtract(place, last)) >= 1.0:  # px
                places.append(place)
        elif motion.state == LOST and last is not None:
            places.append(None)
        return facts | {"path": list(places)}


def _facts(motion: Motion) -> dict[str, Any]:
    """What is known of a motion."""
    blind = list(dict.fromkeys(one.words for one in motion.blind))
    facts: dict[str, Any] = {"state": motion.state, "why": motion.why, "blind": blind}
    facts |= dict.fromkeys(("shift_mm", "shift_sigma_mm", "turn_deg", "turn_sigma_deg", "axes"))
    if motion.state != FOUND or motion.pose is None or motion.covariance is None or motion.center_mm is None:
        return facts
    # A larger sigma than a quarter of that without any contact is of a direction that nothing shows.
    most_mm, most_rad = 0.25 * np.array(NO_PRIOR)
    sigma, turn = np.sqrt(np.diag(motion.covariance)), motion.pose[:3, :3]
    if _largest_sigma(motion.covariance[:2, :2]) < most_mm:
        before = moved(np.linalg.inv(motion.pose), motion.center_mm)
        facts |= {"shift_mm": (motion.center_mm - before)[:2].tolist(), "shift_sigma_mm": sigma[:2].tolist()}
    if sigma[5] < most_rad:
        yaw = float(np.arctan2(turn[1, 0], turn[0, 0]))
        facts |= {"turn_deg": float(np.degrees(yaw)), "turn_sigma_deg": float(np.degrees(sigma[5]))}
        tilted = _largest_sigma(motion.covariance[3:5, 3:5]) < most_rad
        flat = [[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)], None]
        facts["axes"] = turn[:2].T.tolist() if tilted else flat
    return facts


def _largest_sigma(covariance: NDArray[np.float64]) -> float:
    """The standard deviation along the direction in which a covariance is largest."""
    return float(np.sqrt(max(0.0, np.linalg.eigvalsh(covariance)[-1])))


LOG = logging.getLogger("gelform.live")
SETTABLE = (*CONTROLS, "led_level")  # settings of a camera that the page can change
RETRY_S = 1.0  # s between attempts to open an unavailable source
WAIT_S = 0.25  # s, longest wait for a frame or a result before the station is looked at again


@dataclass(frozen=True)
class Setup:
    """What a station reconstructs with; `replace` makes another one, which has forgotten the frames before."""

    calibration: Calibration | None = None  # None: only the image is shown
    name: str = ""  # of the calibration, in the page's list
    background: NDArray[np.float32] | None = None  # (H, W, 3), taken live; None: the calibration's own
    # Calibration, name and background before each background that was taken and can be undone, eight at most.
    earlier: tuple[tuple[Calibration, str, NDArray[np.float32] | None], ...] = ()
    memory: Memory | None = field(init=False, compare=False, default=None)  # of the sequence

    def __post_init__(self) -> None:
        """CalibrationError: the background is not of the calibrated sensor."""
        if self.calibration is not None:
            run = Reconstructor(self.calibration, background=self.background)
            object.__setattr__(self, "memory", Memory(run, look_s=LOOK_S))

    def taking(self, calibration: Calibration, name: str, background: NDArray[np.float32]) -> Setup:
        """A setup with a background that was taken now; `undone` undoes it."""
        undo = () if self.calibration is None else ((self.calibration, self.name, self.background),)
        return Setup(calibration, name, background, (*self.earlier, *undo)[-8:])

    def undone(self) -> Setup:
        """The setup before the last background that was taken."""
        *earlier, (calibration, name, background) = self.earlier
        return Setup(calibration, name, background, tuple(earlier))


@dataclass(frozen=True)
class Opening:
    """How a station opens its source."""

    open_it: Callable[[], Source]  # called again after a loss
    stall_s: float = STALL_S  # s without a frame until the source counts as lost; a held recording never does
    camera: Camera | None = None  # of this machine, that it opens
    # Camera settings chosen here; `open_it` sets them again.
    wanted: dict[str, float | str] = field(default_factory=dict)


class Station:
    """A source, its reconstruction, and the displayed results: a `Pipeline` whose sequence is the station itself.

    `number` is the page's name for it, and `spec` the user's, as it is shown: "simulated", a serial number, a path, an
    address without its password. `on_shown` is called in the station's thread when there is something new to show.
    `watched` says whether every frame is needed, as for a tap; else eight per second are reconstructed, for the memory.
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
        self.opening = opening if isinstance(opening, Opening) else Opening(opening)
        self._on_shown, self._watched = on_shown, watched
        self.newest: ShownFrame | None = None
        self.taps: list[
            Callable[[ShownFrame], None]
        ] = []  # called with each shown frame, in the station's thread
        self.turn = threading.Lock()  # held by the one action that changes the station
        self.paused = False  # whether a sensor's picture is held
        self._shows = threading.RLock()  # a function that gets the frames may hold the picture
        self.moved: MovedSince | None = None  # None if nobody asks
        self.sensor = ""  # the requested starter; "": that of the camera's make
        self.starter_problem = ""  # why there is no starter's calibration
        self._setup = Setup()
        self._first: tuple[Opening, Setup] | None = None  # while another source is shown
        self._grabber: Grabber | None = None
        self._pipeline: Pipeline[ShownFrame] | None = None
        self.examine: Callable[[Work], None] = lambda work: work()  # does slow work of this and later setups
        self._missing = ""
        self._stop, self._switched = threading.Event(), threading.Event()
        self._serial, self._begun_s = 0, -math.inf
        # Of the results of five minutes at 60 per second, for the curves.
        self._numbers: deque[tuple[float, ...]] = deque(maxlen=18_000)
        self._thread = threading.Thread(target=self._run, name=f"station {number}", daemon=True)

    def start(self) -> None:
        """Start; an unavailable source is tried again every second, and the page shows that."""
        self._thread.start()

    def close(self) -> None:
        """Stop and release the device."""
        self._stop.set()
        self._switched.set()
        if self._thread.ident is not None:
            self._thread.join(10.0)  # the threads of the pipeline and of the device take 2 s each

    @property
    def setup(self) -> Setup:
        """What it reconstructs with; a held recording is reconstructed again with another one."""
        return self._setup

    @setup.setter
    def setup(self, setup: Setup) -> None:
        if (memory := setup.memory) is not None:
            calibration = memory.reconstruct.calibration
            memory.standing = lambda: camera_findings(calibration, self.grabber)
            memory.examine = lambda work: self.examine(work)
        self._setup = setup
        self.show_again()

    def show_again(self) -> None:
        """Show a held recording's frame again, because its reconstruction has changed."""
        if self.player is not None:
            self.player.again()

    def show(self, opening: Opening, setup: Setup) -> None:
        """Show another source in place of the first one."""
        self._first = self._first or (self.opening, self._setup)
        self.opening, self._setup, self.starter_problem = opening, setup, ""
        self._switched.set()

    def show_first(self) -> None:
        """Return to the first source, with its setup of that time."""
        if self._first is not None:
            (self.opening, self._setup), self._first = self._first, None
            self._switched.set()

    @property
    def camera(self) -> Camera | None:
        """The camera of this machine that it shows or is about to open."""
        return self.opening.camera or getattr(self.source, "camera", None)

    @property
    def source(self) -> Source | None:
        """The source, once it is open."""
        return None if self._grabber is None else self._grabber.source

    @property
    def simulated(self) -> Any:
        """The source if it is a simulated sensor, which the page can press; else None."""
        return self.source if hasattr(self.source, "press_at") else None

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

    @property
    def current(self) -> ShownFrame:
        """The newest frame; GelformError before the first one."""
        if self.newest is None:
            raise GelformError("There is no frame yet. Wait for the first one.")
        return self.newest

    def pause(self, paused: bool) -> None:
        """Hold the picture, or continue; a recording is held itself."""
        if self.player is None:
            with self._shows:  # after it no frame that was in work is shown
                self.paused = paused
        else:
            self.player.play(not paused)

    @property
    def silence(self) -> str:
        """Why no frame is shown now, with the remedy; "" while frames come."""
        if self._stop.is_set():
            return "The server is stopping."
        if self.paused or (self.player is not None and not self.player.playing):
            return "The picture is held. Press Continue first."
        if self._grabber is None:
            return f"The sensor is not connected. {self._missing or 'Plug it in.'}"
        if self._grabber.state in ("reconnecting", "ended"):
            return f"The sensor gives no frames: {self._grabber.reason}."
        return ""

    def next_frames(self, count: int, timeout_s: float = 15.0) -> list[ShownFrame]:
        """The next frames; of a held recording the current one.

        GelformError: they do not arrive in time, or the station shows no frames now; the message says why.
        """
        if self.player is not None and not self.player.playing:
            return [self.current]
        got: SimpleQueue[ShownFrame] = SimpleQueue()
        found: list[ShownFrame] = []
        until_s = time.monotonic() + timeout_s
        self.taps.append(got.put)
        try:
            while len(found) < count:
                if why := self.silence:
                    raise GelformError(why)
                if (left_s := until_s - time.monotonic()) <= 0:
                    raise GelformError(
                        f"Expected {count} frames within {timeout_s:g} s, got {len(found)}. Is the camera connected?"
                    )
                with suppress(Empty):
                    found.append(got.get(timeout=min(WAIT_S, left_s)))
        finally:
            self.taps.remove(got.put)
        return found

    def numbers_since(self, serial: int) -> list[tuple[float, ...]]:
        """(serial, time_s, peak, area, volume) of all kept results after the one with that serial."""
        newest_first = takewhile(lambda row: row[0] > serial, reversed(self._numbers.copy()))
        return list(newest_first)[::-1]

    def facts(self) -> dict[str, Any]:
        """The station's state for the page."""
        grabber, setup, player, pipeline = self._grabber, self._setup, self.player, self._pipeline
        stats = None if pipeline is None else pipeline.stats()
        stage_ms = {} if stats is None else stats.stage_ms
        settings = {} if grabber is None else dict(grabber.settings)
        can_set = settings if hasattr(self.source, "set_controls") else {}
        facts: dict[str, Any] = {
            "number": self.number,
            "spec": self.spec,
            "name": self.spec if grabber is None else grabber.name,
            "serial": None if grabber is None else grabber.serial,
            "settings": settings,
            "settable": {name: can_set[name] for name in SETTABLE if name in can_set},
            "state": "missing" if grabber is None else grabber.state,
            "reason": self._missing if grabber is None else grabber.reason,
            "rate_hz": 0.0 if stats is None else stats.rate_hz,  # of results
            "took_ms": stage_ms.get("view", 0.0) + stage_ms.get("reconstruct", 0.0),
            "lost": self.lost,
            "skipped": self.skipped,
            "simulated": self.simulated is not None,
            "calibration": setup.name,
            "background": "taken on this page" if setup.background is not None else "from the calibration",
            "can_undo": bool(setup.earlier),
            "zero": setup.memory is not None and setup.memory.zero is not None,
            "motion": self.moved is not None,
            "paused": self.paused,
            "replay": None if player is None else player.facts(),
            "opened": self._first is not None,  # another source than the first one
        }
        if grabber is not None:
            facts |= {"camera_hz": grabber.stats.rate_hz, "reopened": grabber.stats.reopened}
        return facts

    @property
    def lost(self) -> int:
        """Number of camera frames lost on the way, by the gaps in the camera's own count.

        A simulated sensor loses none: it leaves out what comes too late.
        """
        return 0 if self._grabber is None or self.simulated else self._grabber.stats.drops

    @property
    def skipped(self) -> int:
        """Number of needed frames that a newer one replaced: neither drawn nor in any figure."""
        return 0 if (pipeline := self._pipeline) is None else pipeline.stats().skipped

    # -- the thread, and functions that the pipeline's threads call -------------------------------------------------

    def _run(self) -> None:
        while not self._stop.is_set():
            self._switched.clear()
            try:
                opening, self.setup = self.opening, replace(self._setup)
                with Grabber(opening.open_it, stall_s=opening.stall_s, keep=KEPT_FRAMES) as self._grabber:
                    self._show_all(self._grabber)
            except Exception as problem:
                is_bug, before = not isinstance(problem, (GelformError, OSError)), self._missing
                self._missing = f"bug: {type(problem).__name__}: {problem}" if is_bug else str(problem)
                if (
                    is_bug and self._missing != before
                ):  # once; the page shows it, and the sensor is tried again
                    LOG.exception("Sensor %s has stopped.", self.spec)
                self._grabber = None
                with suppress(Exception):  # it may be what has failed
                    self._on_shown()
                self._switched.wait(RETRY_S)

    def _show_all(self, grabber: Grabber) -> None:
        """Show results until another source is chosen; after the source's end its last frame stays."""
        pipeline = Pipeline(NewestFrames(grabber, owned=False, paused=self._waits), self)
        self._pipeline = pipeline
        pipeline.start()
        after = -1
        try:
            while not self._switched.is_set():
                shown = pipeline.results.newest(after, WAIT_S)
                if shown is not None:
                    after = shown.frame.index
                    with self._shows:
                        if not self.paused:
                            self._show(shown)
                elif pipeline.results.ended:
                    self._switched.wait(WAIT_S)
        finally:
            pipeline.close()
            self._pipeline = None

    def _waits(self) -> bool:
        """Whether to skip frames now: the picture is held, or no page is open and a result is recent."""
        unwatched = not (self._watched() or self.taps)
        return self.paused or (unwatched and time.monotonic() - self._begun_s < LOOK_S)

    def _show(self, shown: ShownFrame) -> None:
        moved, calibration = self.moved, self._setup.calibration
        if moved is not None and shown.result is not None and calibration is not None and self._watched():
            shown.motion = moved(shown.result, calibration.settings.place_error)
        self.newest = shown
        for tap in tuple(self.taps):
            try:
                tap(shown)
            except Exception:  # it ends, not the sensor
                LOG.exception("A function that gets the frames of %s has failed. It gets no more.", self.spec)
                with suppress(ValueError):  # it has gone by itself
                    self.taps.remove(tap)
        self._on_shown()

    def reconstructed(self, frame: Frame, timed: Timed) -> ShownFrame:
        """The setup's result of a frame; if reconstruction fails, the frame and the reason."""
        memory, self._serial, self._begun_s = self._setup.memory, self._serial + 1, time.monotonic()
        alone = self.player is not None
        if memory is None:
            return ShownFrame(self._serial, frame, frame.image)
        try:
            given = memory.reconstructed(frame, timed, alone=alone)
        except (GelformError, ValueError) as problem:
            return ShownFrame(self._serial, frame, frame.image, problem=str(problem))
        if (numbers := given.result.numbers) is not None:
            self._numbers.append((self._serial, frame.time_s, *numbers.over_time.values()))
        return ShownFrame(
            self._serial,
            frame,
            given.image,
            given.result,
            explain=partial(memory.reconstruct.explain, given.image),
            learn=None if alone else partial(memory.learn_from, given),
        )

    def learn_from(self, shown: ShownFrame) -> None:
        """Learn from the result of a sensor; frames of a recording are not learned from."""
        if shown.learn is not None:
            shown.learn()
