"""The frames of a stream and its threads: one reconstructs the newest frame, one learns, one examines the sensor."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import inf, nan
from os import PathLike
from statistics import median
from threading import Event, Lock, Thread
from typing import Any, Generic, Protocol, TypeVar

from gelform.image.view import Frame
from gelform.sensors.grabber import Grabber, Newest
from gelform.sensors.source import Source, checked_frame, open_source, spec_of
from gelform.sensors.streams.memory import Timed, Work

SourceLike = str | PathLike[str] | int | Source | Callable[[], Source] | Grabber


class Feed(Protocol):
    """Frames for one stream."""

    every: bool  # whether each frame is given, or only the newest one
    camera: Source | Grabber  # with the serial number, and the settings as read back

    @property
    def skipped(self) -> int:
        """Number of frames that arrived, and that a newer one replaced before this feed was asked for them."""

    @property
    def state(self) -> str:
        """One of "starting", "running", "reconnecting", "ended"."""

    @property
    def reason(self) -> str:
        """The reason of the state, as a sentence."""

    def next(self, after_index: int) -> Frame | None:
        """A frame with a number above `after_index`; None if none arrived within a moment, or at the end."""

    def close(self) -> None:
        """Close the objects that the feed itself opened."""


class NewestFrames:
    """The newest frames of a running grabber, which closes with the feed if it is `owned`: others may share it.

    None is given while `paused()` is true; frames of that time are not skipped.
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
            time.sleep(0.1)  # s between checks whether the pause is over
            return None
        frame = self._grabber.newest(after_index, 0.1)  # s, before a request to stop is checked
        if frame is not None:
            before, self._lost = self._lost, self._grabber.stats.drops
            missing = frame.index - after_index - 1 - (self._lost - before)
            self.skipped += 0 if self._waited else max(0, missing)
            self._waited = False
        return frame

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
    """Open the feed of what `stream` takes as a source.

    SensorError, DataError: it cannot be opened; the message lists the available ones.
    """
    source = spec_of(source)
    if isinstance(source, Grabber):
        return NewestFrames(source, owned=False)
    if hasattr(source, "live"):
        opened: Any = source
        if not opened.live:
            return EveryFrame(opened)
        return NewestFrames(Grabber(lambda: opened).__enter__(), owned=True)
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

Value = TypeVar("Value")


@dataclass(frozen=True)
class StreamStats:
    """The current state of a stream."""

    state: str  # "starting", "running", "reconnecting", "ended", "failed", "closed"
    reason: str  # as a sentence, if there is one
    results: int  # number of reconstructed frames
    drops: int  # number of frames missing between the first and the last result, wherever they were lost
    skipped: int  # number of those that arrived, and were wanted, and that a newer one replaced
    rate_hz: float  # results per second over the last 120; 0 before the second one, or if a sensor's last is a second old
    age_s: float  # time since the capture of the newest result's frame; infinite before the first one
    latency_ms: float  # from capture to result, the median of the last 120; NaN before the first one
    # Median time of a stage over its last 120 frames: `wait` (from capture to pick-up), `view`, `reconstruct`, `remember`.
    stage_ms: dict[str, float]


class RunningSequence(Protocol[Value]):
    """Makes results from frames, in order: a `Memory`, or a sensor of the live page."""

    examine: Callable[[Work], None]  # makes slow work; the pipeline makes it elsewhere

    def reconstructed(self, frame: Frame, timed: Timed) -> Value:
        """The result of a frame; `timed(stage)` times a block."""

    def learn_from(self, given: Value) -> None:
        """Learn for the coming frames, after the result was given out."""


class Pipeline(Generic[Value]):
    """Turns frames into results on its own threads, until the feed ends or the pipeline is closed.

    Each result is given out before anything is learned from it. For a recording, one thread learns frame by frame, so
    that the results are the same each time. An exception in a stage ends the pipeline and is raised to the readers of
    `results`.

    It closes the running feed with itself. `recent` holds the last `keep` results.
    """

    def __init__(self, feed: Feed, sequence: RunningSequence[Value], *, keep: int = 0) -> None:
        self.feed = feed
        self.sequence = sequence
        self.results: Newest[Value] = Newest(every=feed.every, rated=RECENT)
        self.recent: deque[Value] = deque(maxlen=keep)
        self._to_learn: Newest[Value] = Newest()
        self._checks: Newest[Work] = Newest()
        self._stop, self._lock = Event(), Lock()
        self._times_s: dict[str, deque[float]] = {}  # of each stage, and from capture to result
        self._captured_s = -inf  # of the newest result
        stages = {"reconstruct": self._reconstruct}
        if not feed.every:
            # Only the newest one is made, if they come too fast.
            sequence.examine = lambda check: self._checks.put(self._checks.number + 1, check)
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
        results = self.results
        with self._lock:
            stage_ms = {name: 1e3 * median(times) for name, times in self._times_s.items()}
        with results.changed:
            stale = not self.feed.every and (results.age_s or 0.0) > STALE_S
            return StreamStats(
                state=state,
                reason=reason,
                results=results.count,
                drops=results.number + 1 - results.first - results.count,
                skipped=self.feed.skipped,
                rate_hz=0.0 if stale else results.rate_hz,
                age_s=time.monotonic() - self._captured_s,
                latency_ms=stage_ms.pop("latency", nan),
                stage_ms=stage_ms,
            )

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Time the block as a stage."""
        start_s = time.monotonic()
        yield
        self.took(stage, time.monotonic() - start_s)

    def took(self, stage: str, seconds: float) -> None:
        """Add a time to a stage."""
        with self._lock:
            self._times_s.setdefault(stage, deque(maxlen=RECENT)).append(seconds)

    def close(self) -> None:
        """Stop the threads and release the source; every wait has a limit."""
        self._stop.set()
        self._end()
        self.feed.close()
        for thread in self._threads:
            if thread.ident is not None:
                thread.join(2.0)  # s; one that hangs in a device ends with the process

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
            self.took("wait", time.monotonic() - frame.time_s)
        given = self.sequence.reconstructed(frame, self.timed)
        if self.feed.every:
            self.sequence.learn_from(given)
        self.recent.append(given)
        self._captured_s = frame.time_s
        self.took("latency", time.monotonic() - frame.time_s)
        self.results.put(frame.index, given)
        self._to_learn.put(frame.index, given)

    def _learn(self) -> None:
        for given in self._to_learn:
            with self.timed("learn"):
                self.sequence.learn_from(given)

    def _examine(self) -> None:
        for check in self._checks:
            check()
