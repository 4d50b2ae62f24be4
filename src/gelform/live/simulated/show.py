"""The simulated sensor of the live page: objects touch it in turn; a visitor or a guide says where to press."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.frames import Frame
from gelform.live.simulated.acts import ACTS, Act, Rehearsed
from gelform.sensors.simulated.paced import PacedSimulation
from gelform.simulate import Ball, Pose, SimulatedSensor, simulate_pose

RATE_HZ = 60.0
POINTER_BALL = Ball(2.5)
STEP_MM = 0.025  # depths of a press that was asked for are rounded to this, so that images can be used again
PRESS_S, HOLD_S = 0.35, 1.6  # going in, and staying
KEPT = 64
GENTLE_S = 0.03
APART_S = 0.7  # by which sensors of different seeds are apart in their acts


@dataclass(frozen=True)
class _Asked:
    """A press that somebody asked for: where (px), how deep (mm), with which ball, and when."""

    x_px: float
    y_px: float
    depth_mm: float
    ball: Ball
    start_s: float
    held_s: float

    def depth_at(self, now_s: float) -> float:
        since = now_s - self.start_s
        going_in = min(1.0, since / PRESS_S)
        going_out = min(1.0, max(0.0, PRESS_S + self.held_s + PRESS_S - since) / PRESS_S)
        return self.depth_mm * min(going_in, going_out)

    def over(self, now_s: float) -> bool:
        return now_s > self.start_s + 2 * PRESS_S + self.held_s


class Show(PacedSimulation):
    """A simulated sensor as a source of frames, 60 a second.

    Plays the acts in turn (a ball, a coin, a screw ...) until it is told where to press, or to rest. The images
    without noise are computed once: the ball's when they are first shown, the others' in a thread of their own, and
    their act joins in when they are there. Each frame gets noise of its own.

    Parameters
    ----------
    sensor : SimulatedSensor
    rate_hz : frames a second
    seed : of the noise, and of where in the acts it begins
    """

    def __init__(self, sensor: SimulatedSensor, *, rate_hz: float = RATE_HZ, seed: int = 0) -> None:
        super().__init__(sensor, rate_hz=rate_hz, seed=seed)
        self._linear = sensor.linear()
        self._asked: _Asked | None = None
        self._resting = False
        self._rehearsal: threading.Thread | None = None
        self._levels = lru_cache(maxsize=KEPT)(self._levels_of)
        self._acts = [Rehearsed(ACTS[0], ACTS[0].poses(sensor))]
        self._rest = self._levels_of(POINTER_BALL, 0.0, 0.0, 0.0)

    def __iter__(self) -> Iterator[Frame]:
        rehearsal = threading.Thread(target=self._rehearse, name="simulated acts", daemon=True)
        rehearsal.start()
        self._rehearsal = rehearsal  # started, so that close() can wait for it
        return super().__iter__()

    def levels_at(self, index: int) -> NDArray[Any]:
        """Of what touches now: what was asked for, else the act whose turn it is."""
        now, asked = time.monotonic(), self._asked
        if asked is not None and not asked.over(now):
            depth = STEP_MM * round(asked.depth_at(now) / STEP_MM)
            return self._rest if depth <= 0 else self._levels(asked.ball, depth, asked.x_px, asked.y_px)
        return self._rest if self._resting else self._of_acts(index / self._rate_hz + APART_S * self._seed)

    def press_at(
        self,
        x_px: float,
        y_px: float,
        depth_mm: float = 0.5,
        *,
        ball_diameter_mm: float = 5.0,
        held_s: float = HOLD_S,
    ) -> None:
        """Press a ball at a place of the image, hold it for a while, lift it."""
        ball = Ball(ball_diameter_mm / 2)
        depth_mm = min(depth_mm, 0.9 * self.sensor.gel.thickness_mm, ball.radius_mm)
        self._asked = _Asked(x_px, y_px, depth_mm, ball, time.monotonic(), held_s)

    def lift(self) -> None:
        """End the press that was asked for."""
        self._asked = None

    def rest(self, resting: bool = True) -> None:
        """Touch nothing but where it is asked to; False: play the acts again."""
        self._resting = resting

    def close(self) -> None:
        """End the loop over it; waits for the image that is being computed."""
        super().close()
        if self._rehearsal is not None:
            self._rehearsal.join(2.0)

    def _of_acts(self, time_s: float) -> NDArray[Any]:
        """What the acts show at a time, computed now where it never was."""
        acts = self._acts
        position = int(time_s * Act.rate_hz) % sum(act.length for act in acts)
        for act in acts:
            if position < act.length:
                break
            position -= act.length
        step = act.step_at(position)
        if step is None:
            return self._rest
        if step not in act.levels:
            act.levels[step] = self._simulated(act.act.indenter, act.poses[step])
        return act.levels[step]

    def _levels_of(self, ball: Ball, depth_mm: float, x_px: float, y_px: float) -> NDArray[Any]:
        height, width = self.sensor.shape
        x_mm, y_mm = (
            (at - (size - 1) / 2) * self.sensor.mm_per_px for at, size in ((x_px, width), (y_px, height))
        )
        return self._simulated(ball, Pose(depth_mm, (x_mm, y_mm)))

    def _simulated(self, indenter: Any, pose: Pose) -> NDArray[Any]:
        press = simulate_pose(self._linear, indenter, pose, rng=None, quantise=False)
        return press.image.astype(np.float16)  # steps of 1/8 of a grey level: noise is larger

    def _rehearse(self) -> None:
        """Compute the acts that take long, one after the other; each is played as soon as it is there."""
        for act in ACTS[1:]:
            rehearsed = Rehearsed(act, act.poses(self.sensor))
            for step, pose in enumerate(rehearsed.poses):
                if not self._may_rehearse():
                    return
                rehearsed.levels[step] = self._simulated(act.indenter, pose)
            self._acts = [*self._acts, rehearsed]

    def _may_rehearse(self) -> bool:
        """Waits for the frames that are shown meanwhile, and for the end of a rest; False once it is closed."""
        while not self._closed.wait(GENTLE_S):
            if not self._resting:
                return True
        return False
