"""The threads of a stream: one turns the newest frame into a result, one learns from results, one examines the sensor."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
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
    """Frames to results on threads of their own, until the feed ends or the pipeline is closed.

    A result is given out before anything is learned from it. A recording is learned from frame by frame in one thread,
    so that it gives the same results each time. An exception in a stage ends the pipeline and reaches whoever reads
    `results`.

    Parameters
    ----------
    feed : of frames, running; closed with the pipeline
    memory : what the sequence has taught so far; its Reconstructor gets a helper thread
    """

    def __init__(self, feed: Feed, memory: Memory) -> None:
        self.feed = feed
        self.memory = memory
        self.meter = Meter()
        self.results: HandOver[StreamFrame] = HandOver(every=feed.every)
        self.recent: deque[StreamFrame] = deque(maxlen=KEPT)
        self._to_learn: HandOver[StreamFrame] = HandOver()
        self._checks: HandOver[Callable[[], None]] = HandOver()
        self._checks_asked = 0
        self._stop = Event()
        self._helper = ThreadPoolExecutor(1, "gelform sigma")
        memory.reconstruct = memory.reconstruct.with_helper(lambda work: self._helper.submit(work).result)
        stages = {"reconstruct": self._reconstruct}
        if not feed.every:
            memory.examine_by(self._ask)
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

    def younger_than(self, max_age_s: float) -> StreamFrame | None:
        """The newest result if it was captured at most so long ago; waits for such a one as long, at most.

        Of a recording, whose frames have no age, the newest.
        """
        deadline = time.monotonic() + max_age_s
        seen = self.results.newest(-1, 0)
        if seen is not None and (left_s := self._left_s(seen, max_age_s)) >= 0:
            return self.results.newest(
                -1, left_s / 2
            )  # the one that is being made, or this one while it is young
        while True:
            index = -1 if seen is None else seen.index
            seen = self.results.newest(index, max(0.0, deadline - time.monotonic()))
            if seen is None or self._left_s(seen, max_age_s) >= 0:
                return seen

    def _left_s(self, seen: StreamFrame, max_age_s: float) -> float:
        """How long a result stays younger than that, s; negative where it is older."""
        return 0.0 if self.feed.every else max_age_s - (time.monotonic() - seen.time_s)

    def close(self) -> None:
        """Stop the threads and give the source back; every wait is bounded."""
        self._stop.set()
        for hand_over in (self._to_learn, self.results, self._checks):
            hand_over.end()
        self.feed.close()
        for thread in self._threads:
            if thread.ident is not None:
                thread.join(JOIN_S)
        self._helper.shutdown()

    def _stage(self, work: Callable[[], None]) -> None:
        """Run a stage; when it ends or fails, so do the others."""
        try:
            work()
        except BaseException as problem:
            self.results.end(problem)
        else:
            self.results.end()
        self._to_learn.end()
        self._checks.end()

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
        seen = self._reconstructed_from(frame)
        if self.feed.every:
            self.memory.learn(seen.image, seen.result)
        self.recent.append(seen)
        self.meter.given(seen.index, seen.time_s)
        self.results.put(seen.index, seen)
        self._to_learn.put(seen.index, seen)

    def _reconstructed_from(self, frame: Frame) -> StreamFrame:
        with self.meter.timed("view"):
            image = self.memory.image_from_frame(frame)
        with self.meter.timed("reconstruct"):
            result = self.memory.result_from_image(image)
        stamped = replace(result, index=frame.index, time_s=frame.time_s, wall_time_ns=frame.wall_time_ns)
        with self.meter.timed("remember"):
            remembered = self.memory.remembered(image, stamped)
        return StreamFrame(image, remembered, frame.index, frame.time_s, frame)

    def _learn(self) -> None:
        index = -1
        while (seen := self._to_learn.newest(index)) is not None:
            index = seen.index
            with self.meter.timed("learn"):
                self.memory.learn(seen.image, seen.result)

    def _ask(self, check: Callable[[], None]) -> None:
        """Have a check made by its own thread: the newest one, where they come too fast."""
        self._checks.put(self._checks_asked, check)
        self._checks_asked += 1

    def _examine(self) -> None:
        number = -1
        while (check := self._checks.newest(number)) is not None:
            number += 1
            check()
