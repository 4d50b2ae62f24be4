"""What does not end: its newest value, and the newest frame of a source, which one thread reads and reopens."""

from __future__ import annotations

import os
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from os import PathLike
from typing import Generic, TypeVar

from gelform.errors import SensorError, SourceLostError
from gelform.foundations.checks import check_within
from gelform.image.view import Frame
from gelform.sensors.playback import Closing
from gelform.sensors.source import Source, checked_frame, open_source

STALL_S = 0.5  # s without a frame until "reconnecting"; robots' recorders give up after as long

Value = TypeVar("Value")


class Shared(Iterator[Value]):
    """An iterator that several threads may share: each value goes to one of them."""

    def __init__(self, values: Iterator[Value]) -> None:
        self._values, self._lock = values, threading.Lock()

    def __next__(self) -> Value:
        with self._lock:
            return next(self._values)


class Newest(Generic[Value]):
    """Keeps the newest value and its figures for any number of readers; each remembers the last number that it read.

    It holds `keep` values, for readers of each one. With `every`, a value stays until someone has read it, for recordings,
    of which no frame may be lost. The times of the last `rated` values give their rate.
    """

    def __init__(self, *, keep: int = 1, every: bool = False, rated: int = 60) -> None:
        self.changed = threading.Condition()
        self.number, self.first = -1, 0  # of the newest value, -1 before it, and of the first
        # Number of values, and of those that newer ones replaced before anyone asked for them.
        self.count = self.unseen = 0
        self.ended = False  # whether no more values will come
        self.error: BaseException | None = None  # that ended it
        self.times_s: deque[float] = deque(maxlen=rated)  # of the last values
        self._time_s: float | None = None  # of the newest one
        self._every = every
        self._process = os.getpid()
        self._held: deque[tuple[int, Value]] = deque(maxlen=keep)
        self._asked = self._expected = -1

    @property
    def rate_hz(self) -> float:
        """Values per second, by their times; 0 before the second one."""
        with self.changed:
            span_s = self.times_s[-1] - self.times_s[0] if len(self.times_s) > 1 else 0.0
            return (len(self.times_s) - 1) / span_s if span_s > 0 else 0.0

    @property
    def age_s(self) -> float | None:
        """Seconds since the time of the newest value; None before the first."""
        return None if self._time_s is None else time.monotonic() - self._time_s

    def expect(self, number: int) -> None:
        """Announce that the value of this number is being made: readers wait for it instead of taking an older one."""
        with self.changed:
            self._expected = number

    def put(self, number: int, value: Value, time_s: float | None = None) -> None:
        """Make this the newest value; numbers grow from 0. Its time is of the monotonic clock, by default now."""
        with self.changed:
            self._time_s = time.monotonic() if time_s is None else time_s
            self.times_s.append(self._time_s)
            if self._every:
                self.changed.wait_for(lambda: self._asked >= self.number or self.ended)
            self.unseen += self.number > self._asked and len(self._held) == self._held.maxlen
            self.first = number if self.count == 0 else self.first
            self.number, self.count = number, self.count + 1
            self._held.append((number, value))
            self.changed.notify_all()

    def after(
        self, number: int = -1, timeout_s: float | None = None, *, oldest: bool = False
    ) -> tuple[int, Value] | None:
        """The newest, or the oldest held, value above a number, with its own; None at the end or after the timeout.

        If a newer value was being made at the time of the call, this waits for it, because a stored value ages. The
        stored one is returned only if the timeout passes first.

        BaseException: the error that ended the writing thread, once the reader has had every value. SensorError: a fork
        has copied the object, but not the thread that writes.
        """
        if os.getpid() != self._process:
            raise SensorError(
                "This sensor was opened before a fork, in the other process. Open it again in this one."
            )
        with self.changed:
            least = max(number + 1, self._expected)
            self.changed.wait_for(lambda: self.number >= least or self.ended, timeout_s)
            if self.number > number:
                found = next(one for one in self._held if one[0] > number) if oldest else self._held[-1]
                self._asked = max(self._asked, found[0])
                self.changed.notify_all()
                return found
            if self.error is not None:
                raise self.error
            return None

    def newest(self, after: int = -1, timeout_s: float | None = None) -> Value | None:
        """The newest value above a number, as `after` has it."""
        found = self.after(after, timeout_s)
        return None if found is None else found[1]

    def __iter__(self) -> Iterator[Value]:
        """Values until the end; of several that arrived during the loop's body, only the newest."""
        number = -1
        while (found := self.after(number)) is not None:
            number, value = found
            yield value

    def end(self, error: BaseException | None = None) -> None:
        """End the values, with `error` if one caused it. Wakes all readers; only the first end counts."""
        with self.changed:
            if not self.ended:
                self.ended, self.error = True, error
            self.changed.notify_all()


@dataclass(frozen=True)
class GrabberStats:
    """Figures of a grabber."""

    frames: int = 0  # read so far
    drops: int = 0  # frames lost on the way or torn, by gaps in the source's own count
    unseen: int = 0  # frames that a newer one replaced before anyone asked for them
    reopened: int = 0  # how often the source was lost and reopened
    rate_hz: float = 0.0  # frames per second, over the last 60; 0 before the second frame
    age_s: float | None = None  # of the newest frame; None before the first


class Grabber(Closing):
    """Reads a source in its own thread and keeps the newest frame, for any number of consumers.

    A source that is lost (unplugged, stopped, only torn frames) is reopened. Attempts are 10 ms apart at first, then at most
    100 ms. Meanwhile `state` is "reconnecting" and `reason` says why. Frame numbers continue: `Frame.index` never goes back.
    A camera with another serial number does not replace the lost one.

    Parameters
    ----------
    source : argument of `open_source`, or a function that opens the source and is called again after a loss
    keep : number of frames held for `following`; `newest` needs 1
    stall_s : seconds without a frame until the state is "reconnecting"

    Raises
    ------
    SensorError, DataError
        On entering the context: the source cannot be opened; the message is that of `open_source`.
    """

    def __init__(
        self, source: str | PathLike[str] | Callable[[], Source], *, keep: int = 1, stall_s: float = STALL_S
    ) -> None:
        check_within(keep, "keep", 1, 1_000_000)
        self._open = source if callable(source) else partial(open_source, source)
        # A host that answered before does so in a quarter of a second; one that is off does not refuse.
        self._open_again = source if callable(source) else partial(open_source, source, timeout_s=0.25)
        self._finds_serials = not callable(source)
        self._stall_s = stall_s
        self._frames: Newest[Frame] = Newest(keep=int(keep))
        self._changed = self._frames.changed
        self._state, self._reason, self._reopened = "starting", "", 0
        self._heard_s = time.monotonic()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._source: Source | None = None

    # -- the source's facts ------------------------------------------------------------------------------------

    @property
    def source(self) -> Source:
        """The open source, or the last one if it was lost."""
        if self._source is None:
            raise RuntimeError("Expected an entered Grabber: with Grabber(...) as grabber.")
        return self._source

    @property
    def name(self) -> str:
        """The source's name for display."""
        return self.source.name

    @property
    def serial(self) -> str | None:
        """The camera's serial number; None if it has none."""
        return self.source.serial

    @property
    def settings(self) -> dict[str, float | str]:
        """The camera's settings as read back."""
        return self.source.settings

    # -- for consumers ------------------------------------------------------------------------------------------

    @property
    def state(self) -> str:
        """One of "starting" (until the first frame), "running", "reconnecting", "ended"."""
        return self._state_and_reason()[0]

    @property
    def reason(self) -> str:
        """Why the source is reconnecting or has ended; empty while it runs."""
        return self._state_and_reason()[1]

    def _state_and_reason(self) -> tuple[str, str]:
        with self._changed:
            silent_s = time.monotonic() - self._heard_s
            if self._state == "running" and silent_s > self._stall_s:
                return "reconnecting", f"no frame for {silent_s:.1f} s"
            return self._state, self._reason

    @property
    def stats(self) -> GrabberStats:
        """Current figures."""
        with self._changed:
            own = self._frames
            drops = own.number + 1 - own.count
            return GrabberStats(own.count, drops, own.unseen, self._reopened, own.rate_hz, own.age_s)

    def newest(self, after_index: int = -1, timeout_s: float | None = None) -> Frame | None:
        """The newest frame with a number above `after_index`.

        Waits at most `timeout_s` (None: no limit; 0: not at all). Returns None after the timeout or the end of the source.

        Raises
        ------
        DataError, SensorError
            The error that ended the source, such as a damaged file.
        """
        return self._frames.newest(after_index, timeout_s)

    def following(self, after_index: int = -1, timeout_s: float | None = None) -> Frame | None:
        """The oldest held frame with a number above `after_index`, for recorders; otherwise as `newest`."""
        found = self._frames.after(after_index, timeout_s, oldest=True)
        return None if found is None else found[1]

    # -- the thread ---------------------------------------------------------------------------------------------

    def __enter__(self) -> Grabber:
        self._source = self._open()
        self._heard_s = time.monotonic()
        self._thread = threading.Thread(target=self._run, name=f"grab {self._source.name}", daemon=True)
        self._thread.start()
        return self

    def close(self) -> None:
        """Stop reading and release the device; waits at most 2 s for a device that hangs."""
        self._stop.set()
        if self._source is not None:
            self._source.close()  # this ends its loop
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(2.0)
        self._end(self._reason or "closed")

    def _run(self) -> None:
        assert self._source is not None
        try:
            while not self._stop.is_set():
                try:
                    self._read(self._source)
                    break
                except SourceLostError as problem:
                    self._set("reconnecting", str(problem))
                self._source.close()
                self._reopen()
            self._end("closed" if self._stop.is_set() else "the source has no more frames")
        except Exception as problem:  # consumers raise it: an exception must not vanish in a thread
            self._end(str(problem), problem)
        finally:
            self._source.close()

    def _read(self, source: Source) -> None:
        """Keep frames until the source ends, is lost, or the grabber is closed."""
        base, last = self._frames.number + 1, -1
        for frame in source:
            if self._stop.is_set():
                return
            last = checked_frame(frame, last, source.name).index
            with self._changed:
                self._state, self._reason, self._heard_s = "running", "", time.monotonic()
                self._frames.put(base + last, replace(frame, index=base + last), frame.time_s)

    def _reopen(self) -> None:
        """Reopen the source as soon as it is available: by its spec, else by its serial, because paths may change."""
        wait_s, lost = 0.01, self.source
        attempts = [self._open_again]
        if self._finds_serials and lost.serial:
            attempts.append(partial(open_source, lost.serial))
        while not self._stop.wait(wait_s):
            wait_s = min(2 * wait_s, 0.1)
            for attempt in attempts:
                try:
                    source = attempt()
                except SensorError as problem:
                    self._set("reconnecting", str(problem))
                    continue
                if source.serial == lost.serial:
                    with self._changed:
                        self._source, self._reopened = source, self._reopened + 1
                        self._frames.times_s.clear()
                    return
                source.close()
                said = f"expected the camera {lost.name} (serial {lost.serial}) back, found {source.name}"
                self._set("reconnecting", said)

    def _set(self, state: str, reason: str) -> None:
        with self._changed:
            self._state, self._reason = state, reason

    def _end(self, reason: str, error: Exception | None = None) -> None:
        with self._changed:
            self._set("ended", reason)
            self._frames.end(error)
