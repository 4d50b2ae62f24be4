"""Sets of ball presses, and indenters that move."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.simulate import (
    LAYOUTS,
    Ball,
    Coating,
    Pose,
    Timing,
    press_poses,
    simulate_ball_presses,
    simulate_sequence,
    slide_poses,
)
from gelform.simulate.sets import largest_ball_mm
from made.sensors import DRAGGED, SMALL


def test_one_press_of_a_set_does_not_depend_on_how_many_follow():
    few = simulate_ball_presses(SMALL, ball_diameters_mm=[4, 6], count=2, rng=np.random.default_rng(5))
    again = simulate_ball_presses(SMALL, ball_diameters_mm=[4, 6], count=3, rng=np.random.default_rng(5))
    for a, b in zip(few.presses, again.presses):
        np.testing.assert_array_equal(a.image, b.image)
    np.testing.assert_array_equal(few.background, again.background)


def test_ball_presses_are_spread_and_some_are_cut_by_the_border():
    done = []
    simulated = simulate_ball_presses(
        SMALL, ball_diameters_mm=[6.31, 9.5], count=30, rng=np.random.default_rng(0), oversample=1,
        progress=lambda k, n, what: done.append((k, n)),
    )  # fmt: skip
    assert done[0] == (1, 30)
    assert done[-1] == (30, 30)
    centers = np.array([press.center_px for press in simulated.presses])
    counts, *_ = np.histogram2d(*centers.T, bins=3, range=[[0, 64], [0, 48]])
    assert counts.min() >= 2
    radius = np.array([press.contact_radius_px for press in simulated.presses])
    cut = (centers.min(axis=1) < radius) | ((63, 47) - centers < radius[:, None]).any(axis=1)
    assert 5 < cut.sum() < 28
    rims = [np.hypot(*np.moveaxis(p.gradients[p.contact], -1, 0)).max() for p in simulated.presses]
    assert 0.5 < np.median(rims) < 0.95
    assert {press.ball_diameter_mm for press in simulated.presses} == {6.31, 9.5}


def test_markers_are_drawn_where_the_truth_says():
    press = list(simulate_sequence(DRAGGED, Ball(3), slide_poses(0.5, (-1, 0), (1, 0), 10), rng=None))[-1]
    assert np.abs(press.markers_shift_mm).max() > 0.1
    y, x = np.mgrid[:60, :80]
    whole = [(mx, my) for mx, my in press.markers_px if 4 < mx < 75 and 4 < my < 55]
    assert len(whole) > 20
    for mx, my in whole:
        dark = (1 - press.albedo) * (np.hypot(x - mx, y - my) < 3.5)
        found = (dark * x).sum() / dark.sum(), (dark * y).sum() / dark.sum()
        assert found == pytest.approx((mx, my), abs=0.1)


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


def test_balls_that_the_gel_cannot_take_are_refused_with_the_range():
    sensor = LAYOUTS["three-edges"]

    def pressed(*diameters):
        rng = np.random.default_rng(0)
        return simulate_ball_presses(sensor, ball_diameters_mm=diameters, count=2, rng=rng)

    largest = largest_ball_mm(sensor)
    assert len(pressed(largest).presses) == len(pressed(0.26).presses) == 2
    for diameter in (1.001 * largest, 0.25, 300):
        with pytest.raises(ValueError, match=r"from 0\.254 to 18\.5 mm, got"):
            pressed(6, diameter)
