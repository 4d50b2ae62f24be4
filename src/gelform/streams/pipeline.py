"""The threads of a stream: one turns the newest frame into a result, one learns from results, one examines the sensor."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from statistics import median
from threading import Condition, Event, Lock, Thread
from typing import Generic, Protocol, TypeVar

import cv2

from gelform.frames import Frame
from gelform.streams.feed import Feed
from gelform.streams.memory import Timed, Work

RECENT = 120  # frames that rates and times are taken from
JOIN_S = 2.0  # for each thread at close; one that hangs in a device dies with the process

Value = TypeVar("Value")


@dataclass(frozen=True)
class StreamStats:
    """How a stream is doing at this moment.

    Attributes
    ----------
    state : "starting", "running", "reconnecting", "ended", "failed", "closed"
    reason : why, in a sentence, where there is something to say
    results : how many frames were reconstructed
    drops : how many frames between the first and the last result are missing, wherever they were lost
    rate_hz : results a second, over the last 120; 0 before the second one
    age_s : how long ago the newest result's frame was captured; infinite before the first one
    latency_ms : from capture to result, the median of the last 120; NaN before the first one
    stage_ms : name -> median time of a stage over its last 120 frames: `wait` (from capture to pick-up), `view`,
        `reconstruct`, `remember`
    """

    state: str
    reason: str
    results: int
    drops: int
    rate_hz: float
    age_s: float
    latency_ms: float
    stage_ms: dict[str, float]


class Meter:
    """Counts and times what the stages of one stream do; shared by their threads."""

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
        """Count the time of the block for a stage."""
        start = time.monotonic()
        yield
        self.add(stage, time.monotonic() - start)

    def add(self, stage: str, seconds: float) -> None:
        """Count a time for a stage."""
        with self._lock:
            self._stages.setdefault(stage, deque(maxlen=RECENT)).append(seconds)

    def given(self, index: int, captured_s: float) -> None:
        """Count a result: of which frame, and when that was captured."""
        now = time.monotonic()
        with self._lock:
            self._results += 1
            if self._last_index is not None:
                self._drops += max(0, index - self._last_index - 1)
            self._last_index, self._last_captured = index, captured_s
            self._given.append(now)
            self._latencies.append(now - captured_s)

    def stats(self, state: str, reason: str) -> StreamStats:
        """What was counted so far."""
        with self._lock:
            span = self._given[-1] - self._given[0] if len(self._given) > 1 else 0.0
            captured = self._last_captured
            return StreamStats(
                state=state,
                reason=reason,
                results=self._results,
                drops=self._drops,
                rate_hz=(len(self._given) - 1) / span if span > 0 else 0.0,
                age_s=float("inf") if captured is None else time.monotonic() - captured,
                latency_ms=1e3 * median(self._latencies) if self._latencies else float("nan"),
                stage_ms={name: 1e3 * median(times) for name, times in self._stages.items()},
            )


class HandOver(Generic[Value]):
    """Keeps the newest value for any number of readers, who each remember the number of what they read last.

    Parameters
    ----------
    every : values are not replaced before someone has read them: for recordings, of which no frame is to be lost

    Attributes
    ----------
    ended : whether nothing more comes
    error : what ended it, or None
    """

    def __init__(self, *, every: bool = False) -> None:
        self.ended = False
        self.error: BaseException | None = None
        self._every = every
        self._changed = Condition()
        self._value: Value | None = None
        self._number = self._expected = -1
        self._read = True

    def expect(self, number: int) -> None:
        """Say that the value of this number is being made: who asks now gets it, instead of an older one."""
        with self._changed:
            self._expected = number

    def put(self, number: int, value: Value) -> None:
        """Make this the newest value; numbers grow from 0."""
        with self._changed:
            if self._every:
                self._changed.wait_for(lambda: self._read or self.ended)
            self._number, self._value, self._read = number, value, False
            self._changed.notify_all()

    def newest(self, after: int = -1, timeout_s: float | None = None) -> Value | None:
        """The newest value, whose number is larger than `after`; None at the end, or when the time is over.

        Where a newer one was being made when it was asked for, it is waited for: a value that has lain here gets older,
        and is given only where the time is over before the newer one is there.

        BaseException: what ended the thread that puts values, once there is no value left that the reader has not had.
        """
        found = self._numbered(after, timeout_s)
        return None if found is None else found[1]

    def __iter__(self) -> Iterator[Value]:
        """Values until the end; of those put while one was in use, the newest."""
        number = -1
        while (found := self._numbered(number, None)) is not None:
            number, value = found
            yield value

    def _numbered(self, after: int, timeout_s: float | None) -> tuple[int, Value] | None:
        with self._changed:
            least = max(after + 1, self._expected)
            self._changed.wait_for(lambda: self._number >= least or self.ended, timeout_s)
            if self._value is not None and self._number > after:
                self._read = True
                self._changed.notify_all()
                return self._number, self._value
            if self.error is not None:
                raise self.error
            return None

    def end(self, error: BaseException | None = None) -> None:
        """Nothing more comes; with `error`, because of it. Wakes everybody; the first end counts."""
        with self._changed:
            if not self.ended:
                self.ended, self.error = True, error
            self._changed.notify_all()


class Sequence(Protocol[Value]):
    """What makes results of frames, in order: a `Memory`, or a sensor of the live page."""

    def reconstructed(self, frame: Frame, timed: Timed) -> Value:
        """What is given of a frame; `timed(stage)` counts the time of a block."""

    def learn_from(self, given: Value) -> None:
        """Learn for the frames to come, after the result was given."""

    def run_by(self, helper: Callable[[Work], Work], examine: Callable[[Work], None] | None) -> None:
        """Have slow work run elsewhere."""


class Pipeline(Generic[Value]):
    """Frames to results on threads of their own, until the feed ends or the pipeline is closed.

    A result is given out before anything is learned from it. A recording is learned from frame by frame in one thread,
    so that it gives the same results each time. An exception in a stage ends the pipeline and reaches whoever reads
    `results`.

    Parameters
    ----------
    feed : of frames, running; closed with the pipeline
    sequence : makes the results; its slow work gets threads
    keep : how many of the last results are held in `recent`
    """

    def __init__(self, feed: Feed, sequence: Sequence[Value], *, keep: int = 0) -> None:
        self.feed = feed
        self.sequence = sequence
        self.meter = Meter()
        self.results: HandOver[Value] = HandOver(every=feed.every)
        self.recent: deque[Value] = deque(maxlen=keep)
        self._to_learn: HandOver[Value] = HandOver()
        self._checks: HandOver[Work] = HandOver()
        self._checks_asked = 0
        self._stop = Event()
        self._helper = ThreadPoolExecutor(1, "gelform sigma")
        sequence.run_by(lambda work: self._helper.submit(work).result, None if feed.every else self._ask)
        stages = {"reconstruct": self._reconstruct}
        if not feed.every:
            stages |= {"learn": self._learn, "examine": self._examine}
        self._threads = [
            Thread(target=self._stage, args=(work,), name=f"gelform {name}", daemon=True)
            for name, work in stages.items()
        ]

    def start(self) -> None:
        """Start the threads; OpenCV's own are turned off, for the whole process: there is one thread per stage."""
        cv2.setNumThreads(1)
        for thread in self._threads:
            thread.start()

    def stats(self) -> StreamStats:
        """How the stream is doing."""
        state, reason = self.feed.state, self.feed.reason
        if self._stop.is_set():
            state, reason = "closed", ""
        elif self.results.error is not None:
            state, reason = "failed", str(self.results.error)
        elif state == "ended" and not self.results.ended:
            state = "running"  # the last frames are still on their way
        return self.meter.stats(state, reason)

    def close(self) -> None:
        """Stop the threads and give the source back; every wait is bounded."""
        self._stop.set()
        self._end()
        self.feed.close()
        for thread in self._threads:
            if thread.ident is not None:
                thread.join(JOIN_S)
        self._helper.shutdown()

    def _end(self, error: BaseException | None = None) -> None:
        self.results.end(error)
        self._to_learn.end()
        self._checks.end()

    def _stage(self, work: Callable[[], None]) -> None:
        """Run a stage; when it ends or fails, so do the others."""
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
        """Make a frame's result and put it where readers are."""
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
        """Have a check made by its own thread: the newest one, where they come too fast."""
        self._checks.put(self._checks_asked, check)
        self._checks_asked += 1

    def _examine(self) -> None:
        for check in self._checks:
            check()
