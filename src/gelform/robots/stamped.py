"""Results of a source with the time in UTC that messages of ROS 2 carry."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

from gelform.errors import DataError
from gelform.frames import Frame
from gelform.streams.memory import StreamFrame
from gelform.streams.stream import Stream


@dataclass(frozen=True)
class SentStats:
    """What was written or published.

    Attributes
    ----------
    sensor : the name that its topics begin with
    frames, duration_s : how many, and s from the first to the last
    drops : frames of the source that never became a result
    stamped : whether frames said when they were taken; else stamps begin when the first one was sent
    """

    sensor: str
    frames: int
    duration_s: float
    drops: int
    stamped: bool


class StampedResults:
    """Loops over a running stream, until `seconds` have gone; counts what was asked for.

    Parameters
    ----------
    running : of the source
    source : as the user named it, for messages
    seconds : how long, by the times of the frames; to the end where None
    """

    def __init__(self, running: Stream, source: object, seconds: float | None) -> None:
        self._running, self._source, self._seconds = running, source, seconds
        self._stamps = _Stamps()
        self._count, self._last_s = 0, 0.0

    def __iter__(self) -> Iterator[tuple[StreamFrame, int]]:
        """Each result with its frame, and its stamp, ns.

        Raises
        ------
        DataError
            The source gives no frame, or frames of another size than the calibrated one.
        """
        try:
            for seen in self._running.pairs():
                stamp_ns = self._stamps(seen.frame)
                if self._seconds is not None and seen.time_s - self._stamps.first_s >= self._seconds:
                    break
                self._count, self._last_s = self._count + 1, seen.time_s
                yield seen, stamp_ns
        except (ValueError, TypeError) as problem:
            if self._count:
                raise
            raise DataError(f"{self._source}: {problem}") from problem
        if not self._count:
            raise DataError(f"No frame came from {self._source}: there is nothing to send.")

    def stats(self, sensor: str) -> SentStats:
        """What the loop gave."""
        duration_s = self._last_s - self._stamps.first_s if self._count else 0.0
        return SentStats(sensor, self._count, duration_s, self._running.stats.drops, self._stamps.known)


class _Stamps:
    """When frames were taken, UTC, ns; where they do not say, from now on, as far apart as they were."""

    def __init__(self) -> None:
        self.known, self.first_s = True, 0.0
        self._start_ns = 0

    def __call__(self, frame: Frame) -> int:
        if not self._start_ns:
            self._start_ns, self.first_s, self.known = time.time_ns(), frame.time_s, frame.wall_time_ns > 0
        if self.known:
            return frame.wall_time_ns
        return self._start_ns + round((frame.time_s - self.first_s) * 1e9)
