"""A simulated sensor as a source of frames at a camera's pace; what touches it is the subclass's."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from gelform.checks import check_positive
from gelform.frames import Frame
from gelform.sensors.pace import Pace
from gelform.simulate import SimulatedSensor
from gelform.simulate.sensor.grey_levels import image_from_levels

Simulation = TypeVar("Simulation", bound="PacedSimulation")


class PacedSimulation(ABC):
    """Frames of a simulated sensor, evenly spaced in time, each with noise of its own; those that come late are left out.

    Parameters
    ----------
    sensor : SimulatedSensor
    rate_hz : frames a second
    seed : of the noise: the noise of a frame is the same in every run
    """

    live = True
    serial: str | None = None

    def __init__(self, sensor: SimulatedSensor, *, rate_hz: float, seed: int = 0) -> None:
        self.sensor = sensor
        self.rate_hz: float | None = check_positive(rate_hz, "rate_hz")
        self.name = f"simulated {sensor.name}"
        height, width = sensor.shape
        self.settings: dict[str, float | str] = {"width": width, "height": height, "fps": rate_hz}
        self._rate_hz, self._seed = rate_hz, seed
        self._closed = threading.Event()

    @abstractmethod
    def levels_at(self, index: int) -> NDArray[Any]:
        """Linear grey levels (H, W, 3) of the frame of that number: before noise, response curve and rounding."""

    def image_at(self, index: int) -> NDArray[np.uint8]:
        """The image (H, W, 3) uint8 RGB of the frame of that number."""
        noise = np.random.default_rng([self._seed, index])
        levels = self.levels_at(index).astype(np.float32, copy=False)
        return np.asarray(image_from_levels(self.sensor, levels, noise))

    def __iter__(self) -> Iterator[Frame]:
        pace, index = Pace(self._rate_hz), 0
        while not self._closed.is_set():
            image = self.image_at(index)  # before its time: a camera's exposure takes no time of ours
            time_s = pace.wait_for(index)
            yield Frame(image, time_s, time.time_ns(), index)
            index = pace.next_after(index)

    def close(self) -> None:
        """End the loop over it."""
        self._closed.set()

    def __enter__(self: Simulation) -> Simulation:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
