"""With memory dots are followed over several spacings, and found again where the gel springs back."""

import numpy as np
import pytest

from gelform.markers import MarkerFollower, MarkerTracker
from made.dots import grid, image_of_dots

SHAPE = (128, 160)
REST = grid(14.0, SHAPE, 12.0)
BACKGROUND = image_of_dots(REST, shape=SHAPE, noise=1.0)
FOLLOWER = MarkerFollower(BACKGROUND, 0.1)
ORDER = np.linalg.norm(FOLLOWER.rest_px[:, None] - REST, axis=-1).argmin(axis=1)


def dragged(spacings):
    """A wide drag to the lower right: the middle by so many spacings, the border hardly."""
    away = np.sum(((REST - [60, 50]) / [60, 50]) ** 2, axis=1)
    return np.exp(-1.2 * away)[:, None] * np.array([1.0, 0.6]) * 14 * spacings


def image(moved, seed, gone=()):
    left = np.delete(np.arange(len(REST)), gone)
    return image_of_dots((REST + moved)[left], shape=SHAPE, noise=1.0, seed=seed, light=0.3)


def test_two_spacings_without_a_swap():
    tracker = MarkerTracker(FOLLOWER)
    for k, spacings in enumerate(np.linspace(0, 2.0, 15)):
        moved = dragged(spacings)
        flow = tracker.update(image(moved, k, gone=[40] if k > 5 else ()))
        error = np.linalg.norm(flow.displacement_px - moved[ORDER], axis=1)[flow.seen]
        assert error.max() < 0.3
        assert np.sqrt(np.mean(error**2)) < 0.1
    assert (~flow.seen).sum() <= 2
    assert np.linalg.norm(flow.displacement_mm, axis=1).max() > 1.4 * 1.5


def test_dots_that_move_by_more_than_half_a_spacing_a_frame_keep_their_speed():
    tracker = MarkerTracker(FOLLOWER)
    for k, spacings in enumerate((0, 0.3, 0.75, 1.3, 1.95, 2.6)):
        flow = tracker.update(image(dragged(spacings), k))
        error = np.linalg.norm(flow.displacement_px - dragged(spacings)[ORDER], axis=1)[flow.seen]
        assert flow.seen.mean() > 0.9
        assert error.max() < 0.3


def test_a_gel_that_springs_back_is_at_rest():
    tracker = MarkerTracker(FOLLOWER)
    for k, spacings in enumerate(np.linspace(0, 1.0, 9)):
        tracker.update(image(dragged(spacings), k))
    flow = tracker.update(image(dragged(0.0), 20))
    assert flow.seen.all()
    assert np.abs(flow.displacement_px).max() < 0.2


def test_reset_forgets():
    tracker = MarkerTracker(FOLLOWER)
    first = tracker.update(image(dragged(0.2), 0))
    tracker.update(image(dragged(0.6), 1))
    tracker.reset()
    again = tracker.update(image(dragged(0.2), 0))
    np.testing.assert_array_equal(again.now_px, first.now_px)


def test_a_background_or_its_follower():
    moved = image(dragged(0.2), 0)
    by_image = MarkerTracker(BACKGROUND, 0.1).update(moved)
    np.testing.assert_array_equal(by_image.now_px, MarkerTracker(FOLLOWER).update(moved).now_px)
    with pytest.raises(ValueError, match="mm_per_px of the follower"):
        MarkerTracker(FOLLOWER, 0.1)


def test_a_gel_without_markers_has_no_flow():
    tracker = MarkerTracker(image_of_dots(REST[:0], shape=SHAPE))
    assert tracker.update(image_of_dots(REST[:0], shape=SHAPE)) is None
    assert len(tracker) == 0
