"""A film as a source with controls: play, pause, seek, step, speed, loop."""

from __future__ import annotations

import threading
import time
from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from gelform.errors import DataError, GelformError
from gelform.image.frame import Frame
from gelform.sensors.playback import Closing, Film

SLOWEST, FASTEST = 1 / 16, 16.0  # times the original pace


@dataclass(frozen=True)
class ReplayedFrame(Frame):
    """A frame of a recording, shown now."""

    number: int = 0  # in the recording
    recorded_s: float = 0.0  # recording time, from the first frame


class Player(Closing):
    """Plays a recording: at first from its start, at its own pace and once. `playing` says whether it is.

    A reader that is too slow gets the newest frame that is due. At a damaged frame playing stops, and `problem` gives
    the reason; the frame is skipped. Methods may be called in any thread.

    It shows the first frame of the scanned recording until `may_begin()`, such as once somebody looks. Another `clock` runs
    it faster or slower than real time.
    """

    live = True

    def __init__(
        self,
        recording: Film,
        *,
        clock: Callable[[], float] = time.monotonic,
        may_begin: Callable[[], bool] = lambda: True,
    ) -> None:
        self.recording, self._may_begin = recording, may_begin
        facts = recording.camera
        self.name, self.serial, self.rate_hz = facts.name, facts.serial, facts.rate_hz
        self.settings = dict(facts.settings)
        self.problem = ""
        self._clock = clock
        self._changed = threading.Condition()
        self._closed, self._waits = False, True
        self.playing, self._loops, self._speed = True, False, 1.0
        self._number, self._asked = -1, 0
        self._from_s, self._since_s = 0.0, clock()

    def __iter__(self) -> Iterator[Frame]:
        index = 0
        while (number := self._next()) is not None:
            try:
                frame = self.recording[number]
            except DataError as problem:
                self.problem = str(problem)
                self.play(False)
                continue
            shown = frame.image, self._clock(), frame.wall_time_ns, index, frame.encoded
            yield ReplayedFrame(*shown, number, self.recording.times_s[number])
            index += 1

    # -- controls -----------------------------------------------------------------------------------------------------

    def play(self, playing: bool = True) -> None:
        """Play, from the start if it is at the end; False: pause."""
        with self._changed:
            if playing and self._number >= len(self.recording.times_s) - 1:
                self._asked = 0
            self._set(playing=playing)

    def seek(self, number: float) -> None:
        """Show a frame, or the first or last one if the number is out of range; continue playing if it was."""
        with self._changed:
            self._asked = min(max(int(number), 0), len(self.recording.times_s) - 1)
            self._set()

    def step(self, by: float) -> None:
        """Pause, and show the next frame (+1) or the previous one (-1)."""
        with self._changed:
            at = self._number if self._asked < 0 else self._asked
            self._asked = min(max(at + int(by), 0), len(self.recording.times_s) - 1)
            self._set(playing=False)

    def again(self) -> None:
        """Show the current frame again, because its reconstruction has changed."""
        with self._changed:
            if not self.playing and self._asked < 0:
                self._asked = max(self._number, 0)
                self._set()

    def set_speed(self, speed: float) -> None:
        """Play at a multiple of the original pace, 1/16 to 16."""
        if not SLOWEST <= speed <= FASTEST:
            raise GelformError(f"Expected a speed from {SLOWEST:g} to {FASTEST:g}, got {speed:g}.")
        with self._changed:
            self._speed = speed
            self._set()

    def loop(self, loops: bool = True) -> None:
        """At the end, start again; False: stop there."""
        with self._changed:
            self._loops = loops
            self._set()

    def facts(self) -> dict[str, Any]:
        """The player's state for the page."""
        with self._changed:
            times = self.recording.times_s
            return {
                "file": self.recording.path.name,
                "number": max(self._number, 0),
                "count": len(times),
                "time_s": times[max(self._number, 0)],
                "duration_s": times[-1],
                "playing": self.playing,
                "speed": self._speed,
                "loop": self._loops,
                "problem": self.problem,
            }

    def close(self) -> None:
        """End the loop over it."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    # -- the pace -----------------------------------------------------------------------------------------------------

    def _set(self, playing: bool | None = None) -> None:
        """Apply a change; the pace counts from the current frame."""
        self.playing = self.playing if playing is None else playing
        self._from_s, self._since_s = self.recording.times_s[max(self._number, 0)], self._clock()
        self._changed.notify_all()

    def _next(self) -> int | None:
        """Wait until the next frame is due; None once the player is closed."""
        with self._changed:
            while not self._closed:
                if self._asked >= 0:
                    self._asked, self._number = -1, self._asked
                    self._set()
                    return self._number
                if not self.playing:
                    self._changed.wait()
                elif self._number < len(self.recording.times_s) - 1:
                    if (number := self._due()) > self._number:
                        self._number = number
                        return number
                elif self._loops and len(self.recording.times_s) > 1:
                    self._asked = 0
                else:
                    self.playing = False
            return None

    def _due(self) -> int:
        """The newest frame that is due; waits for the next one if none is."""
        times = self.recording.times_s
        if self._waits and self._number == 0:
            if not self._may_begin():
                self._changed.wait(0.1)  # s between two looks whether it may begin
                self._since_s = self._clock()
                return self._number
            self._waits = False
        at_s = self._from_s + self._speed * (self._clock() - self._since_s)
        wait_s = (times[self._number + 1] - at_s) / self._speed
        if wait_s > 0:
            self._changed.wait(wait_s)
            return self._number
        return bisect_right(times, at_s) - 1
