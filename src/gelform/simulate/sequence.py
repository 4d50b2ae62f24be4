"""Presses that move: the poses of an indenter in time, and the images that a camera takes of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from gelform.simulate.gel.drag import Drag
from gelform.simulate.indenters.faces import Indenter
from gelform.simulate.indenters.pose import Pose
from gelform.simulate.indenters.scene import Pair
from gelform.simulate.press import SimulatedPress, simulate_pose
from gelform.simulate.sensor.sensor import SimulatedSensor


def simulate_sequence(
    sensor: SimulatedSensor,
    indenter: Indenter,
    poses: Iterable[Pose],
    *,
    rng: np.random.Generator | None,
    oversample: int = 1,
    start_s: float = 0.0,
) -> Iterator[SimulatedPress | None]:
    """Images of an indenter that moves from pose to pose, one per frame of the sensor's camera.

    The surface is dragged along (`markers_shift_mm`), the light drifts and flickers; a frame that the camera
    drops is None. Poses may stand off the gel (depth 0 or less).
    """
    drag = Drag(sensor.gel)
    for k, pose in enumerate(poses):
        press = simulate_pose(
            sensor,
            indenter,
            pose,
            rng=rng,
            oversample=oversample,
            drag=drag,
            time_s=start_s + k / sensor.timing.frame_rate_hz,
        )
        dropped = rng is not None and rng.random() < sensor.timing.drop_probability
        yield None if dropped else press


def press_poses(depth_mm: float, count: int, *, center_mm: Pair = (0.0, 0.0)) -> tuple[Pose, ...]:
    """From just touching to `depth_mm` in equal steps."""
    return tuple(Pose(float(d), center_mm) for d in np.linspace(0, depth_mm, _check_count(count)))


def slide_poses(depth_mm: float, start_mm: Pair, end_mm: Pair, count: int) -> tuple[Pose, ...]:
    """Along a line at one depth, dragging the surface."""
    return tuple(Pose(depth_mm, at) for at in _line(start_mm, end_mm, count))


def roll_poses(depth_mm: float, start_mm: Pair, end_mm: Pair, count: int) -> tuple[Pose, ...]:
    """Along a line at one depth, as a ball or a cylinder rolls: the touched side stands still."""
    return tuple(Pose(depth_mm, at, carried_mm=start_mm) for at in _line(start_mm, end_mm, count))


def twist_poses(
    depth_mm: float, angle_deg: float, count: int, *, center_mm: Pair = (0.0, 0.0)
) -> tuple[Pose, ...]:
    """Turning about the view axis on the spot, from 0 to `angle_deg`."""
    return tuple(Pose(depth_mm, center_mm, float(a)) for a in np.linspace(0, angle_deg, _check_count(count)))


def _line(start_mm: Pair, end_mm: Pair, count: int) -> Sequence[Pair]:
    points = np.linspace(start_mm, end_mm, _check_count(count))
    return [(float(x), float(y)) for x, y in points]


def _check_count(count: int) -> int:
    if count < 1:
        raise ValueError(f"Expected count >= 1 poses, got {count}.")
    return count
