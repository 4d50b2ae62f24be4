"""The stated ball: what its presses say of its diameter by another unit's model, or by another size's presses.

Sets of presses that are wrong as a whole: reversed channels, a touched background, presses in one corner.
"""

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

import gelform
from gelform.calibration.circles.find import ContactCircle, find_contact, prepare
from gelform.calibration.circles.locate import Located, Refined, light_notes, locate, refine
from gelform.calibration.inputs import (
    MOST_SIGMAS,
    REMEDY,
    SIZE_SIGMA,
    UNCHECKED,
    BallReading,
    background_findings,
    ball_readings,
    check_inputs,
    first_notes,
    imprint_aspect,
    imprint_notes,
    input_notes,
    light_order_notes,
    light_press_notes,
    light_response,
    light_turn,
    make_findings,
    mixed_balls,
    notes_of,
    radius_from_gradients,
    shape_notes,
    surround_notes,
)
from gelform.calibration.presses.press_set import FlatPress, presses_from_simulated
from gelform.calibration.report.content import report_content
from gelform.calibration.report.record import learning_curve, used_in_words
from gelform.calibration.start import Start, starter_start
from gelform.calibration.starters import starter_from_calibration
from gelform.errors import CalibrationError
from gelform.image.view import View
from gelform.result.metrics import ball_gradients
from gelform.sensors.profiles import make_of
from gelform.simulate import Led, exposed, simulate_ball_presses
from made.images import halved

SPREAD = 0.05


@pytest.mark.parametrize("radius", [30.0, 50.0, 200.0])
def test_the_radius_comes_back_from_a_ball_s_slopes(radius):
    y, x = np.mgrid[:40, :40]
    near = np.hypot(x - 24, y - 17) < min(0.7 * radius, 25)
    slopes = ball_gradients(x[near], y[near], (24, 17), radius)
    assert radius_from_gradients(slopes, x[near], y[near]) == pytest.approx(radius, rel=1e-9)
    slopes[::50] = 5.0
    assert radius_from_gradients(slopes, x[near], y[near]) == pytest.approx(radius, rel=0.01), "2 % outliers"
    assert np.isinf(radius_from_gradients(np.zeros((9, 2)), np.arange(9), np.arange(9)))


def stated(presses, factor, of=lambda diameter: True):
    """The same images, of balls that are stated so many times as large."""
    balls = [one.ball_diameter_mm * (factor if of(one.ball_diameter_mm) else 1) for one in presses.presses]
    some = tuple(replace(one, ball_diameter_mm=ball) for one, ball in zip(presses.presses, balls))
    return replace(presses, presses=some)


def altered(presses, change, background=None):
    """The presses with changed images, and perhaps a changed background."""
    some = tuple(replace(press, image=change(press.image)) for press in presses.presses)
    rest = presses.background if background is None else background(presses.background)
    return replace(presses, presses=some, background=rest)


@pytest.fixture(scope="module")
def known(calibration):
    """A model that has learned from the right diameters, as another unit's has."""
    return Start(calibration.color_model, calibration.forward, "digest", SPREAD, "another unit")


@pytest.mark.parametrize("factor", [1.0, 2.0, 1.25, 0.8])
def test_a_wrong_diameter_is_read_by_another_unit_s_model(presses, known, factor):
    presses = presses.subset(range(8))
    readings = ball_readings(locate(stated(presses, factor)), known)
    right = sorted({one.ball_diameter_mm for one in presses.presses})
    assert sorted(one.read_mm for one in readings) == pytest.approx(right, rel=0.06)
    assert all((one.sigmas > MOST_SIGMAS) == (factor != 1) for one in readings)
    assert all(one.sigma_mm >= SPREAD * one.read_mm for one in readings)
    words = notes_of(readings)[0]
    assert (REMEDY in words) == (factor != 1)
    assert f"{readings[0].stated_mm:g} mm" in words


@pytest.fixture(scope="module")
def two_sizes(sensor, made_once):
    """Fifteen presses of each of two balls."""
    small = replace(sensor, shape=(120, 160), mm_per_px=0.1268)
    rng = np.random.default_rng(7)
    made = made_once(
        "two_sizes", lambda _: simulate_ball_presses(small, ball_diameters_mm=[4.0, 6.0], count=30, rng=rng)
    )
    return presses_from_simulated(made)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1.0, 1.25, 0.8])
def test_two_sizes_check_each_other(two_sizes, factor):
    (reading,) = ball_readings(locate(stated(two_sizes, factor, of=lambda diameter: diameter == 6)), None)
    against = {4.0: 1 / factor, 6 * factor: factor}[4.0 if reading.stated_mm != 4 else 6 * factor]
    assert reading.read_mm / reading.stated_mm == pytest.approx(against, rel=2 * SIZE_SIGMA)
    assert (reading.sigmas > MOST_SIGMAS) == (factor != 1)
    assert "presses of" in reading.by


def test_one_size_and_no_other_unit_is_said_to_be_unchecked(presses):
    smaller = min(one.ball_diameter_mm for one in presses.presses)
    own = presses.subset([i for i, one in enumerate(presses.presses) if one.ball_diameter_mm == smaller])
    readings = ball_readings(locate(own), None)
    assert readings == ()
    assert notes_of(readings) == (UNCHECKED,)


def test_contacts_that_are_small_on_the_ball_are_said_where_nothing_checks_it(presses):
    """Twice the ball, and half the pitch, with which the gel would be half as wide too."""
    alone = presses.subset(range(8))
    assert light_press_notes(locate(alone), ()) == ()
    wide = max(alone.image_shape) * alone.mm_per_px
    halved_pitch = replace(alone, mm_per_px=alone.mm_per_px / 2)
    for wrong, width in ((stated(alone, 2.0), wide), (halved_pitch, wide / 2)):
        located = locate(wrong)
        (said,) = light_press_notes(located, ())
        low, high = map(float, re.search(r"contacts have ([.\d]+) to ([.\d]+) of the ball", said).groups())
        assert 0.2 < low < high < 0.6
        assert f"{width:.3g} mm wide" in said
        assert REMEDY in said
        assert light_press_notes(located, [BallReading(5.0, 5.0, 0.5, "")]) == (), "the ball was checked"


def test_a_model_of_these_presses_checks_no_ball_that_it_agrees_with():
    agreed, twice = (BallReading(5.0, read, 0.5, "the starter of a DIGIT", own=True) for read in (5.1, 10.0))
    assert (agreed.checks, twice.checks) == (False, True)
    assert notes_of([agreed]) == (
        "Nothing checked the ball's diameter: the starter of a DIGIT was made from these presses.",
    )
    assert "look like a ball of 10 ± 0.5 mm" in notes_of([agreed, twice])[0]


def test_twice_and_half_are_as_far_off():
    twice, half = BallReading(5.0, 10.0, 0.5, ""), BallReading(20.0, 10.0, 0.5, "")
    assert twice.sigmas == half.sigmas == pytest.approx(np.log(2) / 0.05, rel=5e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "every", "factor"), [("mini-ball", 5, 2.0), ("mini-ball", 5, 0.8), ("digit-ball", 3, 2.0)]
)
def test_real_presses_of_a_wrong_diameter_are_never_good_in_silence(data, name, every, factor):
    presses = gelform.read_presses(data / name)
    presses = stated(presses.subset(range(0, len(presses.presses), every)), factor)
    calibration = gelform.calibrate(presses)
    verdict = report_content(presses, calibration, rng=np.random.default_rng(0))["verdict"]
    assert verdict["level"] == "poor"
    assert "diameter" in verdict["headline"]
    assert any("Check the ball's diameter and mm_per_px" in note for note in calibration.report.notes)


@pytest.mark.slow
def test_a_starter_helps_five_presses_of_another_unit(data, monkeypatch):
    """mini-d, read by what another GelSight Mini has shown; its ball is likelier 4.70 mm than the 4.0 that are stated."""
    presses = halved(stated(gelform.read_presses(data / "mini-d"), 1.175))
    five, rest = presses.subset(range(0, 45, 9)), presses.subset(range(4, 45, 9))
    ball = gelform.read_presses(data / "mini-ball")
    ball = halved(ball.subset(range(0, len(ball.presses), 5)))
    own = gelform.calibrate(ball, start=None)
    made = starter_from_calibration(own, "gelsight-mini", spread=0.06, units=("mini-ball",))
    monkeypatch.setattr("gelform.calibration.start.starter_of_make", lambda make: made)
    alone, begun = (gelform.calibrate(five, start=start) for start in (None, "auto"))
    assert alone.settings.start is None
    assert begun.settings.start is not None
    assert any("The starter of a GelSight Mini counts" in note for note in begun.report.notes)
    errors = [gelform.evaluate(one, rest).summary["normal_free_deg"] for one in (alone, begun)]
    assert errors[1] < 0.85 * errors[0]


def test_a_starter_is_not_offered_to_the_presses_that_it_was_made_from(data):
    ball, other = (gelform.read_presses(data / name) for name in ("mini-ball", "mini-d"))
    make, _ = starter_start(ball, "auto")
    assert make is not None, "its ball can be checked by it all the same"
    assert not make.offered
    assert starter_start(other, "auto")[0].offered, "that unit says how far units differ, and is in no model"
    assert not starter_start(other, "lookup")[0].offered
    assert starter_start(gelform.read_presses(data / "gelslim"), "auto")[0] is None
    renamed = replace(gelform.read_presses(data / "gelsight-ball-deep"), sensor_name="DIGIT")
    assert starter_start(renamed, "auto")[0] is None, "a name alone does not make it that sensor"


def test_where_no_press_fits_the_error_says_what_they_look_like(presses, calibration):
    with pytest.raises(CalibrationError, match="look like a ball of"):
        gelform.calibrate(stated(presses.subset(range(5)), 0.3), start=calibration)


def swapped(image):
    """An image with red and blue exchanged."""
    return np.ascontiguousarray(image[..., ::-1])


def frames_of(press, count):
    """Frames of a press that is held still."""
    noise = np.random.default_rng(0)
    images = [np.clip(press.image + noise.normal(0, 1, press.image.shape), 0, 255) for _ in range(count)]
    return tuple(
        replace(press, name=f"{press.name}, {k}", image=image.astype(np.uint8))
        for k, image in enumerate(images)
    )


def test_a_ball_that_none_is_in_memory(presses):
    press = presses.presses[1]
    with pytest.raises(ValueError, match=rf"ball_diameter_mm up to 200 mm, got 300.* \({press.name}\)"):
        replace(press, ball_diameter_mm=300)
    with pytest.raises(TypeError, match="ball_diameter_mm as a number, got '6'"):
        replace(press, ball_diameter_mm="6")


def two_swapped(presses):
    some = [
        replace(one, image=swapped(one.image)) if k in (2, 5) else one
        for k, one in enumerate(presses.presses)
    ]
    return replace(presses, presses=tuple(some))


REFUSED = {
    "all BGR": (
        lambda presses: altered(presses, swapped),
        "All 14 presses .* are BGR compared with the background",
    ),
    "background BGR": (
        lambda presses: altered(presses, np.copy, swapped),
        "they or the background image were saved in another way",
    ),
    "two BGR": (
        two_swapped,
        r"2 of 14 presses .* are BGR compared with the background: \S+0002.png, \S+0005.png\.",
    ),
    "gray": (
        lambda presses: altered(presses, lambda image: np.repeat(image[..., 1:2], 3, axis=-1)),
        "red, green and blue are equal everywhere",
    ),
    "none": (
        lambda presses: presses.subset([]),
        r"Expected presses of a ball in .*, got none\. Press a ball at 20",
    ),
    "two": (
        lambda presses: presses.subset([0, 1]),
        r"at least 3 presses .* more presses, first at .* 20 are advised",
    ),
    "one in eight frames": (
        lambda presses: replace(presses, presses=frames_of(presses.presses[0], 8)),
        r"at least 3 presses .* got 1 of 8 .* the same press as",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_presses_that_are_wrong_or_few_are_refused(presses, name):
    change, message = REFUSED[name]
    with pytest.raises(gelform.CalibrationError, match=message):
        gelform.calibrate(change(presses))


@pytest.mark.parametrize("as_ball", [True, False])
def test_one_image_is_one_press_of_one_thing(presses, as_ball):
    """An image that is listed as a ball and a flat punch, or as punches of two heights, is one too many."""
    images = [press.image if as_ball else presses.presses[0].image + 1 for press in presses.presses[:2]]
    one, other = (FlatPress(f"flat {k}", image, 0.2 + 0.1 * k) for k, image in enumerate(images))
    with pytest.raises(gelform.CalibrationError, match=r"flat . .* mm high, is the same image as"):
        check_inputs(replace(presses, flats=(one, other)))
    check_inputs(
        replace(presses, flats=(replace(one, image=images[0] + 2), replace(other, image=images[1] + 3)))
    )


@pytest.mark.parametrize("k", range(0, 14, 3))
def test_a_background_with_a_contact_in_it(presses, simulated, k):
    """The press that somebody saved as the background."""
    touched = replace(presses, background=presses.presses[k].image.astype(np.float32))
    others = touched.subset([i for i in range(14) if i != k])
    (found,) = background_findings(others)
    true = simulated.presses[k]
    place = [int(n) for n in re.search(r"\((\d+), (\d+)\) px", found.message).groups()]
    assert np.hypot(*np.subtract(place, true.center_px)) < true.contact_radius_px


def test_untouched_backgrounds_pass_and_few_presses_cannot_tell(presses):
    brighter = replace(presses, background=presses.background * np.float32(1.05))
    touched = replace(presses, background=presses.presses[0].image.astype(np.float32))
    at_one_place, few = presses.subset([3] * 8), touched.subset([1, 2, 3, 4])
    for one in (presses, brighter, at_one_place, few):
        assert background_findings(one) == ()


def turn_of(presses):
    prepared = prepare(presses)
    response = light_response(prepared, [find_contact(press.color_change) for press in prepared])
    return response, light_turn(response)


def test_lights_that_come_round_clockwise(sensor):
    """Red from the right, green from below, blue from the left: clockwise as the image shows it (y is down)."""
    places = ((16, 0), (0, 14), (-16, 0.0))
    leds = tuple(Led((x, y, 8.0), tuple(float(c == k) for c in range(3))) for k, (x, y) in enumerate(places))
    round_ = exposed(replace(sensor, leds=leds), 100)
    made = simulate_ball_presses(
        round_, ball_diameters_mm=[6.0], count=6, rng=np.random.default_rng(0), oversample=1
    )
    presses = presses_from_simulated(replace(made, sensor=round_))
    assert turn_of(presses)[1] > 1
    assert turn_of(altered(presses, swapped, swapped))[1] < -1


def test_folders_that_are_reversed_throughout_are_noted_where_the_sensor_is_known(presses):
    response, turn = turn_of(presses)
    kind = "DIGIT" if turn > 0 else "GelSight Mini"  # the kind whose lights come round the other way
    (note,) = light_order_notes(make_of(f"{kind}, unit A"), response)
    assert "saved as BGR, or they are mirrored" in note
    other = "GelSight Mini" if turn > 0 else "DIGIT"
    assert light_order_notes(make_of(other), response) == ()
    assert light_order_notes(None, response) == (), "of an unknown kind nothing is known"


def test_the_notes_of_inputs_are_of_the_reading_the_scale_and_the_light(presses, located, found):
    larger = [replace(press, ball_radius_px=10 * press.ball_radius_px) for press in located.prepared]
    turn = light_turn(light_response(larger, found))
    make = "digit" if turn > 0 else "gelsight-mini"  # whose lights come round the other way
    for known, notes in (
        ({"notes": ("As read.",), "make": make}, ("As read.", "saved as BGR, or they are mirrored")),
        ({"make": None, "mm_per_px": 0.02}, ("mm wide",)),
    ):
        said = " ".join(input_notes(replace(located, presses=replace(presses, **known), prepared=larger)))
        for note in (*notes, "The imprints change color"):
            assert note in said


def test_the_report_says_how_many_presses_are_missing(calibration):
    used = sum(row.accepted for row in calibration.report.presses)
    assert any(
        f"Presses that fit so far: {used}; 20 are advised" in note and "more presses, first at" in note
        for note in calibration.report.notes
    )


@pytest.mark.slow
def test_real_sets_pass_and_are_caught_when_spoilt(data):
    for name, kind in (("mini-ball", "GelSight Mini"), ("digit-ball", "DIGIT"), ("gelsight-ball-deep", "")):
        presses = gelform.read_presses(data / name)
        few = halved(presses.subset(range(0, len(presses.presses), 4)))
        check_inputs(few)
        assert background_findings(few) == ()
        assert bool(drift_notes(few)) == (name == "gelsight-ball-deep")
        if kind:
            touched = replace(few, background=halved(presses).presses[2].image.astype(np.float32))
            assert [one.name for one in background_findings(touched)] == ["background_touched"]
            response, turn = turn_of(few)
            assert light_order_notes(few.make, response) == ()
            other = altered(few, swapped, swapped)
            assert "saved as BGR" in light_order_notes(few.make, turn_of(other)[0])[0]
            assert abs(turn) > 1


def drift_notes(presses):
    notes = input_notes(Located(presses, [], Refined((), (), None)))
    return [note for note in notes if "have drifted" in note]


def test_light_that_drifted_since_the_background_is_noted(presses):
    assert not drift_notes(presses)
    shade = np.linspace(1.06, 0.94, presses.image_shape[1], dtype=np.float32)[:, None]
    assert drift_notes(replace(presses, background=presses.background * shade))


@pytest.mark.slow
def test_a_calibration_of_presses_listed_twice_is_that_of_the_presses(presses):
    six = presses.subset(range(6))
    copies = tuple(replace(press, name=f"copy of {press.name}") for press in six.presses)
    once = gelform.calibrate(six, color_model="lambertian")
    twice = gelform.calibrate(replace(six, presses=(*six.presses, *copies)), color_model="lambertian")
    assert twice.held_out == once.held_out
    accepted, alone = ([row.accepted for row in made.report.presses] for made in (twice, once))
    assert accepted == [*alone, *[False] * 6]
    assert not any("times as large" in note for note in twice.report.notes), "copies are no other ball"


@pytest.mark.slow
def test_fifteen_frames_of_five_presses_are_five_presses(presses):
    """In everything that is fitted, chosen, measured and said."""
    frames = replace(
        presses, presses=tuple(one for press in presses.presses[:5] for one in frames_of(press, 3))
    )
    held = gelform.calibrate(frames, color_model="polynomial")
    rows = held.report.presses
    first = frames.subset([k for k, row in enumerate(rows) if row.repeats is None])
    alone = gelform.calibrate(first, color_model="polynomial")
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
    assert any("Presses that fit so far: 5" in note for note in held.report.notes)
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
    notes = input_notes(Located(presses, prepared, refined))
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


def imprints(presses, wide=1.0, high=1.0):
    """What `shape_notes` says of presses in images that are resized by two factors."""

    def resized(image):
        return cv2.resize(image, None, fx=wide, fy=high, interpolation=cv2.INTER_LINEAR)

    prepared = prepare(altered(presses, resized, resized))
    refined = refine(prepared)
    return shape_notes(*refined.of_accepted(prepared))


@pytest.mark.parametrize(("wide", "high"), [(30, 24), (24, 30), (27, 27)])
def test_the_aspect_of_an_ellipse_comes_back(wide, high):
    y, x = np.mgrid[:120, :160]
    size = (np.hypot((x - 80.3) / wide, (y - 60.2) / high) < 1).astype(np.float32)
    contact = ContactCircle(80.3, 60.2, (wide * high) ** 0.5, 1.0, 9.0)
    assert imprint_aspect(size, contact) == pytest.approx(wide / high, rel=0.01)


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
def test_real_imprints_are_round_fill_the_image_and_change_color_as_on_their_ball(data, name):
    presses = gelform.read_presses(data / name)
    presses = halved(presses) if name.startswith("gelslim") else presses  # of 320x427 px
    prepared = prepare(presses.subset(range(0, len(presses.presses), 5)))
    contacts = [find_contact(press.color_change) for press in prepared]
    assert imprint_notes(light_response(prepared, contacts)) == ()
    larger = [replace(press, ball_radius_px=10 * press.ball_radius_px) for press in prepared]
    assert len(imprint_notes(light_response(larger, contacts))) == 1
    presses = presses.subset(range(0, len(presses.presses), 2 if len(presses.presses) < 60 else 3))
    assert imprints(presses) == ()
    assert surround_notes(presses) == ()
    if name in ("mini-ball", "gelslim", "gelslim-dots"):
        (note,) = imprints(presses, 1.25)
        assert "1.2" in note or "1.3" in note


def test_a_ball_ten_times_too_large_changes_color_too_much(prepared, found):
    """So does a scale ten times too small: only their ratio is in the image."""
    assert imprint_notes(light_response(prepared, found)) == ()
    larger = [replace(press, ball_radius_px=10 * press.ball_radius_px) for press in prepared]
    (note,) = imprint_notes(light_response(larger, found))
    assert "ball's diameter is too large or mm_per_px too small" in note


def surrounded(presses):
    """The presses seen as a smaller trapezoid in a dark frame with the camera's noise."""
    height, width = presses.image_shape
    corners = np.float32([(0, 0), (width, 0), (width, height), (0, height)])
    seen = np.float32([(60, 40), (width + 50, 40), (width + 60, height + 40), (50, height + 40)])
    noise, change = np.random.default_rng(0), cv2.getPerspectiveTransform(corners, seen)

    def framed(image):
        inside = cv2.warpPerspective(image, change, (width + 110, height + 90))
        return np.clip(inside + noise.normal(3, 1, inside.shape).round(), 0, 255).astype(image.dtype)

    return altered(presses, framed, framed)


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
    framed = surrounded(presses.subset(range(6)))
    report = gelform.calibrate(framed, color_model="polynomial", start=None).report
    assert [note for note in report.notes if "outside the gel" in note]
    assert not [note for note in report.notes if "Raise its light" in note]
    with pytest.raises(gelform.CalibrationError, match=r"--crop \d+"):
        gelform.calibrate(surrounded(presses.subset([0, 1])))


def test_a_make_that_the_sensors_name_contradicts(presses):
    mini = replace(presses, sensor_name="GelSight Mini, unit A", make="digit", mm_per_px=0.1)
    (found,) = make_findings(mini)
    assert found.name == "make"
    assert "read as those of a digit, but their sensor is called GelSight Mini, unit A" in found.message
    assert make_findings(replace(mini, make="gelsight-mini")) == ()
    assert make_findings(replace(mini, sensor_name="my sensor")) == ()


@pytest.mark.slow
def test_presses_of_two_balls_under_one_diameter_are_named(data):
    """Held-out presses are read far better by two balls; they are not where all are of one."""
    presses = gelform.read_presses(data / "mini-ball")
    small, large = (
        [i for i, one in enumerate(presses.presses) if one.ball_diameter_mm == mm] for mm in (6.31, 9.5)
    )

    def found(chosen, errors=(20.0,)):
        some = presses.subset(chosen)
        stated = tuple(replace(press, ball_diameter_mm=6.31) for press in some.presses)
        return mixed_balls(locate(replace(some, presses=stated)), errors)

    (mixed,) = found([*small[::6], *large[::3]])
    named = {press.name for press in presses.subset(large).presses}
    assert set(mixed.presses) <= named
    assert len(mixed.presses) >= 6
    assert mixed.read_mm / mixed.stated_mm == pytest.approx(1.5, rel=0.2)
    assert mixed.sentence().startswith("Two balls seem to be under one diameter")
    assert found(small[::4]) == found(large[::2]) == ()
    assert found([*small[::6], *large[::3]], [4.0]) == (), "spheres are right"


def test_a_press_that_is_the_background_is_named_as_the_cause(presses):
    """A folder whose background was a press read "it is no ball" of all others."""
    assert first_notes(presses, ())[-1] == UNCHECKED
    touched = replace(presses, background=presses.presses[2].image.astype(np.float32))
    assert first_notes(touched, ())[0].startswith(f"{presses.presses[2].name} is the background image itself")
