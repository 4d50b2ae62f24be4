"""The motion on the page: what is known of it, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.live.moved import MovedSince
from gelform.motion.between import FOUND, LOST, UNSURE
from gelform.motion.rigid import pose_of_step
from made.rigid_contacts import MM_PER_PX, SHAPE, ball, contact_of, cylinder, pose, texture

STEPS = [(0.3 * k - 1.5, -0.1 * k, 1.5 * k) for k in range(4)]  # mm, mm, degrees
FRAMES = [contact_of(texture(), pose(x, y, yaw=yaw), seed=k) for k, (x, y, yaw) in enumerate(STEPS)]
NOTHING = contact_of(texture(), radius_mm=0.2)


def followed(frames):
    follow = MovedSince()
    return [follow(frame, 0.004) for frame in frames]


def test_the_path_and_the_turn_are_those_of_the_object():
    found = followed([NOTHING, *FRAMES])
    assert [one["state"] for one in found] == [LOST, FOUND, FOUND, FOUND, FOUND]
    assert (found[0]["why"], found[0]["path"]) == ("nothing touches", [])
    last, (x, y, yaw) = found[-1], np.subtract(STEPS[-1], STEPS[0])
    np.testing.assert_allclose(last["shift_mm"], (x, y), atol=0.03)
    assert last["turn_deg"] == pytest.approx(yaw, abs=0.3)
    assert 0 < max(last["shift_sigma_mm"]) < 0.1
    assert 0 < last["turn_sigma_deg"] < 1
    turn = np.radians(yaw)
    np.testing.assert_allclose(last["axes"][0], (np.cos(turn), np.sin(turn)), atol=0.01)
    middle = (np.array(SHAPE[::-1]) - 1) / 2
    wanted = middle + np.array(STEPS)[:, :2] / MM_PER_PX
    np.testing.assert_allclose(last["path"], wanted, atol=1)


def test_the_shift_is_that_of_the_contacts_middle():
    """A turn about a point 2 mm beside it shifts it across."""
    x, y, yaw = 0.3, -0.2, 4.0
    turn, beside = np.radians(yaw), np.array([2.0, 0])
    about = pose_of_step(np.array([x, y, 0, 0, 0, turn]), np.array([*beside, 0]))
    last = followed([contact_of(texture(), seed=1), contact_of(texture(), about, seed=2)])[-1]
    wanted = (x + 2 * (1 - np.cos(turn)), y - 2 * np.sin(turn))
    np.testing.assert_allclose(last["shift_mm"], wanted, atol=0.01)


def test_a_turn_that_nothing_shows_is_not_given():
    last = followed(contact_of(ball, pose(0.28 * k), seed=k) for k in range(4))[-1]
    assert last["state"] == FOUND
    assert len(last["blind"]) == 1
    assert "ball's center" in last["blind"][0]
    assert last["turn_deg"] is last["axes"] is None
    np.testing.assert_allclose(last["shift_mm"], (0.84, 0), atol=0.05)


def test_a_shift_that_nothing_shows_has_no_path():
    """A cylinder that moved across its axis may have moved along it too."""
    first, *_, last = followed(contact_of(cylinder, pose(0, 0.28 * k), seed=k) for k in range(3))
    assert last["state"] == FOUND
    assert any("along x" in words for words in last["blind"])
    assert last["shift_mm"] is None
    assert last["path"] == first["path"]


def test_the_path_has_a_gap_where_the_object_was_lost():
    far = contact_of(texture(), pose(2.5, 0, yaw=20), seed=5)
    found = followed([*FRAMES[:2], far, far, *FRAMES[2:]])
    assert [one["state"] for one in found] == [FOUND, FOUND, LOST, LOST, FOUND, FOUND]
    assert found[2]["why"]
    assert found[2]["shift_mm"] is found[2]["turn_deg"] is None
    assert [place is None for place in found[-1]["path"]] == [False, False, True, False, False]


def test_what_has_hardly_moved_has_no_numbers():
    still = followed([FRAMES[0], contact_of(texture(), pose(-1.45), seed=8)])[-1]
    assert (still["state"], still["shift_mm"], still["axes"]) == (UNSURE, None, None)
    assert len(still["path"]) == 1


def test_a_new_touch_and_another_calibration_begin_anew():
    other = [replace(frame, calibration_digest="b") for frame in FRAMES]
    for frames in ([*FRAMES[:3], NOTHING, FRAMES[3]], [*FRAMES[:3], other[3]]):
        last = followed(frames)[-1]
        assert (last["state"], last["shift_mm"], len(last["path"])) == (FOUND, [0.0, 0.0], 1)


def test_without_a_scale_there_is_no_motion():
    found = followed([replace(FRAMES[0], mm_per_px=None)])[0]
    assert (found["state"], found["path"]) == (LOST, [])
    assert "scale" in found["why"]
