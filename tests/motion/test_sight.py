"""Which directions are seen, and the words for those that are not."""

import numpy as np
import pytest

from gelform.motion.sight import blind_directions, has_moved
from gelform.motion.surface import TouchedSurface
from made.rigid_contacts import SHAPE, ball, contact_of, cylinder, pose, texture

pytestmark = pytest.mark.linear_algebra


def blind_of(face, seeds=(1, 2), **fields):
    first, second = (
        TouchedSurface(contact_of(face, one, seed=k, **fields))
        for k, one in zip(seeds, (None, pose(0.3, 0.1)))
    )
    at = first.equations(second, pose(0.3, 0.1))
    return blind_directions(first, at)


@pytest.mark.slow
def test_all_turns_of_a_ball_are_blind_and_no_texture_is():
    values = [one.correlation for seed in range(8) for one in blind_of(ball, (seed, seed + 50))[0]]
    assert len(values) == 24
    assert not any(blind_of(texture(seed), (seed, seed + 50))[0] for seed in range(8))


def test_the_same_errors_in_both_frames_look_like_shape():
    """That is why an object has to move: the test could not tell otherwise."""
    first = TouchedSurface(contact_of(cylinder, seed=1))
    at = first.equations(first, np.eye(4))
    assert blind_directions(first, at)[0] == ()
    assert not has_moved(first, np.eye(4))
    assert has_moved(first, pose(0.3))
    assert has_moved(first, pose(yaw=-16)), "a turn moves what is away from its center"


def oval(x, y):
    """A lens with radii of 3 and 5 mm."""
    return -(x**2) / 6 - y**2 / 10


def test_shape_counts_from_the_error_that_slopes_may_carry():
    """An oval rolls unseen at most, unless its slopes may be as wrong as they would be of a ball."""
    assert not any("ball" in one.words or "about z" in one.words for one in blind_of(oval)[0])
    unsure = {"gradients_sigma": np.full((*SHAPE, 2), 0.15, np.float32)}
    found = [one.words for one in blind_of(oval, **unsure)[0]]
    assert len(found) == 3
    assert all(words.startswith("turns about the ball's center") for words in found)


def edge(x, y):
    """A roof whose ridge lies along (1, 0.1)."""
    return -0.4 * np.abs(y - 0.1 * x)


def test_a_blind_shift_turns_nothing():
    """Its least turn, times a prior of 10 mm, would make a yaw look uncertain that is seen."""
    for seeds in ((1, 2), (3, 4), (5, 6)):
        (blind,), seen = blind_of(edge, seeds)
        assert blind.words.startswith("shifts along"), blind.words
        np.testing.assert_array_equal(blind.direction[3:], 0)
        along = blind.direction[:3] / np.sign(blind.direction[0])
        np.testing.assert_allclose(along, np.array([1, 0.1, 0]) / np.hypot(1, 0.1), atol=0.01)
        assert np.linalg.matrix_rank(seen[3:]) == 3, "all turns are seen"


def test_the_other_directions_are_seen():
    """Free motions of a ball are shifts; those of a cylinder do not roll, and do not shift along it."""
    blind, seen = blind_of(ball)
    assert len(blind) == 3
    np.testing.assert_array_equal(seen, np.eye(6)[:, :3])
    blind, seen = blind_of(cylinder)
    assert (len(blind), seen.shape) == (2, (6, 4))
    assert np.abs(seen[3]).max() < 0.02
    assert np.abs(seen[0]).max() < 0.2
    assert blind_of(texture())[1].shape == (6, 6)
