"""Refinement: circles get better, what does not fit is rejected with its reason, and the gel's end of the contact is found.

Frames of one press are one press; a ball of another size than stated is named.
"""

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.optimize import brentq

import gelform
from gelform.calibration.circles import locate as module
from gelform.calibration.circles.find import (
    USUAL_EDGE,
    ContactCircle,
    PreparedPress,
    about_median,
    find_contact,
    magnitude,
    prepare,
    with_contacts,
)
from gelform.calibration.circles.locate import (
    BALL_FACTORS,
    JOINT_MOVE_PX,
    LEAST_GAIN,
    NEARLY_ALL,
    RINGS,
    ROUNDS,
    Refined,
    contact_radius_ratio,
    count_presses,
    edge_of_gains,
    joint_moves,
    light_notes,
    locate,
    mark_notes,
    misfit_reasons,
    other_ball_note,
    recentered,
    refine,
    repeated_presses,
    why_impossible,
    why_too_wide,
)
from gelform.calibration.start import Start
from gelform.image.background import ChangeSettings, color_change_from_image
from gelform.result.metrics import ball_gradients
from gelform.simulate import LAYOUTS, Ball, simulate_press
from gelform.simulate.light import simulate_background

SHAPE, BALL_PX, CONTACT_PX, FALLS_PX = (120, 160), 40.0, 22.0, 14.0
TOWARD = np.array([[1.0, 0.1], [-0.5, 0.8], [-0.4, -0.9]])  # of three lights
MIDDLES = (RINGS[:-1] + RINGS[1:]) / 2


def steepness(away):
    """Of a gel that follows a ball up to 22 px and comes back to rest over some 14 px."""
    inside = np.minimum(away, CONTACT_PX)
    return inside / np.sqrt(BALL_PX**2 - inside**2) * np.exp(-np.maximum(away - CONTACT_PX, 0) / FALLS_PX)


def press(rng, visible_px, ball_px=BALL_PX):
    """A press somewhere in the frame; its rim is seen where one likes."""
    x, y = rng.uniform(45, 115), rng.uniform(45, 75)
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]]
    u, v = cols - x, rows - y
    away = np.hypot(u, v)
    slopes = -(steepness(away) / np.maximum(away, 1e-9))[..., None] * np.stack([u, v], axis=-1)
    change = slopes @ TOWARD.T + 0.1 * np.square(slopes).sum(-1, keepdims=True)
    change = (change + rng.normal(0, 0.01, change.shape)).astype(np.float32)
    contact = ContactCircle(x, y, visible_px, 0.9, 5.0)
    return PreparedPress("press", change, magnitude(change), ball_px, contact)


def presses(count, visible_px, seed=3):
    rng = np.random.default_rng(seed)
    made = [press(rng, visible_px) for _ in range(count)]
    return made, [one.found for one in made]


@pytest.mark.parametrize(
    ("count", "visible"), [(12, 1.6), pytest.param(24, 1.6, marks=pytest.mark.slow), (18, 1.25), (18, 1.0)]
)
def test_the_edge_of_a_visible_circle_is_found(count, visible):
    """Within a ring, whatever part of the visible circle it is: where the gel's slope is 0.75 of the ball's."""
    left_ball_px = brentq(lambda r: steepness(r) * np.sqrt(BALL_PX**2 - r**2) / r - LEAST_GAIN, 22, 35)
    wanted = min(left_ball_px / (visible * CONTACT_PX), 1)
    assert contact_radius_ratio(*presses(count, visible * CONTACT_PX)) == pytest.approx(wanted, abs=0.03)


def test_what_presses_were_prepared_with_does_not_decide_and_few_presses_do_not_tell():
    """The edge is measured up to the visible rim, not up to an edge that was assumed before."""
    assert contact_radius_ratio(*presses(11, 1.6 * CONTACT_PX)) == USUAL_EDGE
    made, contacts = presses(12, 1.3 * CONTACT_PX)
    assumed = [replace(one, contact_radius_ratio=0.5) for one in made]
    edge = contact_radius_ratio(made, contacts)
    assert contact_radius_ratio(assumed, contacts) == edge
    off = [replace(one, x_px=one.x_px + 2 * (-1) ** k) for k, one in enumerate(contacts)]
    assert contact_radius_ratio(made, off) == pytest.approx(edge, abs=0.004), "about the fitted centers"


def gains_of(curve, presses=3):
    """The same gains in all presses."""
    return np.tile(np.asarray(curve, dtype=np.float64), (presses, 1))


@pytest.mark.parametrize("read", [1.0, 0.7])
@pytest.mark.parametrize("edge", [0.52, 0.7, 0.86])
def test_a_curve_is_cut_where_it_falls_below_what_is_read_further_in(read, edge):
    """Linear through 0.7 at the edge; a model that reads all slopes too gently says nothing of it."""
    falls = np.clip(LEAST_GAIN - 4 * (MIDDLES - edge), 0.05, 1)
    assert edge_of_gains(read * gains_of(falls)) == pytest.approx(edge, abs=1e-6)


FALLING = np.where(MIDDLES < 0.6, 1, 0.3)


def test_the_median_press_decides_and_one_that_never_falls_has_its_edge_at_the_rim():
    flat, falling = np.ones(len(MIDDLES)), FALLING
    assert edge_of_gains(np.stack([flat, flat, falling])) == 1
    assert edge_of_gains(np.stack([flat, falling, falling])) == edge_of_gains(gains_of(falling))
    for end in (0.9, 1.3):
        assert edge_of_gains(gains_of(np.linspace(1, end, len(MIDDLES)))) == 1


def test_one_low_ring_is_no_edge():
    """A scratch, or a cast shadow: two rings in a row have to be below, but for the last one."""
    curve = np.ones(len(MIDDLES))
    curve[9] = 0.4
    assert edge_of_gains(gains_of(curve)) == 1
    curve[10] = 0.4
    assert MIDDLES[8] < edge_of_gains(gains_of(curve)) < MIDDLES[9]
    last = np.ones(len(MIDDLES))
    last[-1] = 2 * LEAST_GAIN - 1
    assert edge_of_gains(gains_of(last)) == pytest.approx((MIDDLES[-2] + MIDDLES[-1]) / 2)


@pytest.mark.filterwarnings("error")
def test_rings_that_a_press_does_not_show_do_not_count():
    """Cut by the border, or steeper than a ball's rim is followed: NaN, in one press or in all."""
    gains = gains_of(FALLING, 5)
    wanted = edge_of_gains(gains)
    gains[0, :4] = gains[1, 8:14] = gains[2, -3:] = np.nan
    assert edge_of_gains(gains) == wanted
    gains[:, -3:] = np.nan
    assert edge_of_gains(gains) == wanted
    level = gains_of(np.ones(len(MIDDLES)))
    level[:, 12:] = np.nan
    assert edge_of_gains(level) == 1


def repeated(presses):
    return repeated_presses(presses, prepare(presses))


SAVED = {  # the same picture, in another way
    "as JPEG": lambda image: cv2.imdecode(cv2.imencode(".jpg", image)[1], cv2.IMREAD_COLOR),
    "3 gray levels brighter": lambda image: image + 3.0,
    "redder": lambda image: image + np.array([3.0, 0, 0]),
    "5 % brighter": lambda image: image * 1.05,
    "a moment later": lambda image: image + np.random.default_rng(0).normal(0, 2, image.shape),
}


def saved_again(press, how):
    pixels = np.clip(np.rint(SAVED[how](press.image)), 0, 255).astype(np.uint8)
    return replace(press, name=f"{press.name} {how}", image=pixels)


@pytest.mark.parametrize("how", SAVED)
def test_one_picture_saved_in_two_ways_is_one_press(presses, how):
    four = presses.subset(range(4))
    both = replace(four, presses=(*four.presses, *(saved_again(one, how) for one in four.presses)))
    assert {frozenset(pair) for pair in repeated(both).items()} == {frozenset((k, k + 4)) for k in range(4)}
    assert repeated(four) == {}
    assert count_presses(both) == 4


def kept(presses, circles, balls=(60.0,) * 9):
    """The frames that show a press again, and the ones that stay, by circles (x, y, radius) and balls, px."""
    blank = np.zeros((240, 320), np.float32)
    found = [ContactCircle(*circle, 1.0, 9.0) for circle in circles]
    prepared = [PreparedPress("", blank[..., None], blank, *pair) for pair in zip(balls, found)]
    one = presses.presses[0]
    frames = tuple(replace(one, image=np.full_like(one.image, k)) for k in range(len(found)))
    background = np.zeros((240, 320, 3), np.float32)
    return repeated_presses(replace(presses, presses=frames, background=background), prepared)


def test_a_press_that_deepens_is_one_and_the_deepest_frame_stays(presses):
    deepening = [(100, 90, 20), (100.5, 90, 24), (200, 90, 24), (100, 91, 30), (100, 90, 29)]
    assert kept(presses, deepening) == {0: 3, 1: 3, 4: 3}
    assert kept(presses, [(100, 90, 30), (100, 90, 61)]) == {1: 0}, "there the gel has left the ball"
    assert kept(presses, [(100, 90, 30), (100, 90, 30)]) == {1: 0}, "of equal ones the first"


def test_the_same_place_is_within_two_pixels_and_of_the_same_ball(presses):
    assert kept(presses, [(100, 90, 30), (101.9, 90, 30)]) == {1: 0}
    assert kept(presses, [(100, 90, 30), (102.1, 90, 30)]) == {}
    assert kept(presses, [(100, 90, 30), (100, 90, 30)], (60.0, 61.0)) == {}
    drifting = [(100 + 1.5 * k, 90, 30 + 0.1 * k) for k in range(4)]
    assert kept(presses, drifting) == {0: 3, 1: 3, 2: 3}, "by way of the frames between"


def test_frames_without_a_contact_hide_no_press(presses):
    """Their circles are somewhere; each is rejected for its own reason."""
    blank = replace(presses.presses[0], image=presses.background.astype(np.uint8))
    found = [ContactCircle(30, 20, 10, 1.0, 9.0), ContactCircle(30, 20, 14, 0.0, 1.0)]
    both = replace(presses, presses=(presses.presses[0], blank))
    for circles in (found, found[1:] * 2):
        shown = [replace(press, found=one) for press, one in zip(prepare(both), circles)]
        assert repeated_presses(both, shown) == {}


def test_one_image_of_two_balls_is_refused(presses):
    one = presses.presses[0]
    other = replace(one, name="other", ball_diameter_mm=1.0)
    with pytest.raises(gelform.CalibrationError, match="same image, listed with balls of 1 and"):
        repeated(replace(presses, presses=(*presses.presses, other)))


@pytest.mark.slow
def test_real_presses_differ(data):
    few = gelform.read_presses(data / "mini-ball").subset(range(0, 67, 3))
    assert repeated(few) == {}
    again = replace(few, presses=(*few.presses, *(saved_again(one, "as JPEG") for one in few.presses)))
    assert len(repeated(again)) == len(few.presses)


def stated(prepared, factor):
    return [replace(press, ball_radius_px=factor * press.ball_radius_px) for press in prepared]


@pytest.mark.slow
def test_a_ball_that_is_stated_half_as_large_is_named(prepared, found):
    """All presses are refused, and taken with the ball that the sentence names."""
    small = stated(prepared, 0.5)
    refined = refine(small)
    assert not refined.accepted
    note = other_ball_note(small, refined)
    said = re.match(r"(\d+) of (\d+) presses fit a ball ([\d.]+) times as large as stated", note)
    count, of, factor = (float(one) for one in said.groups())
    assert "Check ball_diameter_mm and mm_per_px" in note
    assert factor > 1.25
    assert of == len(prepared)
    named = BALL_FACTORS[abs(BALL_FACTORS - factor).argmin()]
    assert len(refine(stated(small, named)).accepted) == count >= NEARLY_ALL * len(prepared)


def test_circles_by_hand_of_other_places_and_sizes_are_named(prepared, found):
    circles = [contact.circle_px for contact in found[:6]]
    right = [replace(press, mark=circle) for press, circle in zip(prepared, circles)]
    assert mark_notes(with_contacts(right)) == ()
    swapped = [replace(right[0], mark=circles[1]), replace(right[1], mark=circles[0]), *right[2:]]
    (note,) = mark_notes(swapped := with_contacts(swapped))
    assert note.count("radii)") == 2
    assert prepared[0].name in note
    assert swapped[0].found.circle_px == pytest.approx(circles[0]), "as without"
    wide = [replace(press, mark=(x, y, 2 * radius)) for press, (x, y, radius) in zip(prepared, circles)]
    (note,) = mark_notes(with_contacts(wide))
    assert "was the diameter given?" in note
    beyond = replace(prepared[0], mark=(352, 33, 20))
    assert "lies outside the image, at 2.00 of its width and 0.25 of its height" in why_impossible(beyond)
    assert why_impossible(right[0]) is None


@pytest.fixture
def note_of(prepared, monkeypatch):
    """The note on ten presses, by how many are accepted and how well, for a ball so many times as large as at first."""

    def note_of(accepted, error, excluded=()):
        presses = [prepared[0]] * 10

        def factor_of(press):
            return press.ball_radius_px / presses[0].ball_radius_px

        def refine(presses):
            refused = 10 - accepted(factor_of(presses[0]))
            reasons = ("too wide",) * refused + (None,) * (10 - refused)
            return Refined(tuple(press.found for press in presses), reasons[-len(presses) :], "model")

        monkeypatch.setattr(module, "refine", refine)
        monkeypatch.setattr(module, "agreement", lambda press, *_: (error(factor_of(press)), 1.0))
        return other_ball_note(presses, refine(presses), excluded)

    return note_of


def best_at(factor):
    """Errors that are least, over the slopes, for a ball so many times as large: those of larger balls are gentler."""
    return lambda tried: 0.01 * (3 + abs(tried - factor)) / tried


def for_another(accepted, stated=0):
    """So many presses are accepted for any other ball than the stated one."""
    return lambda tried: stated if abs(tried - 1) < 0.01 else accepted


@pytest.mark.parametrize("factor", [BALL_FACTORS[3], BALL_FACTORS[13], BALL_FACTORS[-1]])
def test_of_all_that_fit_the_best_one_is_named(note_of, factor):
    said = f"10 of 10 presses fit a ball {factor:.2f} times as large as stated"
    assert note_of(for_another(10), best_at(factor)).startswith(said)


def test_the_best_has_to_fit_nearly_all(note_of):
    """One that eight of ten fit is passed over, however well they do."""
    better, good = BALL_FACTORS[15], BALL_FACTORS[13]
    counts = {better: 8, good: 9}
    note = note_of(
        lambda tried: counts.get(min(BALL_FACTORS, key=lambda f: abs(f - tried)), 0), best_at(better)
    )
    assert note.startswith(f"9 of 10 presses fit a ball {good:.2f} times")


def test_a_ball_that_hardly_differs_is_the_stated_one_and_one_that_fits_none_no_other(note_of):
    """A step of the sweep either way: what is wrong is something else."""
    for factor in BALL_FACTORS[9:12]:
        assert note_of(for_another(10), best_at(factor)) is None
    assert note_of(lambda tried: 0, best_at(1.5)) is None


@pytest.mark.parametrize(("refused", "said"), [(2, False), (3, True)])
def test_some_presses_are_always_refused(note_of, refused, said):
    assert (note_of(for_another(10, 10 - refused), best_at(1.5)) is not None) == said


def test_presses_that_were_refused_before_do_not_count(note_of):
    """The same image listed twice is refused with any ball: it neither asks for another one nor speaks for it."""
    assert note_of(for_another(10, 5), best_at(1.5), range(5)) is None
    assert note_of(for_another(10, 2), best_at(BALL_FACTORS[16]), range(5)).startswith("5 of 5 presses fit")


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


@pytest.fixture(scope="module")
def starter(calibration):
    return Start(
        calibration.color_model, calibration.forward, "digest", 0.1, "the starter of a test", offered=True
    )


@pytest.mark.linear_algebra
def test_an_offered_start_moves_the_circles_of_few_presses(presses, starter):
    few, many = (locate(presses.subset(range(count)), starter) for count in (6, 12))
    assert (few.start, few.refined_by) == (starter, starter.model)
    assert (many.start, many.refined_by) == (starter, None)


@pytest.mark.linear_algebra
def test_an_offered_start_with_which_fewer_presses_fit_is_not_used(presses, starter, monkeypatch):
    def refine_less(presses, *, start=None, **more):
        refined = refine(presses, start=start, **more)
        return refined if start is None else replace(refined, reasons=("misfit", *refined.reasons[1:]))

    monkeypatch.setattr(module, "refine", refine_less)
    located = locate(presses.subset(range(6)), starter)
    assert (located.start, located.refined_by) == (None, None)
    assert located.refined.accepted == list(range(6))
    assert "The starter of a test was not used: 5 presses fit with it, 6 without it." in located.notes


def off_px(contacts, truth):
    return np.linalg.norm(np.array([(c.x_px, c.y_px) for c in contacts]) - truth, axis=1)


@pytest.mark.linear_algebra
def test_refinement_corrects_the_circles_that_the_border_cuts(prepared, found, simulated):
    done = []
    refined = refine(prepared, progress=lambda *step: done.append(step[:2]))
    assert done == [(k, ROUNDS) for k in range(1, ROUNDS + 1)]
    truth = [press.center_px for press in simulated.presses]
    before, after = off_px(found, truth), off_px(refined.contacts, truth)
    kept = refined.accepted
    assert len(kept) >= len(prepared) - 2
    assert after[kept].mean() < 0.7 * before[kept].mean()
    assert after[kept].max() < 4.0


@pytest.mark.linear_algebra
@pytest.mark.slow
def test_a_wrong_ball_is_found_by_the_other_presses(data):
    """One real press under the name of another ball: the others contradict it, and nobody else."""
    presses = gelform.read_presses(data / "mini-ball")
    prepared = prepare(presses)
    prepared[20] = replace(prepared[20], ball_radius_px=2 * prepared[20].ball_radius_px)
    reasons = refine(prepared).reasons
    assert [i for i, reason in enumerate(reasons) if reason is not None] == [20]
    assert "or its ball_diameter_mm is wrong" in reasons[20]


@pytest.mark.linear_algebra
def test_presses_that_were_rejected_before_keep_their_reason(prepared, found):
    refined = refine(prepared, excluded={3: "the same image as another"})
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
    size, contact = magnitude(about_median(doubled)), find_contact(doubled)
    prepared[0] = replace(prepared[0], color_change=doubled, size=size, found=contact)
    refined = refine(prepared)
    assert refined.reasons[0] is not None


@pytest.mark.linear_algebra
def test_impossible_contacts_are_rejected_and_named(prepared, found):
    refined = refine(stated(prepared, 0.25))
    assert not refined.accepted
    assert "ball diameter or mm_per_px is wrong" in refined.reasons[0]
    outside = replace(prepared[0], found=replace(found[0], x_px=-2 * found[0].radius_px))
    assert why_impossible(outside) == "contact lies outside the frame"
    assert why_impossible(prepared[0]) is None
    (inches,) = stated(prepared[:1], 1 / 25.4)
    assert "ball_diameter_mm is in inches" in why_impossible(inches)


class BallElsewhere:
    """Slopes of a ball whose center is elsewhere, as a model of the others might read them."""

    def __init__(self, press, center_px):
        self.ball = center_px, press.ball_radius_px

    def gradients_at(self, change, x_px, y_px):
        return ball_gradients(x_px, y_px, *self.ball)


@pytest.mark.linear_algebra
def test_a_circle_moves_to_the_ball_but_not_far(prepared, found):
    """By 12 px at most where the frame is 240 px high, and by a quarter of its radius."""
    start = replace(found[0], x_px=60.0, y_px=60.0)
    press = replace(prepared[0], found=start)
    most = min(12 * min(press.size.shape) / 240, start.radius_px / 4)
    assert most == start.radius_px / 4
    near = recentered(press, start, BallElsewhere(press, (61.2, 58.5)))
    assert (near.x_px, near.y_px) == pytest.approx((61.2, 58.5), abs=0.05)
    far = recentered(press, start, BallElsewhere(press, (60 + 1.2 * most, 60 + 1.6 * most)))
    assert (far.x_px, far.y_px) == pytest.approx((60 + 0.6 * most, 60 + 0.8 * most), abs=0.3)
    wide = replace(start, radius_px=3 * start.radius_px)
    far = recentered(replace(press, found=wide), wide, BallElsewhere(press, (60 + 12, 60 + 16)))
    assert np.hypot(far.x_px - 60, far.y_px - 60) == pytest.approx(12 * min(press.size.shape) / 240, abs=0.3)


@pytest.mark.linear_algebra
def test_what_does_not_fit_is_three_times_as_far_off_as_usual():
    """Below 0.1 nothing is, above 0.25 everything."""
    for typical, limit in ((0.02, 0.1), (0.05, 0.15), (0.2, 0.25)):
        errors = [*[typical] * 8, limit - 0.01, limit + 0.01]
        *others, below, above = misfit_reasons([(error, 1.0) for error in errors])
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
    depths = ((center, 2 * rng.uniform(0.8, 1.3)) for center in centers)
    made = [simulate_press(sensor, Ball(2.0), depth_mm=z, center_mm=at, rng=rng) for at, z in depths]
    rest = simulate_background(sensor, rng).astype(np.float32)
    change = [color_change_from_image(one.image, rest, ChangeSettings(blur_px=0.6)) for one in made]
    sizes = [magnitude(about_median(one)) for one in change]
    return made, [PreparedPress("", one, s, 2.0 / 0.11, find_contact(one)) for one, s in zip(change, sizes)]


@pytest.mark.linear_algebra
def test_deep_presses_are_used_and_their_centers_come_back(deep):
    made, prepared = deep
    found = [press.found for press in prepared]
    assert np.median([one.radius_px for one in found]) > 1.1 * prepared[0].ball_radius_px
    refined = refine(prepared)
    before, after = (off_px(cs, [p.center_px for p in made]) for cs in (found, refined.contacts))
    assert len(refined.accepted) >= len(made) - 1
    assert np.median(after) < 0.6 * np.median(before)
    assert after[refined.accepted].max() < 0.5 * before.max()


@pytest.mark.linear_algebra
def test_deep_presses_of_another_ball_than_stated_are_refused(deep):
    """Half of the true ball: the gel is steepest far outside of it, which no press of such a ball can be."""
    _, prepared = deep
    reasons = why_too_wide(stated(prepared, 0.5))
    assert all("ball diameter or mm_per_px is wrong" in reason for reason in reasons)
    assert not any(why_too_wide(prepared))


JOINT_BALL_PX, JOINT_CONTACT_PX = 26.0, 20.0
TRUTH = [(x, y) for y in (30, 60, 90) for x in (30, 65, 100, 130)]


def press_at(center):
    """Colors that are linear in the slope, by lights that turn and weaken over the image, and a little even in it."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    inside = np.hypot(x - center[0], y - center[1]) < JOINT_CONTACT_PX
    slope = ball_gradients(x, y, center, JOINT_BALL_PX) * inside[..., None]
    turn = 0.3 * (x - 80) / 80 + 2 * np.pi * np.arange(3)[:, None, None] / 3
    strength = 0.3 * (1 + 0.2 * (y - 60) / 60)
    change = strength * (np.cos(turn) * slope[..., 0] + np.sin(turn) * slope[..., 1])
    change += 0.02 * np.sum(slope**2, axis=-1)
    change = np.moveaxis(change, 0, -1).astype(np.float32)
    (contact,) = circles([center])
    return PreparedPress("press", change, np.linalg.norm(change, axis=-1), JOINT_BALL_PX, contact)


def circles(centers):
    return [ContactCircle(x, y, JOINT_CONTACT_PX, 0.8, 10.0) for x, y in centers]


@pytest.mark.linear_algebra
def test_wrong_centers_come_back_right_ones_stay_and_no_step_is_long():
    rng = np.random.default_rng(3)
    presses = [press_at(center) for center in TRUTH]
    assert np.hypot(*joint_moves(presses, circles(TRUTH)).T).max() < 0.1
    far = circles([(x + 9, y) for x, y in TRUTH])
    assert np.hypot(*joint_moves(presses, far).T).max() <= JOINT_MOVE_PX / 2 + 1e-9
    contacts = circles(np.array(TRUTH) + rng.uniform(-3, 3, (len(TRUTH), 2)))
    assert np.median(off_px(contacts, TRUTH)) > 1.5
    for _ in range(4):
        moves = joint_moves(presses, contacts)
        contacts = circles([(c.x_px + dx, c.y_px + dy) for c, (dx, dy) in zip(contacts, moves)])
    assert off_px(contacts, TRUTH).max() < 0.3
