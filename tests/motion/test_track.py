"""A path of many frames: keyframes, what is lost, and covariances that grow."""

import numpy as np
import pytest

import gelform
from gelform.motion.between import FOUND, LOST, Motion
from gelform.motion.rigid import step_of_pose
from gelform.motion.track import after
from gelform.simulate import Coin, Pose, Torus, simulate_sequence
from made.rigid_contacts import ball, contact_of, pose, texture

PATH = [pose(0.35 * k, -0.1 * k, 0.0, 0, 0, 1.5 * k) for k in range(10)]


@pytest.fixture(scope="module")
def frames():
    """A textured plate that the sensor slides over: the contact stays in the middle."""
    return [
        contact_of(texture(), one, seed=k, stays=True, index=k, time_s=0.1 * k, calibration_digest="a")
        for k, one in enumerate(PATH)
    ]


def test_a_path_is_followed_over_keyframes(frames):
    found = list(gelform.track(frames, place_error=0.004))
    assert [one.index for one in found] == list(range(10))
    assert [one.motion.state for one in found].count(LOST) == 0
    assert len({one.keyframe for one in found}) > 1
    for one, true in zip(found, PATH):
        off = step_of_pose(one.motion.pose @ np.linalg.inv(true), one.motion.center_mm)
        assert np.linalg.norm(off[:2]) < 0.03
        assert (np.abs(off) < 4 * np.sqrt(np.diag(one.motion.covariance)) + 1e-9).all()
    first = next(k for k, one in enumerate(found) if one.keyframe)
    sizes = [np.sqrt(one.motion.covariance[0, 0]) for one in found]
    assert sizes[first] > 0.9 * sizes[first - 1], "a new keyframe forgets nothing"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("indenter", "depth_mm", "most_lost"), [(Coin(), 0.35, 0), (Torus(2.8, 0.9), 0.5, 7)]
)
def test_an_object_that_is_pressed_in_slowly_is_not_lost(sensor, calibration, indenter, depth_mm, most_lost):
    """The first touch shows little of its surface; of a ring nothing that fits, and the grown contact takes its place."""
    pressed = [Pose(float(deep), (0.1, -0.2), 14) for deep in np.linspace(0.02, depth_mm, 24)]
    slid = [Pose(depth_mm, (0.1 + 0.05 * k, -0.2), 14) for k in range(1, 7)]
    presses = simulate_sequence(sensor, indenter, pressed + slid, rng=np.random.default_rng(3))
    reconstruct = gelform.Reconstructor(calibration)
    found = [one.motion for one in gelform.track(reconstruct(press.image) for press in presses)]
    touched = next(k for k, one in enumerate(found) if one.state == FOUND)
    lost = [k for k, one in enumerate(found) if one.state == LOST and k > touched]
    assert len(lost) <= most_lost
    assert max(lost, default=0) < 12, "while it is pressed in"
    slide = found[-1].pose[:2, 3] - found[len(pressed) - 1].pose[:2, 3]
    np.testing.assert_allclose(slide, [0.3, 0], atol=0.03)


def test_a_grown_contact_is_no_new_origin_after_a_break_or_once_a_frame_was_found():
    """Another object, larger than the first, is not said to be where that was."""

    def states(*touches):
        contacts = [
            contact_of(texture(face), radius_mm=radius, seed=k, time_s=0.1 * k, calibration_digest="a")
            for k, (face, radius) in enumerate(touches)
        ]
        return [one.motion.state for one in gelform.track(contacts)]

    first, nothing, other = (0, 1.5), (0, 0.2), (5, 3.0)
    assert states(first, nothing, other, other) == [FOUND, LOST, LOST, LOST]
    assert states(first, first, other, other)[2:] == [LOST, LOST]
    assert states(first, other, other)[1] == FOUND, "as the first touch of one object"


def test_nothing_before_a_contact_and_after_it(frames):
    none = contact_of(texture(), radius_mm=0.2, time_s=0.0, calibration_digest="a")
    gone = contact_of(texture(), radius_mm=0.2, time_s=0.05, calibration_digest="a")
    found = list(gelform.track([none, frames[0], gone, frames[1]]))
    assert [one.motion.state for one in found] == [LOST, FOUND, LOST, FOUND]
    assert "no contact" in found[2].motion.why
    assert found[0].motion.pose is None
    np.testing.assert_allclose(found[1].motion.pose, np.eye(4))


def test_frames_out_of_order_and_of_another_sensor_are_named(frames):
    other = contact_of(texture(), pose(0.3), time_s=0.2, calibration_digest="b")
    found = list(gelform.track([frames[0], frames[1], other, frames[0], frames[2]]))
    assert [one.motion.state for one in found] == [FOUND, FOUND, LOST, LOST, FOUND]
    assert "another sensor" in found[2].motion.why
    assert "out of order" in found[3].motion.why


def test_what_is_blind_grows_with_the_frames():
    path = [contact_of(ball, pose(0.28 * k), seed=k) for k in range(4)]
    sigmas = [np.sqrt(one.motion.covariance[5, 5]) for one in gelform.track(path, prior=(0.5, 0.02))]
    np.testing.assert_allclose(sigmas[1:], 0.02 * np.sqrt([1, 2, 3]), rtol=0.05)


def test_one_motion_after_another():
    """Points go through the first, then the second; an unsure turn of the first shifts what the second moves on."""
    a, b = pose(1.0, yaw=5), pose(0.0, 2.0, tilt_x=3)
    sure, unsure = np.zeros((6, 6)), np.diag([0, 0, 0, 0, 0, 0.01**2])
    first = Motion(a, unsure, np.array([1.0, 0, 0]), (), 1.0, FOUND)
    then = Motion(b, sure, np.array([4.0, 2.0, 0]), (), 0.5, FOUND)
    both = after(first, then)
    np.testing.assert_allclose(both.pose, b @ a)
    assert np.sqrt(both.covariance[1, 1]) == pytest.approx(0.03, rel=0.01), "3 mm from the unsure turn"
    assert (both.shared, both.state) == (0.5, FOUND)
