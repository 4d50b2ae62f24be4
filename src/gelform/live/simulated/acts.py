"""What touches the simulated sensor: a ball that presses and rolls, a coin, a screw, a ring, letters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from gelform.simulate import Ball, Coin, Indenter, Pose, Screw, SimulatedSensor, Torus, text_relief

RIM = 0.3  # of the image's width and height: how far the ball rolls from the middle


@dataclass(frozen=True)
class Act:
    """One object and how it moves.

    Attributes
    ----------
    indenter : what touches
    poses : sensor -> the poses of its images
    returns : whether it goes the same way back
    rest_frames : images of rest after it
    """

    rate_hz: ClassVar[float] = 30.0  # images of an act that are shown in a second

    indenter: Indenter
    poses: Callable[[SimulatedSensor], Sequence[Pose]]
    returns: bool = True
    rest_frames: int = 12


@dataclass
class Rehearsed:
    """An act on one sensor, and the images of it that are computed already.

    Attributes
    ----------
    act : Act
    poses : of its images
    levels : number of the pose -> image without noise
    """

    act: Act
    poses: Sequence[Pose]
    levels: dict[int, NDArray[Any]] = field(default_factory=dict)

    @property
    def length(self) -> int:
        """How many images are shown: there, back where it goes back, and at rest."""
        return len(self.poses) * (1 + self.act.returns) + self.act.rest_frames

    def step_at(self, position: int) -> int | None:
        """The number of the pose that is shown at a position; None at rest."""
        count = len(self.poses)
        if position < count:
            return position
        return 2 * count - 1 - position if self.act.returns and position < 2 * count else None


def _rolls(sensor: SimulatedSensor) -> list[Pose]:
    """In, once round the middle, and out."""
    height, width = (size * sensor.mm_per_px for size in sensor.shape)
    turn = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    depth = 0.55 * np.minimum(1, np.minimum(np.arange(48), np.arange(48)[::-1]) / 8)
    return [
        Pose(max(float(d), 0.02), (RIM * width * float(np.cos(a)), RIM * height * float(np.sin(a))))
        for d, a in zip(depth, turn)
    ]


def _presses(
    depth_mm: float, steps: int, *, spin_deg: float = 0.0, tilt_deg: float = 0.0
) -> Callable[..., list[Pose]]:
    """In to a depth, turning and tilting on the way."""

    def poses(_: SimulatedSensor) -> list[Pose]:
        share = np.sin(np.linspace(0, np.pi / 2, steps + 1)[1:]) ** 2
        return [
            Pose(float(depth_mm * s), spin_deg=float(spin_deg * s), tilt_deg=(float(tilt_deg * s), 0.0))
            for s in share
        ]

    return poses


ACTS: tuple[Act, ...] = (
    Act(Ball(2.5), _rolls, returns=False),
    Act(Coin(), _presses(0.35, 14)),
    Act(Screw(), _presses(0.45, 14, spin_deg=25.0)),
    Act(text_relief("gelform", height_mm=2.0), _presses(0.3, 12)),
    Act(Torus(2.8, 0.9), _presses(0.5, 14, tilt_deg=4.0)),
)
