"""A pace for frames that do not come from a camera: wait for each one's time, pass over what is late."""

from __future__ import annotations

import time
from collections.abc import Callable


class Pace:
    """The times of evenly spaced frames, the first one now.

    Parameters
    ----------
    rate_hz : frames a second
    clock, sleep : replace them to run faster or slower than real time
    """

    def __init__(
        self,
        rate_hz: float,
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._rate_hz, self._clock, self._sleep = rate_hz, clock, sleep
        self._start_s = clock()

    def wait_for(self, index: int) -> float:
        """Wait for the time of a frame; that time, on the clock."""
        return self.wait_until(index / self._rate_hz)

    def wait_until(self, after_s: float) -> float:
        """Wait until so many seconds after the start; that time, on the clock."""
        due = self._start_s + after_s
        wait = due - self._clock()
        if wait > 0:
            self._sleep(wait)
        return due

    def next_after(self, index: int) -> int:
        """The next frame whose time is not past by a whole frame: a late reader does not get old frames."""
        return max(index + 1, int(self.late_s(0.0) * self._rate_hz))

    def late_s(self, after_s: float) -> float:
        """How long ago the moment `after_s` after the start was, s; negative where it is to come."""
        return self._clock() - self._start_s - after_s
