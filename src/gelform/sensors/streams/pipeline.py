"""The frames of a stream and its threads: one reconstructs the newest frame, one learns, one examines the sensor."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from statistics import median
from threading import Event, Lock, Thread
from typing import Any, Generic, Protocol, TypeVar

from gelform.image.frame import Frame
from gelform.sensors.grabber import Grabber, Newest, rate_hz_of
from gelform.sensors.source import Source, checked_frame, open_source
from gelform.sensors.streams.memory import Timed, Work

WAKE_S = 0.2  # s, longest wait for a frame before a request to stop is checked
PAUSED_S = 0.05  # s between checks whether the pause is over

SourceLike = str | PathLike[str] | Source | Callable[[], Source] | Grabber


class Feed(Protocol):
    """Frames for one stream.

    Attributes
    ----------
    every : True if each frame is given, False if only the newest one
    camera : has the serial number, and the settings as read back
    state, reason : "starting", "running", "reconnecting" or "ended"; the reason as a sentence
    skipped : number of frames that arrived, and that a newer one replaced before this feed was asked for them
    """

    every: bool
    camera: Source | Grabber

    @property
    def skipped(self) -> int: ...

    @property
    def state(self) -> str: ...

    @property
    def reason(self) -> str: ...

    def next(self, after_index: int) -> Frame | None:
        """A frame with a number above `after_index`; None if none arrived within a moment, or at the end."""

    def close(self) -> None:
        """Close the objects that the feed itself opened."""


class NewestFrames:
    """The newest frames of a grabber.

    Parameters
    ----------
    grabber : running
    owned : True if the grabber closes with the feed; a grabber that the caller passed stays open for other consumers
    paused : returns True while no frame is to be given; frames of that time are not skipped
    """

    every = False

    def __init__(self, grabber: Grabber, *, owned: bool, paused: Callable[[], bool] = lambda: False) -> None:
        self.camera: Source | Grabber = grabber
        self._grabber, self._owned, self._paused = grabber, owned, paused
        self.skipped, self._lost, self._waited = 0, 0, True

    @property
    def state(self) -> str:
        return self._grabber.state

    @property
    def reason(self) -> str:
        return self._grabber.reason

    def next(self, after_index: int) -> Frame | None:
        if self._paused():
            self._waited = True
            time.sleep(PAUSED_S)
            return None
        frame = self._grabber.newest(after_index, WAKE_S)
        if frame is not None:
            self._count_skipped(frame.index - after_index - 1)
        return frame

    def _count_skipped(self, missing: int) -> None:
        """Count the frames between two that were given, except those that were lost before, or not wanted."""
        before, self._lost = self._lost, self._grabber.stats.drops
        if not self._waited:
            self.skipped += max(0, missing - (self._lost - before))
        self._waited = False

    def close(self) -> None:
        if self._owned:
            self._grabber.close()


class EveryFrame:
    """Each frame of a recording in order, on request."""

    every = True
    skipped = 0

    def __init__(self, source: Source) -> None:
        self.camera: Source | Grabber = source
        self._frames = iter(source)
        self.state, self.reason = "running", ""

    def next(self, after_index: int) -> Frame | None:
        frame = next(self._frames, None)
        if frame is None:
            self.state, self.reason = "ended", "the source has no more frames"
            return None
        return checked_frame(frame, after_index, self.camera.name)

    def close(self) -> None:
        self.camera.close()


def feed_from_source(source: SourceLike) -> Feed:
    """Open the feed of a source.

    Parameters
    ----------
    source : argument of `open_source`, or a function that opens a source and is called again after a loss; an open
        Source; or a running Grabber, which other streams may share

    Raises
    ------
    SensorError, DataError
        The source cannot be opened; the message lists the available ones.
    """
    if isinstance(source, Grabber):
        return NewestFrames(source, owned=False)
    if hasattr(source, "live"):
        opened: Any = source
        return (
            NewestFrames(Grabber(lambda: opened).__enter__(), owned=True)
            if opened.live
            else EveryFrame(opened)
        )
    if not (callable(source) or isinstance(source, (str, PathLike))):
        raise TypeError(
            f"Expected a source: text, a path, a Source or a Grabber, got {type(source).__name__}."
        )
    grabber = Grabber(source).__enter__()
    if grabber.source.live:
        return NewestFrames(grabber, owned=True)
    grabber.close()  # a recording must give every frame: read it again, frame by frame
    return EveryFrame(source() if callable(source) else open_source(source))


RECENT = 120  # frames over which rates and times are measured
STALE_S = 1.0  # s without a result until the rate of a sensor is 0
JOIN_S = 2.0  # s per thread at close; a thread that hangs in a device ends with the process

Value = TypeVar("Value")


@dataclass(frozen=True)
class StreamStats:
    """The current state of a stream.

    Attributes
    ----------
    state : "starting", "running", "reconnecting", "ended", "failed", "closed"
    reason : the reason as a sentence, if there is one
    results : number of reconstructed frames
    drops : number of frames missing between the first and the last result, wherever they were lost
    skipped : number of frames among them that arrived, and were wanted, and that a newer one replaced
    rate_hz : results per second, over the last 120; 0 before the second one, or if a sensor's last one is a second old
    age_s : time since the capture of the newest result's frame; infinite before the first one
    latency_ms : from capture to result, the median of the last 120; NaN before the first one
    stage_ms : name -> median time of a stage over its last 120 frames: `wait` (from capture to pick-up), `view`,
        `reconstruct`, `remember`
    """

    state: str
    reason: str
    results: int
    drops: int
    skipped: int
    rate_hz: float
    age_s: float
    latency_ms: float
    stage_ms: dict[str, float]


class Meter:
    """Counts and times the stages of one stream; shared by its threads."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._stages: dict[str, deque[float]] = {}
        self._given: deque[float] = deque(maxlen=RECENT)
        self._latencies: deque[float] = deque(maxlen=RECENT)
        self._results = self._drops = 0
        self._last_index: int | None = None
        self._last_captured: float | None = None

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Time the block as a stage."""
        start = time.monotonic()
        yield
        self.add(stage, time.monotonic() - start)

    def add(self, stage: str, seconds: float) -> None:
        """Add a time to a stage."""
        with self._lock:
            self._stages.setdefault(stage, deque(maxlen=RECENT)).append(seconds)

    def given(self, index: int, captured_s: float) -> None:
        """Count a result, by its frame number and capture time."""
        now = time.monotonic()
        with self._lock:
            self._results += 1
            if self._last_index is not None:
                self._drops += max(0, index - self._last_index - 1)
            self._last_index, self._last_captured = index, captured_s
            self._given.append(now)
            self._latencies.append(now - captured_s)

    def stats(self, state: str, reason: str, skipped: int = 0, *, live: bool = False) -> StreamStats:
        """The figures so far; `skipped` is the feed's, `live` says whether it is a sensor's."""
        with self._lock:
            stale = live and bool(self._given) and time.monotonic() - self._given[-1] > STALE_S
            captured = self._last_captured
            return StreamStats(
                state=state,
                reason=reason,
                results=self._results,
                drops=self._drops,
                skipped=skipped,
                rate_hz=0.0 if stale else rate_hz_of(self._given),
                age_s=float("inf") if captured is None else time.monotonic() - captured,
                latency_ms=1e3 * median(self._latencies) if self._latencies else float("nan"),
                stage_ms={name: 1e3 * median(times) for name, times in self._stages.items()},
            )


class RunningSequence(Protocol[Value]):
    """Makes results from frames, in order: a `Memory`, or a sensor of the live page."""

    def reconstructed(self, frame: Frame, timed: Timed) -> Value:
        """The result of a frame; `timed(stage)` times a block."""

    def learn_from(self, given: Value) -> None:
        """Learn for the coming frames, after the result was given out."""

    def run_by(self, examine: Callable[[Work], None]) -> None:
        """Run slow work elsewhere."""


class Pipeline(Generic[Value]):
    """Turns frames into results on its own threads, until the feed ends or the pipeline is closed.

    Each result is given out before anything is learned from it. For a recording, one thread learns frame by frame, so
    that the results are the same each time. An exception in a stage ends the pipeline and is raised to the readers of
    `results`.

    Parameters
    ----------
    feed : running source of frames; closed with the pipeline
    sequence : makes the results; its slow work runs on threads
    keep : number of last results held in `recent`
    """

    def __init__(self, feed: Feed, sequence: RunningSequence[Value], *, keep: int = 0) -> None:
        self.feed = feed
        self.sequence = sequence
        self.meter = Meter()
        self.results: Newest[Value] = Newest(every=feed.every)
        self.recent: deque[Value] = deque(maxlen=keep)
        self._to_learn: Newest[Value] = Newest()
        self._checks: Newest[Work] = Newest()
        self._checks_asked = 0
        self._stop = Event()
        stages = {"reconstruct": self._reconstruct}
        if not feed.every:
            sequence.run_by(self._ask)
            stages |= {"learn": self._learn, "examine": self._examine}
        self._threads = [
            Thread(target=self._stage, args=(work,), name=f"gelform {name}", daemon=True)
            for name, work in stages.items()
        ]

    def start(self) -> None:
        """Start the threads, one per stage."""
        for thread in self._threads:
            thread.start()

    def stats(self) -> StreamStats:
        """The current state of the stream."""
        state, reason = self.feed.state, self.feed.reason
        if self._stop.is_set():
            state, reason = "closed", ""
        elif self.results.error is not None:
            state, reason = "failed", str(self.results.error)
        elif state == "ended" and not self.results.ended:
            state = "running"  # the last frames are still in work
        return self.meter.stats(state, reason, self.feed.skipped, live=not self.feed.every)

    def close(self) -> None:
        """Stop the threads and release the source; every wait has a limit."""
        self._stop.set()
        self._end()
        self.feed.close()
        for thread in self._threads:
            if thread.ident is not None:
                thread.join(JOIN_S)

    def _end(self, error: BaseException | None = None) -> None:
        self.results.end(error)
        self._to_learn.end()
        self._checks.end()

    def _stage(self, work: Callable[[], None]) -> None:
        """Run a stage; when it ends or fails, end the others too."""
        try:
            work()
        except BaseException as problem:
            self._end(problem)
        else:
            self._end()

    def _reconstruct(self) -> None:
        index = -1
        while not (self._stop.is_set() or self.results.ended):
            frame = self.feed.next(index)
            if frame is not None:
                index = frame.index
                self._give(frame)
            elif self.feed.state == "ended":
                return

    def _give(self, frame: Frame) -> None:
        """Make a frame's result and give it to the readers."""
        if not self.feed.every:
            self.results.expect(frame.index)
            self.meter.add("wait", time.monotonic() - frame.time_s)
        given = self.sequence.reconstructed(frame, self.meter.timed)
        if self.feed.every:
            self.sequence.learn_from(given)
        self.recent.append(given)
        self.meter.given(frame.index, frame.time_s)
        self.results.put(frame.index, given)
        self._to_learn.put(frame.index, given)

    def _learn(self) -> None:
        for given in self._to_learn:
            with self.meter.timed("learn"):
                self.sequence.learn_from(given)

    def _ask(self, check: Work) -> None:
        """Have a thread make a check; only the newest one, if they come too fast."""
        self._checks.put(self._checks_asked, check)
        self._checks_asked += 1

    def _examine(self) -> None:
        for check in self._checks:
            check()
