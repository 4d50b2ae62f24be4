"""How a stream is doing: rate, drops, age, time of each stage."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from statistics import median
from threading import Lock

RECENT = 120  # frames that rates and times are taken from


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
