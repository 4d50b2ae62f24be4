"""Which directions are seen, and the words for those that are not."""

import numpy as np
import pytest

from gelform.motion.sight import blind_directions, has_moved
from gelform.motion.surface import TouchedSurface
from made.rigid_contacts import ball, contact_of, pose, texture

pytestmark = pytest.mark.linear_algebra


def blind_of(face, seeds=(1, 2)):
    first, second = (
        TouchedSurface(contact_of(face, one, seed=k)) for k, one in zip(seeds, (None, pose(0.3, 0.1)))
    )
    at = first.equations(second, pose(0.3, 0.1))
    return blind_directions(first, second, at)


@pytest.mark.slow
def test_all_turns_of_a_ball_are_blind_and_no_texture_is():
    values = [one.correlation for seed in range(8) for one in blind_of(ball, (seed, seed + 50))[0]]
    assert len(values) == 24
    assert not any(blind_of(texture(seed), (seed, seed + 50))[0] for seed in range(8))


def test_the_same_errors_in_both_frames_look_like_shape():
    """That is why an object has to move: the test could not tell otherwise."""
    first = TouchedSurface(contact_of(ball, seed=1))
    at = first.equations(first, np.eye(4))
    assert blind_directions(first, first, at)[0] == ()
    assert not has_moved(first, np.eye(4))
    assert has_moved(first, pose(0.3))
    assert has_moved(first, pose(yaw=-16)), "a turn moves what is away from its center"


def test_the_other_directions_are_seen():
    """They are orthogonal to the blind ones, in units that move points by alike."""
    blind, seen = blind_of(ball)
    assert (len(blind), seen.shape) == (3, (6, 3))
    scale = np.sqrt(
        np.sum(np.square(seen), axis=1, keepdims=True) + sum(b.direction**2 for b in blind)[:, None]
    )
    for one in blind:
        np.testing.assert_allclose((seen / scale).T @ (one.direction / scale[:, 0]), 0, atol=1e-9)
    assert blind_of(texture())[1].shape == (6, 6)
