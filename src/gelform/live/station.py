"""One sensor of the page: the pipeline of its frames, the displayed results, and where the object moved."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import takewhile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.calibration_file import Calibration
from gelform.errors import GelformError
from gelform.image.frame import Frame
from gelform.live.shown import Shown
from gelform.motion.between import FOUND, LEAST_PX, LOST, NO_PRIOR, Motion, lost, sensor_of
from gelform.motion.surface import Array, moved
from gelform.motion.track import Follower
from gelform.reconstruct import Reconstructor
from gelform.result import Reconstruction
from gelform.sensors.cameras import Camera
from gelform.sensors.grabber import STALL_S, Grabber
from gelform.sensors.record import KEPT_FRAMES
from gelform.sensors.recordings.player import Player
from gelform.sensors.source import Source
from gelform.sensors.streams.memory import Memory, Timed, Work
from gelform.sensors.streams.pipeline import NewestFrames, Pipeline
from gelform.sensors.streams.sensor_health import CameraCheck

KEPT_PLACES = 256  # places of a path that are kept and sent with each frame
STEP_PX = 1.0  # px; nearer to the last place of the path there is no new one
UNSEEN = 0.25  # of the sigma without any contact; a larger sigma is that of a direction that nothing shows
UNKNOWN = dict.fromkeys(("shift_mm", "shift_sigma_mm", "turn_deg", "turn_sigma_deg", "axes"))


class MovedSince:
    """Follows the touching object from frame to frame; begins anew when nothing touches, or with another calibration."""

    def __init__(self) -> None:
        self._sensor: tuple[object, ...] = ()
        self._follow = Follower()
        self._places: deque[tuple[float, float] | None] = deque(maxlen=KEPT_PLACES)

    def __call__(self, result: Reconstruction, place_error: float | None) -> dict[str, Any]:
        """The motion up to the next frame, for the page; what is not known is None.

        Parameters
        ----------
        result : (H, W)
        place_error : as in `gelform.track`

        Returns
        -------
        dict
            `state`, `why`, `blind` : of the motion, in words
            `path` : places (x, y) in px of the contact's middle; None between two of them where the object was lost
            `shift_mm` : of the contact's middle along x and y; `shift_sigma_mm`
            `turn_deg` : about z, clockwise in the image; `turn_sigma_deg`
            `axes` : the object's x, y and z on the picture, 1 long if not tilted; z is None if the tilt is not known
        """
        if result.mm_per_px is None:
            return _facts(lost("the calibration has no scale")) | {"path": []}
        touches = np.count_nonzero(result.contact & result.known) >= LEAST_PX
        if not touches or self._sensor != sensor_of(result):
            self._sensor, self._follow = sensor_of(result), Follower(place_error=place_error)
            self._places.clear()
        motion = self._follow(result).motion if touches else lost("nothing touches")
        facts = _facts(motion)
        if facts["shift_mm"] is not None and motion.center_mm is not None:
            middle = (np.array(result.shape[::-1]) - 1) / 2
            self._add((motion.center_mm[:2] / result.mm_per_px + middle).round(2).tolist())
        elif motion.state == LOST and self._places and self._places[-1] is not None:
            self._places.append(None)
        return facts | {"path": list(self._places)}

    def _add(self, place: Any) -> None:
        last = self._places[-1] if self._places else None
        if last is None or np.hypot(*np.subtract(place, last)) >= STEP_PX:
            self._places.append(place)


def _facts(motion: Motion) -> dict[str, Any]:
    """What is known of a motion."""
    blind = list(dict.fromkeys(one.words for one in motion.blind))
    facts: dict[str, Any] = {"state": motion.state, "why": motion.why, "blind": blind, **UNKNOWN}
    if motion.state != FOUND or motion.pose is None or motion.covariance is None or motion.center_mm is None:
        return facts
    most_mm, most_rad = UNSEEN * np.array(NO_PRIOR)
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


def _largest_sigma(covariance: Array) -> float:
    """The standard deviation along the direction in which a covariance is largest."""
    return float(np.sqrt(max(0.0, np.linalg.eigvalsh(covariance)[-1])))


KEPT_NUMBERS = 18_000  # results whose numbers are kept for the curves: five minutes at 60 per second
RETRY_S = 1.0  # s between attempts to open an unavailable source
WAIT_S = 0.25  # s, longest wait for a result before a request to stop is checked
CLOSE_S = 10.0  # s for the threads of the pipeline and of the device, 2 s each
# s between reconstructed frames while no page is open. The memory learns means over a second and more, and its
# findings take at least a quarter of a second, so eight frames per second are enough.
UNWATCHED_S = 0.125
KEPT_BACKGROUNDS = 8  # that can be undone
NEVER_S = float("inf")  # a held recording has not stalled
STAGES = ("view", "reconstruct")  # stages whose times add up to the displayed time of reconstruction


@dataclass(frozen=True)
class Setup:
    """What a station reconstructs with.

    Attributes
    ----------
    memory : the Reconstructor with the memory of the sequence; None without a calibration: only the image is shown
    name : of the calibration, in the page's list
    solver : the chosen one, "auto" by default
    background : (H, W, 3) float32 taken live, or None: the calibration's own
    earlier : (calibration, name, background) before each background that was taken and can be undone
    """

    memory: Memory | None = None
    name: str = ""
    solver: str = "auto"
    background: NDArray[np.float32] | None = None
    earlier: tuple[tuple[Calibration, str, NDArray[np.float32] | None], ...] = ()

    @property
    def calibration(self) -> Calibration | None:
        """The calibration in use."""
        return None if self.memory is None else self.memory.reconstruct.calibration

    def with_calibration(
        self, calibration: Calibration, name: str, background: NDArray[np.float32] | None = None
    ) -> Setup:
        """A setup with another calibration, and its own background or one taken live."""
        run = Reconstructor(calibration, background=background, solver=self.solver)
        return Setup(Memory(run), name, self.solver, background)

    def with_background(self, background: NDArray[np.float32] | None) -> Setup:
        """A setup with a new background; None: the calibration's own.

        Raises
        ------
        CalibrationError
            The background is not of the calibrated sensor.
        """
        return replace(self, background=background).anew()

    def taking(self, calibration: Calibration, name: str, background: NDArray[np.float32]) -> Setup:
        """As `with_calibration`, for a background that was taken now; `undone` undoes it."""
        undo = () if self.calibration is None else ((self.calibration, self.name, self.background),)
        made = self.with_calibration(calibration, name, background)
        return replace(made, earlier=(*self.earlier, *undo)[-KEPT_BACKGROUNDS:])

    def undone(self) -> Setup:
        """The setup before the last background that was taken."""
        *earlier, before = self.earlier
        return replace(self.with_calibration(*before), earlier=tuple(earlier))

    def with_solver(self, solver: str) -> Setup:
        """A setup with another solver."""
        return replace(self, solver=solver).anew()

    def anew(self) -> Setup:
        """A setup for another sequence of frames, without memory."""
        if self.calibration is None:
            return self
        return replace(
            self.with_calibration(self.calibration, self.name, self.background), earlier=self.earlier
        )


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
    spec : the user's spec as it is shown: "simulated", a serial number, a path, an address without its password
    opening : how to open its source, or the function that opens it
    on_shown : called in the station's thread when there is something new to show
    watched : whether every frame is needed, as for a tap; else eight per second are reconstructed, for the memory

    Attributes
    ----------
    setup : Setup; assign another one to change it: a held recording is then reconstructed again
    newest : Shown or None
    taps : called with each shown frame, in the station's thread: guides
    turn : held by the one action that changes the station
    paused : whether a sensor's picture is held
    moved : follows the touching object from frame to frame; None if nobody asks
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
        self.turn = threading.Lock()
        self.paused = False
        self.moved: MovedSince | None = None
        self.sensor = self.starter_problem = ""
        self._given = self._opening = opening if isinstance(opening, Opening) else Opening(opening)
        self._given_setup = self._setup
        self._on_shown, self._watched = on_shown, watched
        self._grabber: Grabber | None = None
        self._pipeline: Pipeline[Shown] | None = None
        self._examine: Callable[[Work], None] | None = None
        self._missing = ""
        self._stop, self._switched = threading.Event(), threading.Event()
        self._serial, self._begun_s = 0, -NEVER_S
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
        if setup.memory is not None and setup.memory is not self._setup.memory:
            self._prepare(setup.memory)
        self._setup = setup
        self.show_again()

    def show_again(self) -> None:
        """Show a held recording's frame again, because its reconstruction has changed."""
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

    def pause(self, paused: bool) -> None:
        """Hold the picture, or continue; a recording is held itself."""
        if self.player is None:
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

    def numbers_since(self, serial: int) -> list[tuple[float, ...]]:
        """(serial, time_s, peak, area, volume) of all kept results after the one with that serial."""
        newest_first = takewhile(lambda row: row[0] > serial, reversed(self._numbers.copy()))
        return list(newest_first)[::-1]

    def facts(self) -> dict[str, Any]:
        """The station's state for the page."""
        grabber, setup, player, pipeline = self._grabber, self.setup, self.player, self._pipeline
        calibration, memory = setup.calibration, setup.memory
        stage_ms = {} if pipeline is None else pipeline.stats().stage_ms
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
            "simulated": self.simulated is not None,
            "calibration": setup.name,
            "image_shape": None if calibration is None else list(calibration.image_shape),
            "background": "taken on this page" if setup.background is not None else "from the calibration",
            "can_undo": bool(setup.earlier),
            "zero": memory is not None and memory.zero is not None,
            "solver": setup.solver,
            "motion": self.moved is not None,
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
        """Number of camera frames lost on the way, by the gaps in the camera's own count.

        A simulated sensor loses none: it leaves out what comes too late.
        """
        return 0 if self._grabber is None or self.simulated else self._grabber.stats.drops

    @property
    def skipped(self) -> int:
        """Number of needed frames that a newer one replaced: neither drawn nor in any figure."""
        return 0 if self._pipeline is None else self._pipeline.stats().skipped

    @property
    def rate_hz(self) -> float:
        """Results per second; 0 if the last one is older than a second."""
        return 0.0 if self._pipeline is None else self._pipeline.stats().rate_hz

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
        after = -1
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
            self._pipeline = self._examine = None

    def _waits(self) -> bool:
        """Whether to skip frames now: the picture is held, or no page is open and a result is recent."""
        unwatched = not (self._watched() or self.taps)
        return self.paused or (unwatched and time.monotonic() - self._begun_s < UNWATCHED_S)

    def _show(self, shown: Shown) -> None:
        moved, calibration = self.moved, self.setup.calibration
        if moved is not None and shown.result is not None and calibration is not None and self._watched():
            shown.motion = moved(shown.result, calibration.settings.place_error)
        self.newest = shown
        for tap in tuple(self.taps):
            tap(shown)
        self._on_shown()

    def run_by(self, examine: Callable[[Work], None]) -> None:
        """Run slow work of this and later setups elsewhere."""
        self._examine = examine
        if self._setup.memory is not None:
            self._prepare(self._setup.memory)

    def _prepare(self, memory: Memory) -> None:
        """Run a memory's slow work elsewhere, and have it compare the camera with the calibration."""
        if self._examine is not None:
            memory.run_by(self._examine)
        check = CameraCheck(memory.reconstruct.calibration)
        memory.standing = lambda: check(self.grabber)

    def reconstructed(self, frame: Frame, timed: Timed) -> Shown:
        """The setup's result of a frame; if reconstruction fails, the frame and the reason."""
        memory, self._serial, self._begun_s = self._setup.memory, self._serial + 1, time.monotonic()
        alone = self.player is not None
        if memory is None:
            return Shown(self._serial, frame, frame.image)
        try:
            given = memory.reconstructed(frame, timed, alone=alone)
        except (GelformError, ValueError) as problem:
            return Shown(self._serial, frame, frame.image, problem=str(problem))
        if (numbers := given.result.numbers) is not None:
            self._numbers.append((self._serial, frame.time_s, *numbers.over_time.values()))
        return Shown(
            self._serial,
            frame,
            given.image,
            given.result,
            explain=partial(memory.reconstruct.explain, given.image),
            learn=None if alone else partial(memory.learn_from, given),
        )

    def learn_from(self, shown: Shown) -> None:
        """Learn from the result of a sensor; frames of a recording are not learned from."""
        if shown.learn is not None:
            shown.learn()
