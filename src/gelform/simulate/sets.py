"""Sets of presses of one sensor: balls spread over the image, for calibration, and moving indenters."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gelform.foundations.checks import check_is
from gelform.foundations.progress import Progress, no_progress
from gelform.simulate.gel.ball_press import depth_of_ball
from gelform.simulate.gel.gel import Drag
from gelform.simulate.indenters.faces import Ball, Indenter
from gelform.simulate.indenters.pose import Pair, Pose
from gelform.simulate.press import SimulatedPress, simulate_pose, simulate_press
from gelform.simulate.render import simulate_background
from gelform.simulate.sensor.sensor import SimulatedSensor

RIM_SLOPES = (0.5, 0.95)  # mm/mm at the contact's rim, as when a hand presses a GelSight


@dataclass(frozen=True)
class SimulatedPresses:
    """A background and presses of one simulated sensor: the content of a press folder, and the truth."""

    sensor: SimulatedSensor
    background: NDArray[np.uint8]
    presses: tuple[SimulatedPress, ...]


def simulate_ball_presses(
    sensor: SimulatedSensor,
    *,
    ball_diameters_mm: Sequence[float],
    count: int,
    rng: np.random.Generator,
    oversample: int = 3,
    progress: Progress = no_progress,
) -> SimulatedPresses:
    """A background and `count` presses of balls, spread over the image; some are cut by its border.

    The balls take turns. Centers lie on a low-discrepancy sequence that fills the image evenly; depths give
    slopes of 0.5-0.95 at the contact's rim, as a hand that presses a GelSight does. Each press has its own
    random stream, so it does not depend on the others.
    """
    if count < 1 or len(ball_diameters_mm) == 0:
        raise ValueError(f"Expected count >= 1 and a ball, got {count} and {list(ball_diameters_mm)}.")
    check_balls(sensor, ball_diameters_mm)
    background_rng, place_rng, *press_rngs = check_is(rng, np.random.Generator, "rng").spawn(count + 2)
    shift = place_rng.random(2)
    presses = []
    for k, press_rng in enumerate(press_rngs):
        presses.append(_ball_press(sensor, ball_diameters_mm, k, shift, press_rng, oversample))
        progress(k + 1, count, "simulating presses of a ball")
    return SimulatedPresses(sensor, simulate_background(sensor, background_rng), tuple(presses))


def check_balls(sensor: SimulatedSensor, ball_diameters_mm: Sequence[float]) -> None:
    """Refuse (ValueError) balls whose contact is no pixel wide, or that go through the gel; the message has the range."""
    smallest, largest = 4 * sensor.mm_per_px, largest_ball_mm(sensor)  # the flattest contact is 1.8 px wide
    for diameter in ball_diameters_mm:
        if not smallest <= diameter <= largest:
            raise ValueError(
                f"Expected ball_diameter_mm from {smallest:.3g} to {largest:.3g} mm, got {diameter:g}: pixels of "
                f"{sensor.mm_per_px:g} mm see none that is smaller, a larger one goes through the gel, "
                f"{sensor.gel.thickness_mm:g} mm thick."
            )


def largest_ball_mm(sensor: SimulatedSensor) -> float:
    """Diameter, mm, of the largest ball whose deepest press in a set stays within the gel; at most 1000."""
    low, high = 0.0, 1000.0
    for _ in range(40):  # halvings of the interval, to 1e-9 mm
        middle = (low + high) / 2
        deep = _depth(sensor, middle / 2, RIM_SLOPES[1]) >= sensor.gel.thickness_mm
        low, high = (low, middle) if deep else (middle, high)
    return low


def _depth(sensor: SimulatedSensor, radius_mm: float, rim_slope: float) -> float:
    """Depth of a ball with a given slope at its rim, mm."""
    gel = {"thickness_mm": sensor.gel.thickness_mm, "bulge": sensor.gel.bulge}
    return depth_of_ball(radius_mm, rim_slope, sensor.relaxation_mm, **gel)


def ball_press_of_set(
    sensor: SimulatedSensor, ball_diameters_mm: Sequence[float], k: int, *, seed: int, oversample: int = 3
) -> SimulatedPress:
    """The k-th press of `simulate_ball_presses` with `rng=numpy.random.default_rng(seed)`, by itself."""
    place_rng, press_rng = (
        np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(n,))) for n in (1, k + 2)
    )
    return _ball_press(sensor, ball_diameters_mm, k, place_rng.random(2), press_rng, oversample)


def _ball_press(
    sensor: SimulatedSensor,
    ball_diameters_mm: Sequence[float],
    k: int,
    shift: NDArray[np.float64],
    rng: np.random.Generator,
    oversample: int,
) -> SimulatedPress:
    ball = Ball(ball_diameters_mm[k % len(ball_diameters_mm)] / 2)
    depth = _depth(sensor, ball.radius_mm, rng.uniform(*RIM_SLOPES))
    return simulate_press(
        sensor, ball, depth_mm=depth, center_mm=_place(sensor, k, shift), rng=rng, oversample=oversample
    )


def _place(sensor: SimulatedSensor, k: int, shift: NDArray[np.float64]) -> tuple[float, float]:
    """The k-th point of Roberts' R2 sequence (2018), over all but the outermost 2 % of the image."""
    plastic = 1.32471795724474602596
    unit = (shift + (k + 1) / np.array([plastic, plastic**2])) % 1
    height, width = sensor.shape
    x, y = (unit - 0.5) * 0.96 * np.array([width, height]) * sensor.mm_per_px
    return float(x), float(y)


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

    The surface is dragged along (`markers_shift_mm`), the light drifts and flickers; a dropped frame
    is None. Poses may be off the gel (depth 0 or less).
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
    """Poses from first touch to `depth_mm` in equal steps."""
    return tuple(Pose(float(d), center_mm) for d in np.linspace(0, depth_mm, _check_count(count)))


def slide_poses(depth_mm: float, start_mm: Pair, end_mm: Pair, count: int) -> tuple[Pose, ...]:
    """Poses along a line at one depth, which drag the surface."""
    return tuple(Pose(depth_mm, at) for at in _line(start_mm, end_mm, count))


def roll_poses(depth_mm: float, start_mm: Pair, end_mm: Pair, count: int) -> tuple[Pose, ...]:
    """Poses along a line at one depth of a rolling ball or cylinder; the touched side does not move."""
    return tuple(Pose(depth_mm, at, carried_mm=start_mm) for at in _line(start_mm, end_mm, count))


def twist_poses(
    depth_mm: float, angle_deg: float, count: int, *, center_mm: Pair = (0.0, 0.0)
) -> tuple[Pose, ...]:
    """Poses that turn in place about the view axis, from 0 to `angle_deg`."""
    return tuple(Pose(depth_mm, center_mm, float(a)) for a in np.linspace(0, angle_deg, _check_count(count)))


def _line(start_mm: Pair, end_mm: Pair, count: int) -> Sequence[Pair]:
    points = np.linspace(start_mm, end_mm, _check_count(count))
    return [(float(x), float(y)) for x, y in points]


def _check_count(count: int) -> int:
    if count < 1:
        raise ValueError(f"Expected count >= 1 poses, got {count}.")
    return count
