"""Images of an indenter that moves."""

import re
from dataclasses import replace

import numpy as np
import pytest

from gelform.simulate import Ball, Coating, Pose, Timing, press_poses, simulate_sequence, slide_poses
from made.sensors import DRAGGED


def test_markers_are_drawn_where_the_truth_says():
    press = list(simulate_sequence(DRAGGED, Ball(3), slide_poses(0.5, (-1, 0), (1, 0), 10), rng=None))[-1]
    assert np.abs(press.markers_shift_mm).max() > 0.1
    y, x = np.mgrid[:60, :80]
    checked = 0
    for (mx, my), _ in zip(press.markers_px, press.markers_shift_mm):
        if 4 < mx < 75 and 4 < my < 55:
            dark = (1 - press.albedo) * (np.hypot(x - mx, y - my) < 3.5)
            found = (dark * x).sum() / dark.sum(), (dark * y).sum() / dark.sum()
            assert found == pytest.approx((mx, my), abs=0.1)
            checked += 1
    assert checked > 20


def test_a_sequence_takes_the_poses_and_the_clock():
    presses = list(simulate_sequence(DRAGGED, Ball(3), press_poses(0.4, 3), rng=None, start_s=2.0))
    assert [press.press_depth_mm for press in presses] == pytest.approx([0, 0.2, 0.4])
    assert not presses[0].contact.any()
    assert [press.time_s for press in presses] == pytest.approx([2.0, 2.04, 2.08])


def test_frames_are_dropped_as_often_as_said():
    sensor = replace(DRAGGED, coating=Coating(), timing=Timing(drop_probability=0.3))
    poses = [Pose(0.0)] * 200
    presses = list(simulate_sequence(sensor, Ball(3), poses, rng=np.random.default_rng(0)))
    assert 40 < sum(press is None for press in presses) < 80


REFUSED = [
    (lambda: press_poses(0.4, 0), "count >= 1"),
    (lambda: list(simulate_sequence(DRAGGED, Ball(3), [Pose(2.5)], rng=None)), "gel's thickness"),
]


@pytest.mark.parametrize(("make", "message"), REFUSED)
def test_bad_settings_are_refused_with_the_reason(make, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        make()
