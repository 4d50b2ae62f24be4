"""Rigid motions as matrices and as steps about a center."""

import numpy as np
import pytest

from gelform.motion.rigid import (
    about_other_center,
    checked_pose,
    moved,
    pose_of_step,
    step_of_pose,
    turn_deg,
)

STEP = np.array([0.2, -0.1, 0.05, 0.03, -0.06, 0.12])
CENTER = np.array([1.0, -2.0, 0.5])


def test_a_step_and_its_pose():
    pose = pose_of_step(STEP, CENTER)
    np.testing.assert_allclose(step_of_pose(pose, CENTER), STEP, atol=1e-12)
    np.testing.assert_allclose(moved(pose, CENTER), CENTER + STEP[:3])
    assert turn_deg(pose) == pytest.approx(np.degrees(np.linalg.norm(STEP[3:])))


def test_turns_lead_from_x_to_y_to_z():
    for k, (first, then) in enumerate(((1, 2), (2, 0), (0, 1))):
        step = np.zeros(6)
        step[3 + k] = 0.1
        axis = np.eye(3)[first]
        assert moved(pose_of_step(step, np.zeros(3)), axis)[then] == pytest.approx(np.sin(0.1))


def test_a_small_step_about_another_center_is_the_same_motion():
    offset = np.array([0.7, -0.3, 1.1])
    small = 1e-5 * STEP
    there = about_other_center(offset) @ small
    same = pose_of_step(there, CENTER + offset)
    np.testing.assert_allclose(same, pose_of_step(small, CENTER), atol=1e-9)


@pytest.mark.parametrize(
    "wrong", [np.eye(3), 2 * np.eye(4), np.diag([1.0, 1, -1, 1]), np.eye(4) + np.eye(4, k=-1)]
)
def test_what_is_no_rigid_motion_is_refused(wrong):
    with pytest.raises(ValueError, match="rigid motion"):
        checked_pose(wrong, "start")
