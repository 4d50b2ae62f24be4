"""Which directions are seen, and the words for those that are not."""

import numpy as np
import pytest

from gelform.motion.rigid import moved
from gelform.motion.sight import Blind, blind_directions, has_moved, seen_directions
from gelform.motion.surface import TouchedSurface
from made.rigid_contacts import ball, contact_of, pose, texture

SCALE = np.array([1, 1, 1, 0.5, 0.5, 0.5])


def blind_of(face, seeds=(1, 2)):
    first, second = (
        TouchedSurface(contact_of(face, one, seed=k)) for k, one in zip(seeds, (None, pose(0.3, 0.1)))
    )
    at = first.equations(second, pose(0.3, 0.1), moved(pose(0.3, 0.1), first.middle))
    return blind_directions(first, second, at)


@pytest.mark.slow
def test_all_turns_of_a_ball_are_blind_and_no_texture_is():
    values = [one.correlation for seed in range(8) for one in blind_of(ball, (seed, seed + 50))]
    assert len(values) == 24
    assert not any(blind_of(texture(seed), (seed, seed + 50)) for seed in range(8))


def test_the_same_errors_in_both_frames_look_like_shape():
    """That is why an object has to move: the test could not tell otherwise."""
    first = TouchedSurface(contact_of(ball, seed=1))
    at = first.equations(first, np.eye(4), first.middle)
    assert blind_directions(first, first, at) == ()
    assert not has_moved(first, np.eye(4))
    assert has_moved(first, pose(0.3))
    assert has_moved(first, pose(yaw=-16)), "a turn moves what is away from its center"


def test_seen_directions_are_the_others():
    hidden = [np.array([1.0, 0, 0, 0, 0, 0]), np.array([0, 0.6, 0, 0, 0, 0.4])]
    seen = seen_directions([Blind(one, 0.1, "") for one in hidden], SCALE)
    assert seen.shape == (6, 4)
    np.testing.assert_allclose(seen.T @ seen, np.eye(4), atol=1e-12)
    for one in hidden:
        np.testing.assert_allclose(seen.T @ (one / SCALE), 0, atol=1e-12)
    assert seen_directions([], SCALE).shape == (6, 6)
