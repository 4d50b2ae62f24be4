"""Clipped channels of a background: their share is said, and said of presses in the place of a wrong ball.

Joint refinement: circles get better, what does not fit is rejected with its reason.
"""

import re
from dataclasses import replace

import numpy as np
import pytest

import gelform
from gelform.calibration.circles.find import ContactCircle, PreparedPress, find_contact
from gelform.calibration.circles.locate import ROUNDS, refine
from gelform.calibration.circles.prepare import prepare
from gelform.calibration.circles.refine import (
    JOINT_MOVE_PX,
    joint_moves,
    light_notes,
    misfit_reasons,
    recentered,
    why_impossible,
    why_too_wide,
)
from gelform.image.background import ChangeSettings, color_change_from_image
from gelform.result.metrics import ball_gradients
from gelform.simulate import LAYOUTS, Ball, simulate_press
from gelform.simulate.light import simulate_background


@pytest.mark.parametrize(
    ("channel", "gain", "said"),
    [
        (2, 0.04, r"100 % of the background image .* \(blue in 100 % below 8 gray levels\).*raise the light"),
        (0, 50, r"100 % of the background image .* \(red in 100 % saturated\).*lower"),
    ],
)
def test_a_channel_that_says_little_is_noted(presses, channel, gain, said):
    assert light_notes(presses.background) == ()
    gains = np.ones(3, np.float32)
    gains[channel] = gain
    (note,) = light_notes(np.minimum(presses.background * gains, 255))
    assert re.match(said, note)
    assert "exposure" in note


def test_channels_that_are_clipped_in_turn_are_summed_up():
    """None of them in a tenth of the image; no pixel counts twice."""
    background = np.full((60, 80, 3), 100, np.float32)
    background[20:30, 20:60, 0], background[30:40, 20:60, 2], background[30:34, 20:60, 1] = 255, 255, 2
    (note,) = light_notes(background)
    assert note.startswith(
        "17 % of the background image is at an end of the camera's range (green in 3 % below 8"
    )
    assert "red in 8 %, blue in 8 % saturated" in note
    assert light_notes(np.where(background > 200, 100, background)) == ()


def test_presses_of_clipped_light_are_not_called_no_ball():
    """Their slopes read less than the ball's because of the light."""
    reasons = misfit_reasons([(0.1, 0.4), (0.3, 1.0), (0.05, 1.0)], "17 % of the image is clipped")
    assert reasons[2] is None
    assert all("17 % of the image is clipped" in one and "no ball" not in one for one in reasons[:2])
    assert "it is no ball" in misfit_reasons([(0.1, 0.4), (0.05, 1.0)])[0]


def errors_px(contacts, simulated):
    return off_px(contacts, [p.center_px for p in simulated.presses])


def off_px(contacts, truth):
    return np.linalg.norm(np.array([(c.x_px, c.y_px) for c in contacts]) - truth, axis=1)


@pytest.mark.linear_algebra
def test_refinement_corrects_the_circles_that_the_border_cuts(prepared, found, simulated):
    done = []
    refined = refine(prepared, found, progress=lambda *step: done.append(step[:2]))
    assert done == [(k, ROUNDS) for k in range(1, ROUNDS + 1)]
    before, after = errors_px(found, simulated), errors_px(refined.contacts, simulated)
    kept = refined.accepted
    assert len(kept) >= len(prepared) - 2
    assert after[kept].mean() < 0.7 * before[kept].mean()
    assert after[kept].max() < 4.0


@pytest.mark.linear_algebra
@pytest.mark.slow
def test_a_wrong_ball_is_found_by_the_other_presses(data):
    """One real press under the name of another ball: the others contradict it, and nobody else."""
    presses = gelform.read_presses(data / "mini-ball")
    prepared = prepare(presses, 10.0)
    prepared[20] = replace(prepared[20], ball_radius_px=2 * prepared[20].ball_radius_px)
    found = [find_contact(press.color_change) for press in prepared]
    reasons = refine(prepared, found).reasons
    assert [i for i, reason in enumerate(reasons) if reason is not None] == [20]
    assert "or its ball_diameter_mm is wrong" in reasons[20]


@pytest.mark.linear_algebra
def test_presses_that_were_rejected_before_keep_their_reason(prepared, found):
    refined = refine(prepared, found, excluded={3: "the same image as another"})
    assert refined.reasons[3] == "the same image as another"
    assert 3 not in refined.accepted
    assert refined.contacts[3] == found[3]


@pytest.mark.linear_algebra
def test_double_contact_is_rejected(prepared):
    """Two balls at once: the second is the color change of another press, added far away."""
    prepared = list(prepared)
    shape = prepared[0].size.shape
    other = np.roll(prepared[0].color_change, (shape[0] // 4, shape[1] // 8), axis=(0, 1))
    doubled = prepared[0].color_change + other
    size = np.linalg.norm(doubled - np.median(doubled, axis=(0, 1)), axis=-1).astype(np.float32)
    prepared[0] = replace(prepared[0], color_change=doubled, size=size)
    refined = refine(prepared, [find_contact(press.color_change) for press in prepared])
    assert refined.reasons[0] is not None


@pytest.mark.linear_algebra
def test_impossible_contact_is_rejected_and_named(prepared, found):
    refined = refine([replace(press, ball_radius_px=press.ball_radius_px / 4) for press in prepared], found)
    assert not refined.accepted
    assert "ball diameter or mm_per_px is wrong" in refined.reasons[0]


@pytest.mark.linear_algebra
def test_a_circle_beyond_the_frame_is_rejected_and_named(prepared, found):
    outside = replace(found[0], x_px=-2 * found[0].radius_px)
    assert why_impossible(prepared[0], outside) == "contact lies outside the frame"
    assert why_impossible(prepared[0], found[0]) is None
    inches = replace(prepared[0], ball_radius_px=prepared[0].ball_radius_px / 25.4)
    assert "ball_diameter_mm is in inches" in why_impossible(inches, found[0])


class BallElsewhere:
    """Slopes of a ball whose center is elsewhere, as a model of the others might read them."""

    def __init__(self, press, center_px):
        self.ball = center_px, press.ball_radius_px

    def gradients_at(self, change, x_px, y_px):
        return ball_gradients(x_px, y_px, *self.ball)


@pytest.mark.linear_algebra
def test_a_circle_moves_to_the_ball_but_not_far(prepared, found):
    """By 12 px at most where the frame is 240 px high, and by a quarter of its radius."""
    press, start = prepared[0], replace(found[0], x_px=60.0, y_px=60.0)
    most = min(12 * min(press.size.shape) / 240, start.radius_px / 4)
    assert most == start.radius_px / 4
    near = recentered(press, start, start, BallElsewhere(press, (61.2, 58.5)))
    assert (near.x_px, near.y_px) == pytest.approx((61.2, 58.5), abs=0.05)
    far = recentered(press, start, start, BallElsewhere(press, (60 + 1.2 * most, 60 + 1.6 * most)))
    assert (far.x_px, far.y_px) == pytest.approx((60 + 0.6 * most, 60 + 0.8 * most), abs=0.3)
    wide = replace(start, radius_px=3 * start.radius_px)
    far = recentered(press, wide, wide, BallElsewhere(press, (60 + 12, 60 + 16)))
    assert np.hypot(far.x_px - 60, far.y_px - 60) == pytest.approx(12 * min(press.size.shape) / 240, abs=0.3)


@pytest.mark.linear_algebra
def test_what_does_not_fit_is_three_times_as_far_off_as_usual():
    """Below 0.1 nothing is, above 0.25 everything."""
    for typical, limit in ((0.02, 0.1), (0.05, 0.15), (0.2, 0.25)):
        *others, below, above = misfit_reasons(
            [*[(typical, 1.0)] * 8, (limit - 0.01, 1.0), (limit + 0.01, 1.0)]
        )
        assert others == [None] * 8
        assert below is None
        assert f"limit {limit:.2f}" in above
    assert ["1.50 times" in str(one) for one in misfit_reasons([(0.1, 1.4), (0.1, 1.5)])] == [False, True]


@pytest.fixture(scope="module")
def deep():
    """Presses 0.8-1.3 ball radii deep in a gel that is drawn down far around: the visible circle is wider than the ball."""
    sensor = replace(LAYOUTS["homemade"], shape=(120, 160), mm_per_px=0.11, relaxation_mm=1.2)
    rng = np.random.default_rng(5)
    centers = [(x, y) for y in (-3.8, 0.3, 4.1) for x in (-6.1, -2.2, 2.3, 6.4)]
    made = [
        simulate_press(sensor, Ball(2.0), depth_mm=2 * rng.uniform(0.8, 1.3), center_mm=c, rng=rng)
        for c in centers
    ]
    rest = simulate_background(sensor, rng).astype(np.float32)
    change = [color_change_from_image(one.image, rest, ChangeSettings(blur_px=0.6)) for one in made]
    sizes = [np.linalg.norm(c - np.median(c, axis=(0, 1)), axis=-1).astype(np.float32) for c in change]
    prepared = [PreparedPress(str(k), c, s, 2.0 / 0.11) for k, (c, s) in enumerate(zip(change, sizes))]
    return made, prepared, [find_contact(c) for c in change]


@pytest.mark.linear_algebra
def test_deep_presses_are_used_and_their_centers_come_back(deep):
    made, prepared, found = deep
    wide = np.array([c.radius_px for c in found]) / prepared[0].ball_radius_px
    assert np.median(wide) > 1.1
    refined = refine(prepared, found)
    before, after = (off_px(cs, [p.center_px for p in made]) for cs in (found, refined.contacts))
    assert len(refined.accepted) >= len(made) - 1
    assert np.median(after) < 0.6 * np.median(before)
    assert after[refined.accepted].max() < 0.5 * before.max()


@pytest.mark.linear_algebra
def test_deep_presses_of_another_ball_than_stated_are_refused(deep):
    """Half of the true ball: the gel is steepest far outside of it, which no press of such a ball can be."""
    _, prepared, found = deep
    smaller = [replace(press, ball_radius_px=press.ball_radius_px / 2) for press in prepared]
    reasons = why_too_wide(smaller, found)
    assert all("ball diameter or mm_per_px is wrong" in reason for reason in reasons)
    assert not any(why_too_wide(prepared, found))


SHAPE, BALL_PX, CONTACT_PX = (120, 160), 26.0, 20.0
TRUTH = [(x, y) for y in (30, 60, 90) for x in (30, 65, 100, 130)]


def press_at(center):
    """Colors that are linear in the slope, by lights that turn and weaken over the image, and a little even in it."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    inside = np.hypot(x - center[0], y - center[1]) < CONTACT_PX
    slope = ball_gradients(x, y, center, BALL_PX) * inside[..., None]
    turn = 0.3 * (x - 80) / 80 + 2 * np.pi * np.arange(3)[:, None, None] / 3
    strength = 0.3 * (1 + 0.2 * (y - 60) / 60)
    change = strength * (np.cos(turn) * slope[..., 0] + np.sin(turn) * slope[..., 1])
    change += 0.02 * np.sum(slope**2, axis=-1)
    change = np.moveaxis(change, 0, -1).astype(np.float32)
    return PreparedPress("press", change, np.linalg.norm(change, axis=-1), BALL_PX)


def circles(centers):
    return [ContactCircle(x, y, CONTACT_PX, 0.8, 10.0) for x, y in centers]


@pytest.mark.linear_algebra
def test_wrong_centers_come_back():
    rng = np.random.default_rng(3)
    presses = [press_at(center) for center in TRUTH]
    contacts = circles(np.array(TRUTH) + rng.uniform(-3, 3, (len(TRUTH), 2)))
    assert np.median(off_px(contacts, TRUTH)) > 1.5
    for _ in range(4):
        moves = joint_moves(presses, contacts, 0.8, (1,), total=6000)
        contacts = circles([(c.x_px + dx, c.y_px + dy) for c, (dx, dy) in zip(contacts, moves)])
    assert off_px(contacts, TRUTH).max() < 0.3


@pytest.mark.linear_algebra
def test_right_centers_stay_and_no_step_is_long():
    presses = [press_at(center) for center in TRUTH]
    stay = joint_moves(presses, circles(TRUTH), 0.8, (1,), total=6000)
    assert np.hypot(*stay.T).max() < 0.1
    far = circles([(x + 9, y) for x, y in TRUTH])
    assert np.hypot(*joint_moves(presses, far, 0.8, (1,), total=6000).T).max() <= JOINT_MOVE_PX / 2 + 1e-9
