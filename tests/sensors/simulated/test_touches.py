"""The source "simulated": pace, touches, noise."""

import time
from dataclasses import replace

import numpy as np
import pytest

from gelform.sensors.simulated.touches import DEPTH_MM, SimulatedTouches
from gelform.simulate import LAYOUTS, simulate_background, simulate_pose
from gelform.simulate.indenters.faces import Ball

SMALL = replace(LAYOUTS["three-edges"], shape=(48, 64), mm_per_px=0.3)
CYCLE = 240  # frames of two touches at 60 Hz


@pytest.fixture(scope="module")
def touches():
    return SimulatedTouches(SMALL)


def test_rests_and_touches_two_places_in_turn(touches):
    poses = [touches.pose_at(k) for k in range(CYCLE)]
    depths = np.array([pose.depth_mm for pose in poses])
    assert (depths[:60] == 0).all()
    assert (depths[120:180] == 0).all()
    assert depths[90] == depths[210] == pytest.approx(DEPTH_MM)
    assert poses[90].center_mm != poses[210].center_mm
    assert touches.pose_at(CYCLE + 90) == poses[90]
    assert np.abs(np.diff(depths)).max() < 0.11


def test_a_frame_is_the_simulated_image_of_its_pose(touches):
    press = simulate_pose(SMALL, Ball(3.0), touches.pose_at(90), rng=None)
    frames = np.mean([touches.image_at(90 + CYCLE * k) for k in range(60)], axis=0)
    assert np.abs(frames - press.image).mean() < 0.35  # rounding of the truth, and noise of the mean
    rest = simulate_background(SMALL, None)
    assert np.abs(frames - rest).max() > 20


def test_noise_is_new_in_each_frame_and_the_same_in_each_run(touches):
    assert (touches.image_at(3) != touches.image_at(4)).any()
    np.testing.assert_array_equal(touches.image_at(3), SimulatedTouches(SMALL).image_at(3))
    assert (touches.image_at(3) != SimulatedTouches(SMALL, seed=1).image_at(3)).any()


def test_frames_are_not_given_before_their_time():
    with SimulatedTouches(SMALL, rate_hz=100.0) as source:
        ages = [time.monotonic() - frame.time_s for _, frame in zip(range(5), source)]
    assert min(ages) >= 0


def test_a_late_reader_sees_the_gap():
    reader = iter(SimulatedTouches(SMALL, rate_hz=100.0))
    assert next(reader).index == 0
    time.sleep(0.1)
    assert next(reader).index >= 9


def test_closing_ends_the_loop():
    source = SimulatedTouches(SMALL, rate_hz=100.0)
    reader = iter(source)
    next(reader)
    source.close()
    assert list(reader) == []
