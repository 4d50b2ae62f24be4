"""The simulated sensor as a source of frames: objects touch it in turn, or what somebody asks for."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.foundations.checks import check_positive
from gelform.frames import Frame
from gelform.sensors.playback import Pace
from gelform.simulate import (
    Ball,
    Coin,
    Indenter,
    Pose,
    Screw,
    SimulatedSensor,
    Torus,
    simulate_pose,
    text_relief,
)
from gelform.simulate.sensor.camera import image_from_levels

RATE_HZ = 60.0  # frames a second
IMAGE_RATE_HZ = 30.0  # images that are shown in a second
REST_IMAGES = 12  # of the untouched gel before each object
BALL = Ball(2.5)
ROLL = 0.3  # fraction of the image's width and height: how far the ball rolls from the middle
STEP_MM = 0.025  # depths of a press that was asked for are rounded to this, so that images can be used again
PRESS_S, HOLD_S = 0.35, 1.6  # of a press that was asked for: going in or out, and staying
KEPT_PRESSES = 64  # images of such presses that are kept
PAUSE_S = 0.03  # between images that are computed ahead: the frames of now come first
SEED_APART_S = 0.7  # by which sensors of different seeds are apart in the programme


@dataclass(frozen=True, eq=False)
class Touch:
    """What touches in one image of the programme, and how."""

    indenter: Indenter
    pose: Pose


@dataclass(frozen=True)
class AskedPress:
    """A press that somebody asked for: where (px), how deep (mm), with which ball, and when."""

    x_px: float
    y_px: float
    depth_mm: float
    ball: Ball
    start_s: float
    held_s: float

    def depth_at(self, now_s: float) -> float | None:
        """In mm, 0 and less off the gel; None once it is over."""
        going_in = now_s - self.start_s
        going_out = 2 * PRESS_S + self.held_s - going_in
        return None if going_out < 0 else self.depth_mm * min(1.0, going_in / PRESS_S, going_out / PRESS_S)


def serial_of_simulated(sensor: SimulatedSensor) -> str:
    """What stands for a serial number: a simulated sensor of a name is always the same one."""
    return f"simulated-{sensor.name}"


class SimulatedSource:
    """Frames of a simulated sensor, evenly spaced in time, each with noise of its own; late ones are left out.

    A ball rolls, then a coin, a screw, letters and a ring are pressed, for ever, until it is told where to press, or to
    rest. Images without noise are computed once: the ball's when they are first shown, the others' in a thread, and
    each object joins in when its images are there.

    Parameters
    ----------
    sensor : SimulatedSensor
    rate_hz : frames a second
    seed : of the noise, and of where in the programme it begins
    """

    live = True

    def __init__(self, sensor: SimulatedSensor, *, rate_hz: float = RATE_HZ, seed: int = 0) -> None:
        self.sensor = sensor
        self.rate_hz: float | None = check_positive(rate_hz, "rate_hz")
        self.name = f"simulated {sensor.name}"
        self.serial: str | None = serial_of_simulated(sensor)
        height, width = sensor.shape
        self.settings: dict[str, float | str] = {"width": width, "height": height, "fps": rate_hz}
        self._rate_hz, self._seed = rate_hz, seed
        self._linear = sensor.linear()
        self._objects = programme(sensor)
        self._images = self._objects[0]
        self._levels: dict[Touch, NDArray[Any]] = {}
        self._pressed_levels = lru_cache(maxsize=KEPT_PRESSES)(self._levels_of_press)
        self._untouched = self._pressed_levels(BALL, 0.0, 0.0, 0.0)
        self._asked: AskedPress | None = None
        self._resting = False
        self._closed = threading.Event()
        self._ahead: threading.Thread | None = None

    def __iter__(self) -> Iterator[Frame]:
        ahead = threading.Thread(target=self._compute_ahead, name="simulated touches", daemon=True)
        ahead.start()
        self._ahead = ahead  # started, so that close() can wait for it
        pace, index = Pace(self._rate_hz), 0
        while not self._closed.is_set():
            image = self.image_at(index)  # before its time: a camera's exposure takes no time of ours
            time_s = pace.wait_for(index)
            yield Frame(image, time_s, time.time_ns(), index)
            index = pace.next_after(index)

    def image_at(self, index: int) -> NDArray[np.uint8]:
        """The image (H, W, 3) uint8 RGB of the frame of that number."""
        levels = self._levels_now(index / self._rate_hz).astype(np.float32)
        return np.asarray(image_from_levels(self.sensor, levels, np.random.default_rng([self._seed, index])))

    def press_at(
        self,
        x_px: float,
        y_px: float,
        depth_mm: float = 0.5,
        *,
        ball_diameter_mm: float = 2 * BALL.radius_mm,
        held_s: float = HOLD_S,
    ) -> None:
        """Press a ball at a place of the image, hold it for a while, lift it."""
        ball = Ball(ball_diameter_mm / 2)
        depth_mm = min(depth_mm, 0.9 * self.sensor.gel.thickness_mm, ball.radius_mm)
        self._asked = AskedPress(x_px, y_px, depth_mm, ball, time.monotonic(), held_s)

    def lift(self) -> None:
        """End the press that was asked for."""
        self._asked = None

    def rest(self, resting: bool = True) -> None:
        """Touch nothing but where it is asked to; False: go on with the programme."""
        self._resting = resting

    def close(self) -> None:
        """End the loop over it; waits for the image that is being computed."""
        self._closed.set()
        if self._ahead is not None:
            self._ahead.join(2.0)

    def __enter__(self) -> SimulatedSource:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _levels_now(self, time_s: float) -> NDArray[Any]:
        """Linear grey levels (H, W, 3) of what touches: before noise, response curve and rounding."""
        asked = self._asked
        depth_mm = None if asked is None else asked.depth_at(time.monotonic())
        if asked is not None and depth_mm is not None:
            depth_mm = STEP_MM * round(depth_mm / STEP_MM)
            if depth_mm > 0:
                return self._pressed_levels(asked.ball, depth_mm, asked.x_px, asked.y_px)
            return self._untouched
        images, at = self._images, int((time_s + SEED_APART_S * self._seed) * IMAGE_RATE_HZ)
        touch = None if self._resting else images[at % len(images)]
        return self._untouched if touch is None else self._levels_of_touch(touch)

    def _levels_of_touch(self, touch: Touch) -> NDArray[Any]:
        if touch not in self._levels:
            self._levels[touch] = self._simulated(touch.indenter, touch.pose)
        return self._levels[touch]

    def _levels_of_press(self, ball: Ball, depth_mm: float, x_px: float, y_px: float) -> NDArray[Any]:
        height, width = self.sensor.shape
        x_mm, y_mm = (
            (at - (size - 1) / 2) * self.sensor.mm_per_px for at, size in ((x_px, width), (y_px, height))
        )
        return self._simulated(ball, Pose(depth_mm, (x_mm, y_mm)))

    def _simulated(self, indenter: Indenter, pose: Pose) -> NDArray[Any]:
        press = simulate_pose(self._linear, indenter, pose, rng=None, quantise=False)
        return press.image.astype(np.float16)  # steps of 1/8 of a grey level: noise is larger

    def _compute_ahead(self) -> None:
        """Compute one object after the other; not while it rests."""
        for images in self._objects[1:]:
            touches = [touch for touch in dict.fromkeys(images) if touch is not None]
            while touches:
                if self._closed.wait(PAUSE_S):
                    return
                if not self._resting:
                    self._levels_of_touch(touches.pop(0))
            self._images = [*self._images, *images]


def programme(sensor: SimulatedSensor) -> list[list[Touch | None]]:
    """For each object what touches in each image, None: nothing; what is pressed goes out as it came in."""
    objects = [[*[None] * REST_IMAGES, *(Touch(BALL, pose) for pose in _rolling(sensor))]]
    for indenter, depth_mm, steps, spin_deg, tilt_deg in (
        (Coin(), 0.35, 14, 0.0, 0.0),
        (Screw(), 0.45, 14, 25.0, 0.0),
        (text_relief("gelform", height_mm=2.0), 0.3, 12, 0.0, 0.0),
        (Torus(2.8, 0.9), 0.5, 14, 0.0, 4.0),
    ):
        fractions = np.sin(np.linspace(0, np.pi / 2, steps + 1)[1:]) ** 2
        going_in = [
            Touch(indenter, Pose(depth_mm * f, spin_deg=spin_deg * f, tilt_deg=(tilt_deg * f, 0.0)))
            for f in fractions.tolist()
        ]
        objects.append([*[None] * REST_IMAGES, *going_in, *going_in[::-1]])
    return objects


def _rolling(sensor: SimulatedSensor) -> list[Pose]:
    """In, once round the middle, and out."""
    height, width = (size * sensor.mm_per_px for size in sensor.shape)
    turn = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    depth_mm = 0.55 * np.minimum(1, np.minimum(np.arange(48), np.arange(48)[::-1]) / 8)
    return [
        Pose(max(float(d), 0.02), (ROLL * width * float(np.cos(a)), ROLL * height * float(np.sin(a))))
        for d, a in zip(depth_mm, turn)
    ]
