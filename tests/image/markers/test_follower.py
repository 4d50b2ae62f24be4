"""Dots are followed one by one, against simulated truth, and their pixels with them; a flow says how far they moved."""

import json
from dataclasses import replace

import numpy as np
import pytest

import gelform
from gelform.image.markers import MarkerFlow, MarkerFollower, MarkerTracker
from gelform.image.markers.follower import Neighbors
from gelform.sensors.profiles import SENSORS
from gelform.simulate import Ball, Gel, simulate_background, simulate_sequence, slide_poses
from made.images import RADIUS, grid, image_of_dots

REST = np.array([[10, 10], [30, 10], [50, 10]], dtype=np.float32)
MOVED = np.array([[0, 0], [3, 4], [-6, 8]], dtype=np.float32)


def flow(mm_per_px=0.05, seen=(True, True, False)):
    sigma = np.array([0.02, 0.03, 4.0], dtype=np.float32)
    return MarkerFlow(REST, REST + MOVED, np.array(seen), sigma, mm_per_px)


def test_displacements_in_pixels_and_mm():
    np.testing.assert_array_equal(flow().displacement_px, MOVED)
    np.testing.assert_allclose(flow().displacement_mm, 0.05 * MOVED)
    np.testing.assert_allclose(flow((0.1, 0.2)).displacement_mm, MOVED * [0.1, 0.2])
    np.testing.assert_allclose(flow((0.1, 0.2)).sigma_mm, [0.004, 0.006, 0.8])
    assert flow(None).displacement_mm is None
    assert flow(None).sigma_mm is None


def test_words_count_what_is_seen_and_facts_are_json():
    assert flow().in_words() == "2 of 3 seen, moved 0.125 mm (median), 0.250 mm at most"
    assert flow(None).in_words() == "2 of 3 seen, moved 2.500 px (median), 5.000 px at most"
    assert flow(seen=(False,) * 3).in_words() == "none of 3 seen"
    assert "2 of 3" in repr(flow())
    facts = json.loads(json.dumps(flow().facts()))
    assert (facts["displacement_px"][1], facts["seen"]) == ([3, 4], [True, True, False])
    assert json.loads(json.dumps(flow(None).facts()))["displacement_mm"] is None


REST_FOLLOWER = grid()


def bump(height_px, reach_px=30.0):
    """A displacement to the right that falls off about the middle."""
    away = np.sum((REST_FOLLOWER - [64, 48]) ** 2, axis=1) / reach_px**2
    return np.exp(-away)[:, None] * [height_px, 0.2 * height_px]


@pytest.fixture(scope="module")
def follower():
    return MarkerFollower(image_of_dots(REST_FOLLOWER, noise=1.0), 0.1)


def order_of(follower, places=REST_FOLLOWER):
    """Which of the places each dot of a follower is."""
    return np.linalg.norm(follower.rest_px[:, None] - places, axis=-1).argmin(axis=1)


@pytest.mark.parametrize("height_px", [0.0, 2.0, 7.0])
def test_dots_moved_less_than_half_a_spacing(follower, height_px):
    moved = bump(height_px)
    flow = follower(image_of_dots(REST_FOLLOWER + moved, noise=1.0, seed=1, light=0.3))
    assert flow.seen.all()
    assert np.abs(flow.displacement_px - moved[order_of(follower)]).max() < 0.12
    np.testing.assert_allclose(flow.displacement_mm, 0.1 * flow.displacement_px)


def test_all_dots_moved_alike_by_nearly_half_a_spacing(follower):
    flow = follower(image_of_dots(np.add(REST_FOLLOWER, [6.5, 3.0]), noise=1.0, seed=1))
    inside = np.all(np.add(follower.rest_px, [6.5, 3.0]) < [123, 91], axis=1)
    assert flow.seen[inside].all()
    assert np.abs(flow.displacement_px[inside] - [6.5, 3.0]).max() < 0.12


def test_lost_dots_go_with_their_neighbors(follower):
    gone, moved = [17, 24], bump(5.0)
    flow = follower(image_of_dots(np.delete(REST_FOLLOWER + moved, gone, axis=0), noise=1.0, seed=1))
    lost = np.isin(order_of(follower), gone)
    np.testing.assert_array_equal(flow.seen, ~lost)
    assert np.abs(flow.displacement_px - moved[order_of(follower)])[lost].max() < flow.sigma_px[lost].min()
    assert flow.sigma_px[~lost].max() < 0.2


def test_the_mask_goes_with_the_dots(follower):
    moved = REST_FOLLOWER + bump(7.0)
    image = image_of_dots(moved, noise=1.0, seed=1)
    mask = follower.hidden(image, follower(image))
    y, x = np.mgrid[:96, :128]
    apart = np.min([np.hypot(x - px, y - py) for px, py in np.concatenate([REST_FOLLOWER, moved])], axis=0)
    assert mask[apart < RADIUS].all()
    assert not mask[apart > RADIUS + 3].any()


def test_dots_that_the_border_cuts_go_with_their_neighbors():
    rest = grid(margin=2.0)
    follower = MarkerFollower(image_of_dots(rest, noise=1.0))
    flow = follower(image_of_dots(np.add(rest, [4.0, 2.0]), noise=1.0, seed=1))
    shift = follower._of_all(flow.displacement_px, flow.seen)
    cut = np.arange(len(shift)) >= len(follower)
    assert np.count_nonzero(cut) > 10
    assert np.abs(shift[cut] - [4.0, 2.0]).max() < 0.5


def test_a_dot_that_leaves_its_neighbors_is_not_taken(follower):
    """By 7.6 px of a spacing of 16: it could be another one's."""
    moved = REST_FOLLOWER.copy()
    moved[18, 0] += 7.6
    flow = follower(image_of_dots(moved, noise=1.0, seed=1))
    np.testing.assert_array_equal(flow.seen, order_of(follower) != 18)


def test_a_place_is_clear_where_one_candidate_is_much_nearer_than_the_next(follower):
    places = np.zeros((1, 2))
    assert not follower._clear(places, np.array([[3.1, 0.0], [0.0, 6.0]]))
    assert follower._clear(places, np.array([[2.9, 0.0], [0.0, 6.0]]))
    assert follower._clear(places, np.array([[3.1, 0.0]]))


def test_no_dots_on_a_dark_image_and_on_a_gel_without_markers(follower):
    flow = follower(np.zeros((96, 128, 3), np.uint8))
    assert not flow.seen.any()
    np.testing.assert_array_equal(flow.now_px, flow.rest_px)
    assert np.isfinite(flow.sigma_px).all()
    tracker = MarkerTracker(image_of_dots(REST_FOLLOWER[:0], noise=1.0))
    assert tracker.update(image_of_dots(REST_FOLLOWER[:0])) is None
    assert len(tracker) == 0


@pytest.fixture(scope="module")
def sheared():
    """A marked gel with missing and broken dots, pressed and dragged: a background and three presses."""
    sensor = SENSORS["gelsight-mini"].simulated()
    coating = replace(
        sensor.coating,
        marker_pitch_mm=1.9, marker_radius_mm=0.35, marker_missing=0.05, marker_broken=0.15, seed=4,
    )  # fmt: skip
    sensor = replace(sensor, coating=coating, gel=Gel(friction=1.0))
    rng = np.random.default_rng(5)
    poses = slide_poses(0.7, (0, 0), (0.6, 0.3), 3)
    return sensor, simulate_background(sensor, rng), list(simulate_sequence(sensor, Ball(4), poses, rng=rng))


def test_simulated_shear_to_a_tenth_of_a_pixel(sheared):
    sensor, background, presses = sheared
    follower = MarkerFollower(background, sensor.mm_per_px)
    errors, ratios = [], []
    for press in presses:
        flow = follower(press.image)
        true = press.markers_shift_mm / sensor.mm_per_px
        own = order_of(follower, press.markers_px - true)
        assert flow.seen.mean() > 0.98
        error = (flow.displacement_px - true[own])[flow.seen]
        errors.append(error)
        ratios.append(np.abs(error) / flow.sigma_px[flow.seen, None])
    assert np.linalg.norm(true, axis=1).max() > 5
    assert np.sqrt(np.mean(np.concatenate(errors) ** 2)) < 0.1
    assert 0.6 < np.mean(np.concatenate(ratios) < 1) < 0.95


def test_real_markers_in_a_frame(data):
    video = gelform.Video(data / "mini-markers-video" / "mini_example.avi")
    first, *others = (frame.image for frame in video.frames({0, 2, 200}))
    follower = MarkerFollower(first)
    assert len(follower) == 70
    rest, pressed = map(follower, others)
    assert rest.seen.all()
    assert np.sqrt(np.mean(rest.displacement_px**2)) < 0.03
    assert pressed.seen.all()


LINEAR = REST_FOLLOWER @ np.array([[0.02, -0.01], [0.03, 0.01]]) + [4.0, -3.0]


def only(*dots):
    return np.isin(np.arange(len(REST_FOLLOWER)), dots)


def test_linear_motion_is_predicted_and_of_one_sure_dot_its_own():
    assert Neighbors(REST_FOLLOWER).spacing_px == 16
    sure = ~only(10, 11, 25)
    predicted = Neighbors(REST_FOLLOWER).predicted_px(LINEAR * sure[:, None], sure, ~sure)
    assert np.abs(predicted - LINEAR[~sure]).max() < 0.15
    predicted = Neighbors(REST_FOLLOWER).predicted_px(LINEAR, only(12), ~only(12))
    np.testing.assert_allclose(predicted, np.broadcast_to(LINEAR[12], predicted.shape), atol=1e-9)


def test_a_dot_that_moves_otherwise_is_astray_where_its_neighbors_are_sure():
    astray = Neighbors(REST_FOLLOWER).astray_px(LINEAR + [16, 0] * only(18)[:, None], ~only())
    assert astray[18] == pytest.approx(16, abs=0.5)
    assert np.delete(astray, 18).max() < 1.5
    assert Neighbors(REST_FOLLOWER).astray_px(LINEAR, only(0))[0] == 0


SHAPE = (128, 160)
WIDE = grid(14.0, SHAPE, 12.0)
BACKGROUND = image_of_dots(WIDE, shape=SHAPE, noise=1.0)
FOLLOWER = MarkerFollower(BACKGROUND, 0.1)
ORDER = order_of(FOLLOWER, WIDE)


def dragged(spacings):
    """A wide drag to the lower right: the middle by so many spacings, the border hardly."""
    away = np.sum(((WIDE - [60, 50]) / [60, 50]) ** 2, axis=1)
    return np.exp(-1.2 * away)[:, None] * np.array([1.0, 0.6]) * 14 * spacings


def image(moved, seed, gone=()):
    left = np.delete(WIDE + moved, gone, axis=0)
    return image_of_dots(left, shape=SHAPE, noise=1.0, seed=seed, light=0.3)


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


def test_a_gel_that_springs_back_is_at_rest_and_reset_forgets():
    tracker = MarkerTracker(FOLLOWER)
    first = tracker.update(image(dragged(0.2), 0))
    for k, spacings in enumerate(np.linspace(0, 1.0, 9)):
        tracker.update(image(dragged(spacings), k))
    flow = tracker.update(image(dragged(0.0), 20))
    assert flow.seen.all()
    assert np.abs(flow.displacement_px).max() < 0.2
    tracker.reset()
    np.testing.assert_array_equal(tracker.update(image(dragged(0.2), 0)).now_px, first.now_px)


def test_a_background_or_its_follower():
    moved = image(dragged(0.2), 0)
    by_image = MarkerTracker(BACKGROUND, 0.1).update(moved)
    np.testing.assert_array_equal(by_image.now_px, MarkerTracker(FOLLOWER).update(moved).now_px)
    with pytest.raises(ValueError, match="mm_per_px of the follower"):
        MarkerTracker(FOLLOWER, 0.1)
