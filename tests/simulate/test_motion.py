"""Poses, sequences and the surface that is dragged along."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.simulate import (
    Ball,
    Coating,
    Cylinder,
    Drag,
    Gel,
    Led,
    Pose,
    SimulatedSensor,
    Timing,
    press_poses,
    roll_poses,
    simulate_press,
    simulate_sequence,
    slide_poses,
    twist_poses,
)
from gelform.simulate.gel.drag import displacement_at
from gelform.simulate.gel.gel import surface_from_ball

SENSOR = SimulatedSensor(
    (Led((-6, 2, 7), (4000, 500, 0)), Led((5, 5, 7), (0, 5000, 900))),
    shape=(60, 80),
    mm_per_px=0.1,
    gel=Gel(thickness_mm=2.0, bulge=0.6, friction=0.5),
    coating=Coating(marker_pitch_mm=1.0, marker_radius_mm=0.2),
)


def dragged(poses, gel=SENSOR.gel, points=((0.0, 0.0),)):
    drag, grid = Drag(gel), SENSOR.grid_mm()
    for pose in poses:
        surface = surface_from_ball(
            Ball(3), *grid, center_mm=pose.center_mm, depth_mm=pose.depth_mm, relaxation_mm=0.5, gel=gel
        )
        field = drag(surface, pose)
    return displacement_at(field, surface, np.asarray(points))


def test_a_short_slide_carries_the_contact_with_it():
    still = dragged([Pose(0.5)])
    carried = dragged(slide_poses(0.5, (0, 0), (0.1, 0.05), 5))
    np.testing.assert_allclose(carried - still, [[0.1, 0.05]], atol=0.01)


def test_a_long_slide_slips_at_the_friction_limit():
    moved = dragged(slide_poses(0.5, (-1, 0), (1, 0), 20), points=((1.0, 0.0),))
    assert moved[0, 0] == pytest.approx(0.5 * 0.5, rel=0.05)
    assert abs(moved[0, 1]) < 1e-3


def test_without_friction_nothing_is_dragged():
    gel = Gel(2.0, 0.0, friction=0.0)
    np.testing.assert_allclose(dragged(slide_poses(0.5, (-1, 0), (1, 0), 5), gel), 0, atol=1e-12)


def test_rolling_leaves_the_touched_surface_where_it_is():
    rolled = dragged(roll_poses(0.5, (-0.5, 0), (0.5, 0), 9), points=((0.5, 0.0),))
    np.testing.assert_allclose(rolled, 0, atol=5e-3)


def test_a_twist_turns_the_surface_about_the_contact():
    still, turned = (
        dragged(twist_poses(0.5, angle, 5), points=((0.5, 0.0), (0.0, 0.5))) for angle in (0, 10)
    )
    expected = 0.5 * np.deg2rad(10)
    np.testing.assert_allclose((turned - still)[0], [0, expected], atol=0.01)
    np.testing.assert_allclose((turned - still)[1], [-expected, 0], atol=0.01)


def test_pressing_pushes_the_gel_outwards():
    moved = dragged([Pose(0.6)], points=((1.5, 0.0), (-1.5, 0.0), (0.0, 1.5)))
    assert moved[0, 0] > 0.01
    assert moved[1, 0] == pytest.approx(-moved[0, 0], abs=1e-3)
    assert moved[2, 1] == pytest.approx(moved[0, 0], rel=0.1)


def test_markers_are_drawn_where_the_truth_says():
    press = list(simulate_sequence(SENSOR, Ball(3), slide_poses(0.5, (-1, 0), (1, 0), 10), rng=None))[-1]
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
    presses = list(simulate_sequence(SENSOR, Ball(3), press_poses(0.4, 3), rng=None, start_s=2.0))
    assert [press.press_depth_mm for press in presses] == pytest.approx([0, 0.2, 0.4])
    assert not presses[0].contact.any()
    assert [press.time_s for press in presses] == pytest.approx([2.0, 2.04, 2.08])


def test_frames_are_dropped_as_often_as_said():
    sensor = replace(SENSOR, coating=Coating(), timing=Timing(drop_probability=0.3))
    poses = [Pose(0.0)] * 200
    presses = list(simulate_sequence(sensor, Ball(3), poses, rng=np.random.default_rng(0)))
    assert 40 < sum(press is None for press in presses) < 80


def test_a_pose_turns_the_indenter():
    settings = {"depth_mm": 0.3, "rng": None, "oversample": 1, "quantise": False}
    sensor = replace(SENSOR, coating=Coating(), shape=(61, 61))
    lying = simulate_press(sensor, Cylinder(1.5, 3), **settings).depth_mm
    standing = simulate_press(sensor, Cylinder(1.5, 3), spin_deg=90, **settings).depth_mm
    np.testing.assert_allclose(standing, lying.T, atol=1e-4)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Pose(np.nan), "finite numbers"),
        (lambda: Pose(0.3, tilt_deg=(0, 90)), "tilt_deg within"),
        (lambda: press_poses(0.4, 0), "count >= 1"),
        (lambda: list(simulate_sequence(SENSOR, Ball(3), [Pose(2.5)], rng=None)), "gel's thickness"),
    ],
)
def test_bad_poses_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
