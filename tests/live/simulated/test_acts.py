"""The acts: poses that the gel allows, there and back."""

import pytest

from gelform.live.simulated.acts import ACTS, Rehearsed
from gelform.sensors.simulated.settings import simulated_sensor_named


@pytest.mark.parametrize("act", ACTS)
def test_an_act_touches_without_going_through_the_gel(act):
    sensor = simulated_sensor_named("three-edges")
    depths = [pose.depth_mm for pose in act.poses(sensor)]
    assert max(depths) > 0.2
    assert all(0 < depth < 0.5 * sensor.gel.thickness_mm for depth in depths)


def test_it_goes_there_back_and_rests():
    act = next(act for act in ACTS if act.returns)
    rehearsed = Rehearsed(act, act.poses(simulated_sensor_named("three-edges")))
    steps = [rehearsed.step_at(position) for position in range(rehearsed.length)]
    count = len(rehearsed.poses)
    assert steps == [*range(count), *reversed(range(count)), *[None] * act.rest_frames]
