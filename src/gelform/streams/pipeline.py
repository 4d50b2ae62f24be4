"""The threads of a stream: reconstruct takes the newest frame, remember takes the newest result."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from threading import Event, Thread
from typing import Any

import cv2
from numpy.typing import NDArray

from gelform.frames import Frame
from gelform.reconstruction import Reconstruction
from gelform.streams.feed import Feed
from gelform.streams.hand_over import HandOver
from gelform.streams.memory import Memory
from gelform.streams.stats import Meter, StreamStats

KEPT = 8  # results whose images are held for `image_of`
JOIN_S = 2.0  # for each thread at close; one that hangs in a device dies with the process


@dataclass(frozen=True, eq=False)
class StreamFrame:
    """A result and the image that it is of.

    Attributes
    ----------
    image : (H, W, 3), RGB, after the calibration's view
    result : Reconstruction
    index : int, of the frame; grows
    time_s : float, when it was captured, on `time.monotonic()`'s clock
    frame : Frame, as the source gave it, before the view
    """

    image: NDArray[Any]
    result: Reconstruction
    index: int
    time_s: float
    frame: Frame


class Pipeline:
    """Frames to results on two threads of their own, until the feed ends or the pipeline is closed.

    An exception in a stage ends the pipeline and reaches whoever reads `results`.

    Parameters
    ----------
    feed : of frames, running; closed with the pipeline
    memory : what the sequence has taught so far; it is called on one thread alone
    """

    def __init__(self, feed: Feed, memory: Memory) -> None:
        self.feed = feed
        self.memory = memory
        self.meter = Meter()
        self.results: HandOver[StreamFrame] = HandOver(every=feed.every)
        self.recent: deque[StreamFrame] = deque(maxlen=KEPT)
        self._reconstructed: HandOver[StreamFrame] = HandOver(every=feed.every)
        self._stop = Event()
        self._threads = [
            Thread(target=self._stage, args=(work, out), name=f"gelform {name}", daemon=True)
            for name, work, out in (
                ("reconstruct", self._reconstruct, self._reconstructed),
                ("remember", self._remember, self.results),
                ("examine", self._examine, self.results),
            )
        ]
        self._checks: HandOver[Callable[[], None]] = HandOver()
        self._checks_asked = 0
        memory.examine_by(self._ask)

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

    def younger_than(self, max_age_s: float) -> StreamFrame | None:
        """The newest result if it was captured at most so long ago; waits for such a one as long, at most.

        Of a recording, whose frames have no age, the newest.
        """
        deadline, index = time.monotonic() + max_age_s, -1
        while True:
            left_s = max(0.0, deadline - time.monotonic())
            seen = self.results.newest(index, left_s)
            if seen is None or self.feed.every or time.monotonic() - seen.time_s <= max_age_s:
                return seen
            index = seen.index

    def close(self) -> None:
        """Stop the threads and give the source back; every wait is bounded."""
        self._stop.set()
        self._reconstructed.end()
        self.results.end()
        self._checks.end()
        self.feed.close()
        for thread in self._threads:
            if thread.ident is not None:
                thread.join(JOIN_S)

    def _stage(self, work: Callable[[HandOver[StreamFrame]], None], out: HandOver[StreamFrame]) -> None:
        """Run a stage; however it ends, the next one hears of it."""
        try:
            work(out)
        except BaseException as problem:
            out.end(problem)
        else:
            out.end()
        if out is self.results:
            self._checks.end()

    def _reconstruct(self, out: HandOver[StreamFrame]) -> None:
        index = -1
        while not self._stop.is_set():
            frame = self.feed.next(index)
            if frame is not None:
                index = frame.index
                out.put(index, self._reconstructed_from(frame))
            elif self.feed.state == "ended":
                return

    def _reconstructed_from(self, frame: Frame) -> StreamFrame:
        if not self.feed.every:
            self.meter.add("wait", time.monotonic() - frame.time_s)
        with self.meter.timed("view"):
            image = self.memory.image_from_frame(frame)
        with self.meter.timed("reconstruct"):
            result = self.memory.result_from_image(image)
        stamped = replace(result, index=frame.index, time_s=frame.time_s, wall_time_ns=frame.wall_time_ns)
        return StreamFrame(image, stamped, frame.index, frame.time_s, frame)

    def _ask(self, check: Callable[[], None]) -> None:
        """Have a check made by its own thread: the newest one, where they come too fast."""
        self._checks.put(self._checks_asked, check)
        self._checks_asked += 1

    def _examine(self, out: HandOver[StreamFrame]) -> None:
        number = -1
        while (check := self._checks.newest(number)) is not None:
            number += 1
            check()

    def _remember(self, out: HandOver[StreamFrame]) -> None:
        index = -1
        while (seen := self._reconstructed.newest(index)) is not None:
            index = seen.index
            with self.meter.timed("remember"):
                result = self.memory(seen.image, seen.result)
            remembered = replace(seen, result=result)
            self.recent.append(remembered)
            self.meter.given(index, seen.time_s)
            out.put(index, remembered)
