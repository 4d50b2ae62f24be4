"""A simulated sensor as a source of frames like a camera's."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.frames import Frame
from gelform.simulate import (
    Ball,
    Drag,
    Indenter,
    Pose,
    SimulatedPress,
    SimulatedSensor,
    simulate_background,
    simulate_pose,
)


class SimulatedSource:
    """Frames of a simulated sensor at its frame rate, of an indenter that can be moved while it runs.

    Waits for each frame's time as a camera does; frames that come too late to be asked for, or that the
    camera drops, are missing from the count (`Frame.index`).

    Parameters
    ----------
    sensor : SimulatedSensor; its `timing` has the frame rate
    indenter : what is pressed
    seed : of the noise
    clock, sleep : replace them to run faster or slower than real time
    """

    def __init__(
        self,
        sensor: SimulatedSensor,
        indenter: Indenter | None = None,
        *,
        seed: int = 0,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.sensor = sensor
        self.pose = Pose(0.0)
        self.truth: SimulatedPress | None = None
        self._indenter: Indenter = indenter or Ball(3.0)
        self._rng = np.random.default_rng(seed)
        self._clock, self._sleep = clock, sleep
        self._start_s = clock()
        self._index = -1
        self._drag = Drag(sensor.gel)

    def move(self, **changes: Any) -> None:
        """Move the indenter: any of the fields of `Pose`, from the next frame on.

        Raises
        ------
        ValueError
            A pose that is not finite, tilted too far, or through the gel; the indenter stays where it was.
        """
        pose = replace(self.pose, **changes)
        if pose.depth_mm >= self.sensor.gel.thickness_mm:
            thickness = self.sensor.gel.thickness_mm
            raise ValueError(
                f"Expected depth_mm less than the gel's {thickness:g} mm, got {pose.depth_mm:g}."
            )
        self.pose = pose

    def press_with(self, indenter: Indenter) -> None:
        """Take another indenter, off the gel."""
        self._indenter, self.pose, self._drag = indenter, Pose(0.0), Drag(self.sensor.gel)

    @property
    def background(self) -> NDArray[np.uint8]:
        """An image of the untouched gel."""
        return np.asarray(simulate_background(self.sensor, self._rng), dtype=np.uint8)

    def read(self) -> Frame:
        """The next frame, when its time has come; `truth` then holds what is true of it."""
        while True:
            self._await_next()
            time_s = self._index / self.sensor.timing.frame_rate_hz
            self.truth = simulate_pose(
                self.sensor, self._indenter, self.pose, rng=self._rng, drag=self._drag, time_s=time_s
            )
            if self._rng.random() >= self.sensor.timing.drop_probability:
                return Frame(self.truth.image, self._start_s + time_s, time.time_ns(), self._index)

    def __iter__(self) -> SimulatedSource:
        return self

    def __next__(self) -> Frame:
        return self.read()

    def close(self) -> None:
        """Nothing to give back; here because cameras have it."""

    def _await_next(self) -> None:
        """Wait for the next frame's time; where that is past already, take the latest one that is due."""
        rate = self.sensor.timing.frame_rate_hz
        due = int((self._clock() - self._start_s) * rate)
        self._index = max(self._index + 1, due)
        wait = self._start_s + self._index / rate - self._clock()
        if wait > 0:
            self._sleep(wait)
