"""Sets of presses that are wrong as a whole: reversed channels, a touched background, presses in one corner."""

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

import gelform
from gelform.calibration.circles.find import find_contact
from gelform.calibration.circles.locate import Located, Refined, refine
from gelform.calibration.circles.prepare import prepare
from gelform.calibration.inputs import (
    check_inputs,
    contact_in_background,
    imprint_notes,
    input_notes,
    light_notes,
    light_order_note,
    light_turn,
    shape_notes,
    surround_notes,
)
from gelform.calibration.presses.press_set import FlatPress, presses_from_simulated
from gelform.calibration.report.content import report_content
from gelform.calibration.report.learning import learning_curve
from gelform.calibration.report.record import used_in_words
from gelform.image.view import View
from gelform.simulate import Led, exposed, simulate_ball_presses
from made.halved import halved


def reversed_channels(presses, indices, background=False):
    """The presses with red and blue exchanged in some images."""
    images = [
        replace(press, image=np.ascontiguousarray(press.image[..., ::-1])) if k in indices else press
        for k, press in enumerate(presses.presses)
    ]
    rest = presses.background[..., ::-1] if background else presses.background
    return replace(presses, presses=tuple(images), background=np.ascontiguousarray(rest))


@pytest.mark.parametrize(
    ("diameter", "error", "message"),
    [
        (-1, ValueError, "ball_diameter_mm > 0, got -1"),
        (300, ValueError, "ball_diameter_mm up to 200 mm, got 300"),
        (float("nan"), ValueError, "ball_diameter_mm > 0, got nan"),
        ("6", TypeError, "ball_diameter_mm as a number, got '6'"),
    ],
)
def test_a_ball_that_none_is_in_memory(presses, diameter, error, message):
    wrong = replace(presses.presses[1], ball_diameter_mm=diameter)
    mixed = replace(presses, presses=(presses.presses[0], wrong, *presses.presses[2:]))
    with pytest.raises(error, match=rf"Expected {message}.* \({wrong.name}\)"):
        gelform.calibrate(mixed)


@pytest.mark.parametrize(
    ("indices", "background", "message"),
    [
        (range(14), False, "All 14 presses .* are BGR compared with the background"),
        ((), True, "they or the background image were saved in another way"),
        ((2, 5), False, r"2 of 14 presses .* are BGR compared with the background: {2}, {5}\."),
    ],
)
def test_presses_whose_channels_are_reversed_are_refused(presses, indices, background, message):
    check_inputs(presses)
    names = {str(k): press.name for k, press in enumerate(presses.presses)}
    said = re.sub(r"\{(\d)\}", lambda found: names[found[1]], message)
    with pytest.raises(gelform.CalibrationError, match=said):
        gelform.calibrate(reversed_channels(presses, indices, background))


def test_gray_presses_are_refused(presses):
    gray = [replace(p, image=np.repeat(p.image[..., 1:2], 3, axis=-1).copy()) for p in presses.presses]
    with pytest.raises(gelform.CalibrationError, match="red, green and blue are equal everywhere"):
        check_inputs(replace(presses, presses=tuple(gray)))


@pytest.mark.parametrize("as_ball", [True, False])
def test_one_image_is_one_press_of_one_thing(presses, as_ball):
    """An image that is listed as a ball and a flat punch, or as punches of two heights, is one too many."""
    one, other = (
        FlatPress(f"flat {k}", press.image, 0.2 + 0.1 * k, press.digest if as_ball else "same")
        for k, press in enumerate(presses.presses[:2])
    )
    with pytest.raises(gelform.CalibrationError, match=r"flat . .* mm high, is the same image as"):
        check_inputs(replace(presses, flats=(one, other)))
    check_inputs(replace(presses, flats=(replace(one, digest="a"), replace(other, digest="b"))))


@pytest.mark.parametrize("k", range(0, 14, 3))
def test_a_background_with_a_contact_in_it(presses, simulated, k):
    """The press that somebody saved as the background."""
    touched = replace(presses, background=presses.presses[k].image.astype(np.float32))
    others = touched.subset([i for i in range(14) if i != k])
    found = contact_in_background(others)
    true = simulated.presses[k]
    assert found is not None
    assert (found.x_px, found.y_px) == pytest.approx(true.center_px, abs=5)
    with pytest.raises(gelform.CalibrationError, match=r"has a contact in it, about \("):
        gelform.calibrate(others)


def test_untouched_backgrounds_pass_and_few_presses_cannot_tell(presses):
    brighter = replace(presses, background=presses.background * np.float32(1.05))
    touched = replace(presses, background=presses.presses[0].image.astype(np.float32))
    at_one_place, few = presses.subset([3] * 8), touched.subset([1, 2, 3, 4])
    for one in (presses, brighter, at_one_place, few):
        assert contact_in_background(one) is None


def turn_of(presses):
    prepared = prepare(presses, 10.0)
    contacts = [find_contact(press.color_change) for press in prepared]
    return prepared, contacts, light_turn(prepared, contacts)


def test_lights_that_come_round_clockwise(sensor):
    """Red from the right, green from below, blue from the left: clockwise as the image shows it (y is down)."""
    places = ((16, 0), (0, 14), (-16, 0.0))
    leds = tuple(Led((x, y, 8.0), tuple(float(c == k) for c in range(3))) for k, (x, y) in enumerate(places))
    round_ = exposed(replace(sensor, leds=leds), 100)
    made = simulate_ball_presses(
        round_, ball_diameters_mm=[6.0], count=6, rng=np.random.default_rng(0), oversample=1
    )
    presses = presses_from_simulated(replace(made, sensor=round_))
    assert turn_of(presses)[2] > 1
    assert turn_of(reversed_channels(presses, range(6), background=True))[2] < -1


def test_folders_that_are_reversed_throughout_are_noted_where_the_sensor_is_known(presses):
    prepared, contacts, turn = turn_of(presses)
    kind = "DIGIT" if turn > 0 else "GelSight Mini"  # the kind whose lights come round the other way
    note = light_order_note(replace(presses, sensor_name=f"{kind}, unit A"), prepared, contacts)
    assert "saved as BGR, or they are mirrored" in note
    other = "GelSight Mini" if turn > 0 else "DIGIT"
    assert light_order_note(replace(presses, sensor_name=other), prepared, contacts) is None
    assert light_order_note(presses, prepared, contacts) is None  # of an unknown kind nothing is known


def test_presses_in_one_corner_are_noted(presses, simulated):
    near = np.divide([p.center_px for p in simulated.presses], presses.image_shape[::-1]) < (0.55, 0.6)
    (corner,) = np.nonzero(near.all(axis=1))
    assert len(corner) >= 3
    prepared, contacts, _ = turn_of(presses.subset(corner))
    refined = Refined(tuple(contacts), (None,) * len(contacts), None)
    notes = input_notes(Located(presses, prepared, [], refined))
    assert any(f"All {len(corner)} presses lie in the" in note and "bottom right (" in note for note in notes)


def test_the_report_says_how_many_presses_are_missing(calibration):
    used = sum(row.accepted for row in calibration.report.presses)
    assert any(
        f"So far {used} presses fit; 20 are advised" in note and "more presses, first at" in note
        for note in calibration.report.notes
    )


def test_too_few_presses_say_where(presses):
    with pytest.raises(
        gelform.CalibrationError, match=r"at least 3 presses .* more presses, first at .* 20 are advised"
    ):
        gelform.calibrate(presses.subset([0, 1]))


@pytest.mark.slow
def test_real_sets_pass_and_are_caught_when_spoilt(data):
    for name, kind in (("mini-ball", "GelSight Mini"), ("digit-ball", "DIGIT"), ("gelsight-ball-deep", "")):
        presses = gelform.read_presses(data / name)
        few = halved(presses.subset(range(0, len(presses.presses), 4)))
        check_inputs(few)
        assert bool(drift_notes(few)) == (name == "gelsight-ball-deep")
        if kind:
            touched = replace(few, background=halved(presses).presses[2].image.astype(np.float32))
            with pytest.raises(gelform.CalibrationError, match="has a contact in it"):
                check_inputs(touched)
            prepared, contacts, turn = turn_of(few)
            assert light_order_note(few, prepared, contacts) is None
            swapped = reversed_channels(few, range(len(few.presses)), background=True)
            assert "saved as BGR" in light_order_note(swapped, *turn_of(swapped)[:2])
            assert abs(turn) > 1


def drift_notes(presses):
    notes = input_notes(Located(presses, [], [], Refined((), (), None)))
    return [note for note in notes if "have drifted" in note]


def test_light_that_drifted_since_the_background_is_noted(presses):
    assert not drift_notes(presses)
    shade = np.linspace(1.06, 0.94, presses.image_shape[1], dtype=np.float32)[:, None]
    assert drift_notes(replace(presses, background=presses.background * shade))


@pytest.mark.parametrize(
    ("channel", "gain", "said"),
    [
        (2, 0.04, "In 100 % of the background image, blue is below 8"),
        (0, 50, "In 100 % of the background image, red is saturated"),
    ],
)
def test_a_channel_that_says_little_is_noted(presses, channel, gain, said):
    assert light_notes(presses.background) == ()
    gains = np.ones(3, np.float32)
    gains[channel] = gain
    (note,) = light_notes(np.minimum(presses.background * gains, 255))
    assert re.match(said, note)
    assert "exposure" in note


@pytest.mark.slow
def test_a_calibration_of_presses_listed_twice_is_that_of_the_presses(presses):
    six = presses.subset(range(6))
    copies = tuple(replace(press, name=f"copy of {press.name}") for press in six.presses)
    once = gelform.calibrate(six, color_model="lambertian")
    twice = gelform.calibrate(replace(six, presses=(*six.presses, *copies)), color_model="lambertian")
    assert twice.held_out == once.held_out
    assert [row.accepted for row in twice.report.presses] == [row.accepted for row in once.report.presses] + [
        False
    ] * 6
    assert not any("times as large" in note for note in twice.report.notes), "copies are no other ball"


def frames_of(press, count):
    """Frames of a press that is held still."""
    noise = np.random.default_rng(0)
    images = [np.clip(press.image + noise.normal(0, 1, press.image.shape), 0, 255) for _ in range(count)]
    return tuple(
        replace(press, name=f"{press.name}, {k}", digest=f"{press.name} {k}", image=image.astype(np.uint8))
        for k, image in enumerate(images)
    )


def test_frames_of_one_press_are_no_presses(presses):
    frames = frames_of(presses.presses[0], 8)
    with pytest.raises(
        gelform.CalibrationError, match=r"at least 3 presses .* got 1 of 8 .* the same press as"
    ):
        gelform.calibrate(replace(presses, presses=frames))


@pytest.mark.slow
def test_fifteen_frames_of_five_presses_are_five_presses(presses):
    """In everything that is fitted, chosen, measured and said."""
    frames = replace(
        presses, presses=tuple(one for press in presses.presses[:5] for one in frames_of(press, 3))
    )
    held = gelform.calibrate(frames)
    rows = held.report.presses
    alone = gelform.calibrate(frames.subset([k for k, row in enumerate(rows) if row.repeats is None]))
    assert sum(row.accepted for row in rows) == held.settings["presses"] == 5
    assert held.held_out == alone.held_out
    assert held.report.candidates == alone.report.candidates
    for one, other in zip(
        held.color_model.to_arrays()[0].values(), alone.color_model.to_arrays()[0].values()
    ):
        np.testing.assert_array_equal(one, other)
    for row in rows:
        assert (row.repeats is None) == row.accepted
        assert row.accepted or row.reason == f"the same press as {row.repeats}"
    assert any(
        note.startswith("10 of 15 images show a press of another image again") for note in held.report.notes
    )
    assert any("So far 5 presses fit" in note for note in held.report.notes)
    assert set(held.training_digests) == {press.digest for press in frames.presses}, "no frame of them is new"
    content, of_alone = (
        report_content(some, one, rng=np.random.default_rng(0))
        for some, one in ((frames, held), (frames.subset([rows.index(r) for r in rows if r.accepted]), alone))
    )
    assert content["verdict"] == of_alone["verdict"]
    assert content["checks"] == of_alone["checks"]
    assert content["figures"] == of_alone["figures"]
    assert used_in_words(rows) == "5 of 5 presses used (10 more images show them again)"
    assert used_in_words(alone.report.presses) == "5 of 5 presses used"
    assert learning_curve(frames, held, rng=np.random.default_rng(0)) is None


def edge_notes(presses, prepared):
    """Of the presses, whose contacts end where they were prepared with."""
    contact = find_contact(prepared[0].color_change)
    refined = Refined((contact,) * len(prepared), (None,) * len(prepared), None)
    notes = input_notes(Located(presses, prepared, [], refined))
    return [note for note in notes if "contact edge" in note]


def test_a_gel_that_leaves_the_ball_early_is_named(presses, prepared):
    """And what looks the same: a ball that is smaller than stated; of two sizes both would have to be."""
    assert edge_notes(presses, prepared) == []
    assert edge_notes(presses, [replace(press, contact_radius_ratio=0.76) for press in prepared]) == []
    cut = [replace(press, contact_radius_ratio=0.54) for press in prepared[:4]]
    assert len({press.ball_radius_px for press in cut}) == 2
    (note,) = edge_notes(presses, cut)
    assert "contact edge is at 0.54 of the visible circles' radius" in note
    assert "smaller than stated" not in note
    (alike,) = edge_notes(presses, [replace(press, ball_radius_px=20.0) for press in cut])
    assert "A ball that is smaller than stated looks the same" in alike


def test_no_press_at_all_is_said(presses):
    """Not that all of them are gray."""
    with pytest.raises(
        gelform.CalibrationError, match=r"Expected presses of a ball in .*, got none\. Press a ball at 20"
    ):
        gelform.calibrate(replace(presses, presses=()))


def imprints(presses, wide=1.0, high=1.0):
    """What `shape_notes` says of presses in images that are resized by two factors."""

    def resized(image):
        return cv2.resize(image, None, fx=wide, fy=high, interpolation=cv2.INTER_LINEAR)

    images = [replace(press, image=resized(press.image)) for press in presses.presses]
    presses = replace(presses, presses=tuple(images), background=resized(presses.background))
    prepared = prepare(presses)
    refined = refine(prepared, [find_contact(press.color_change) for press in prepared])
    return shape_notes(*refined.of_accepted(prepared))


@pytest.mark.slow
def test_imprints_of_a_ball_are_round_in_square_pixels(presses):
    assert imprints(presses) == ()
    for wide, high, how in ((1.25, 1, "wider than high"), (1, 1.25, "higher than wide")):
        (note,) = imprints(presses, wide, high)
        times = float(re.search(r"Imprints are ([\d.]+) times " + how, note)[1])
        assert times == pytest.approx(1.25, abs=0.08)
    assert imprints(presses.subset(range(11)), 1.25) == (), "fewer do not tell"


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["mini-ball", "digit-ball", "gelslim", "gelslim-dots", "mini-d", "gelsight-ball-deep"]
)
def test_real_imprints_are_round_and_fill_the_image(data, name):
    presses = gelform.read_presses(data / name)
    presses = presses.subset(range(0, len(presses.presses), 2))
    assert imprints(presses) == ()
    assert surround_notes(presses) == ()
    if name in ("mini-ball", "gelslim", "gelslim-dots"):
        assert "1.2" in imprints(presses, 1.25)[0] or "1.3" in imprints(presses, 1.25)[0]


def test_a_ball_ten_times_too_large_changes_color_too_much(prepared, found):
    """So does a scale ten times too small: only their ratio is in the image."""
    assert imprint_notes(prepared, found) == ()
    larger = [replace(press, ball_radius_px=10 * press.ball_radius_px) for press in prepared]
    (note,) = imprint_notes(larger, found)
    assert "ball's diameter is too large or mm_per_px too small" in note


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mini-ball", "digit-ball", "gelslim", "gelslim-dots", "gelsight-ball-deep"])
def test_real_imprints_change_color_as_on_their_ball_and_no_ten_times_larger_one(data, name):
    presses = gelform.read_presses(data / name)
    prepared = prepare(presses.subset(range(0, len(presses.presses), 5)), 10.0)
    contacts = [find_contact(press.color_change) for press in prepared]
    assert imprint_notes(prepared, contacts) == ()
    larger = [replace(press, ball_radius_px=10 * press.ball_radius_px) for press in prepared]
    assert len(imprint_notes(larger, contacts)) == 1


def surrounded(presses):
    """The presses seen as a smaller trapezoid in a dark frame with the camera's noise."""
    height, width = presses.image_shape
    corners = np.float32([(0, 0), (width, 0), (width, height), (0, height)])
    seen = np.float32([(60, 40), (width + 50, 40), (width + 60, height + 40), (50, height + 40)])
    noise, change = np.random.default_rng(0), cv2.getPerspectiveTransform(corners, seen)

    def framed(image):
        inside = cv2.warpPerspective(image, change, (width + 110, height + 90))
        return np.clip(inside + noise.normal(3, 1, inside.shape).round(), 0, 255).astype(image.dtype)

    images = tuple(replace(press, image=framed(press.image)) for press in presses.presses)
    return replace(presses, presses=images, background=framed(presses.background))


def test_a_dark_surround_is_named_with_the_crop_that_fits(presses):
    assert surround_notes(presses) == ()
    framed = surrounded(presses)
    assert light_notes(framed.background) == (), "the light is not to blame"
    (note,) = surround_notes(framed)
    left, top, width, height = map(int, re.search(r"--crop (\d+),(\d+),(\d+),(\d+)\.", note).groups())
    assert 58 <= left <= 68
    assert 40 <= top <= 50
    assert width > 0.85 * (presses.image_shape[1] - 10)
    assert height > 0.85 * presses.image_shape[0]
    inside = framed.background[top : top + height, left : left + width]
    assert inside.max(axis=-1).min() > 40, "no pixel of the surround"
    viewed = replace(framed, view=View(framed.image_shape, (0, 0, 100, 100)))
    assert "a smaller crop in the [view]" in surround_notes(viewed)[0]


@pytest.mark.slow
def test_a_calibration_with_a_dark_surround_says_so(presses):
    report = gelform.calibrate(surrounded(presses)).report
    assert [note for note in report.notes if "outside the gel" in note]
    assert not [note for note in report.notes if "Raise its light" in note]
    with pytest.raises(gelform.CalibrationError, match=r"--crop \d+"):
        gelform.calibrate(surrounded(presses.subset([0, 1])))
