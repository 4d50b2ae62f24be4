"""The surface that is dragged along."""

import numpy as np
import pytest

from gelform.simulate import Ball, Drag, Gel, Pose, roll_poses, slide_poses, twist_poses
from gelform.simulate.gel.drag import displacement_at
from gelform.simulate.gel.gel import surface_from_ball
from made.sensors import DRAGGED


def dragged(poses, gel=DRAGGED.gel, points=((0.0, 0.0),)):
    drag, grid = Drag(gel), DRAGGED.grid_mm()
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
