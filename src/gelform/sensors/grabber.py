"""The newest frame of a source: one thread per device reads it, and reopens it after a loss."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from os import PathLike

from gelform.errors import SensorError, SourceLostError
from gelform.foundations.checks import check_within
from gelform.image.frame import Frame
from gelform.sensors.source import Source, checked_frame, open_source

STALL_S = 0.5  # s without a frame until "reconnecting"; robots' recorders give up after as long


@dataclass(frozen=True)
class GrabberStats:
    """Figures of a grabber.

    Attributes
    ----------
    frames : frames read so far
    drops : frames lost on the way or torn, by gaps in the source's own count
    unseen : frames that a newer one replaced before anyone asked for them
    reopened : how often the source was lost and reopened
    rate_hz : frames per second, over the last 60; 0 before the second frame
    age_s : age of the newest frame, s; None before the first
    """

    frames: int = 0
    drops: int = 0
    unseen: int = 0
    reopened: int = 0
    rate_hz: float = 0.0
    age_s: float | None = None


class Grabber:
    """Reads a source in its own thread and keeps the newest frame, for any number of consumers.

    A source that is lost (unplugged, stopped, only torn frames) is reopened. Attempts are 20 ms apart at first, then at most
    120 ms. Meanwhile `state` is "reconnecting" and `reason` says why. Frame numbers continue: `Frame.index` never goes back.
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
        self,
        source: str | PathLike[str] | Callable[[], Source],
        *,
        keep: int = 1,
        stall_s: float = STALL_S,
    ) -> None:
        check_within(keep, "keep", 1, 1_000_000)
        self._open = source if callable(source) else partial(open_source, source)
        # A host that answered before does so in a quarter of a second; one that is off does not refuse.
        self._open_again = source if callable(source) else partial(open_source, source, timeout_s=0.25)
        self._finds_serials = not callable(source)
        self._stall_s = stall_s
        self._changed = threading.Condition()
        self._held: deque[Frame] = deque(maxlen=int(keep))
        self._times_s: deque[float] = deque(maxlen=60)
        self._state, self._reason = "starting", ""
        self._stats = GrabberStats()
        self._asked = -1  # index of the last frame that a consumer received
        self._heard_s = time.monotonic()
        self._stop = threading.Event()
        self._error: Exception | None = None
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
        with self._changed:
            return "reconnecting" if self._state == "running" and self._stalled() else self._state

    @property
    def reason(self) -> str:
        """Why the source is reconnecting or has ended; empty while it runs."""
        with self._changed:
            if self._state == "running" and self._stalled():
                return f"no frame for {time.monotonic() - self._heard_s:.1f} s"
            return self._reason

    @property
    def stats(self) -> GrabberStats:
        """Current figures."""
        with self._changed:
            span = self._times_s[-1] - self._times_s[0] if len(self._times_s) > 1 else 0.0
            age = time.monotonic() - self._held[-1].time_s if self._held else None
            return replace(
                self._stats, rate_hz=(len(self._times_s) - 1) / span if span > 0 else 0.0, age_s=age
            )

    def newest(self, after_index: int = -1, timeout_s: float | None = None) -> Frame | None:
        """The newest frame with a number above `after_index`.

        Waits at most `timeout_s` (None: no limit; 0: not at all). Returns None after the timeout or the end of the source.

        Raises
        ------
        DataError, SensorError
            The error that ended the source, such as a damaged file.
        """
        return self._awaited(after_index, timeout_s, oldest=False)

    def following(self, after_index: int = -1, timeout_s: float | None = None) -> Frame | None:
        """The oldest held frame with a number above `after_index`, for recorders; otherwise as `newest`."""
        return self._awaited(after_index, timeout_s, oldest=True)

    def _awaited(self, after_index: int, timeout_s: float | None, oldest: bool) -> Frame | None:
        with self._changed:
            self._changed.wait_for(lambda: self._has_after(after_index) or self._state == "ended", timeout_s)
            if not self._has_after(after_index):
                if self._state == "ended" and self._error is not None:
                    raise self._error
                return None
            frame = next(f for f in self._held if f.index > after_index) if oldest else self._held[-1]
            self._asked = max(self._asked, frame.index)
            return frame

    def _has_after(self, index: int) -> bool:
        return bool(self._held) and self._held[-1].index > index

    def _stalled(self) -> bool:
        return time.monotonic() - self._heard_s > self._stall_s

    # -- the thread ---------------------------------------------------------------------------------------------

    def __enter__(self) -> Grabber:
        self._source = self._open()
        self._heard_s = time.monotonic()
        self._thread = threading.Thread(target=self._run, name=f"grab {self._source.name}", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop reading and release the device; waits at most 2 s for a device that hangs."""
        self._stop.set()
        if self._source is not None:
            self._source.close()  # this ends its loop
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(2.0)
        self._set("ended", self._reason or "closed")

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
            self._set("ended", "closed" if self._stop.is_set() else "the source has no more frames")
        except Exception as problem:  # consumers raise it: an exception must not vanish in a thread
            self._error = problem
            self._set("ended", str(problem))
        finally:
            self._source.close()

    def _read(self, source: Source) -> None:
        """Read frames until the source ends, is lost, or the grabber is closed."""
        base = self._held[-1].index + 1 if self._held else 0
        last = -1
        for frame in source:
            if self._stop.is_set():
                return
            last = checked_frame(frame, last, source.name).index
            self._keep(replace(frame, index=base + last))

    def _keep(self, frame: Frame) -> None:
        with self._changed:
            before = self._held[-1].index if self._held else -1
            unseen = int(before > self._asked and len(self._held) == self._held.maxlen)
            drops = frame.index - before - 1
            self._stats = replace(
                self._stats,
                frames=self._stats.frames + 1,
                drops=self._stats.drops + drops,
                unseen=self._stats.unseen + unseen,
            )
            self._held.append(frame)
            self._times_s.append(frame.time_s)
            self._heard_s = time.monotonic()
            self._state, self._reason = "running", ""
            self._changed.notify_all()

    def _reopen(self) -> None:
        """Reopen the source as soon as it is available."""
        wait_s, lost = 0.02, self.source
        while not self._stop.wait(wait_s):
            wait_s = min(1.5 * wait_s, 0.12)
            source = self._found_again(lost)
            if source is None:
                continue
            self._source = source
            with self._changed:
                self._times_s.clear()
                self._stats = replace(self._stats, reopened=self._stats.reopened + 1)
            return

    def _found_again(self, lost: Source) -> Source | None:
        """The lost source if it is available again: by its spec, else by its serial, because paths may change."""
        attempts = [self._open_again]
        if self._finds_serials and lost.serial:
            attempts.append(partial(open_source, lost.serial))
        for attempt in attempts:
            try:
                source = attempt()
            except SensorError as problem:
                self._set("reconnecting", str(problem))
                continue
            if source.serial == lost.serial:
                return source
            source.close()
            said = f"expected the camera {lost.name} (serial {lost.serial}) back, found {source.name}"
            self._set("reconnecting", said)
        return None

    def _set(self, state: str, reason: str) -> None:
        with self._changed:
            self._state, self._reason = state, reason
            self._changed.notify_all()
