"""Templates of a ball: presses whose imprint is as bright on one side as on the other, and frames without one.

Color changes of presses: taken once, as each color model wants them.
"""

import csv
from dataclasses import replace

import cv2
import numpy as np
import pytest

import gelform
from gelform.calibration.circles import prepare as templates
from gelform.calibration.circles.find import (
    MIN_EVIDENCE,
    ContactCircle,
    PreparedPress,
    marked_contact,
    why_no_contact,
)
from gelform.calibration.circles.locate import locate
from gelform.calibration.circles.prepare import (
    USUAL_OFFSET,
    ColorChanges,
    change_settings,
    change_without_markers,
    find_by_templates,
    find_contacts,
    prepare,
    prepared_with,
)
from gelform.calibration.presses.press_set import presses_from_simulated
from gelform.image.background import ChangeSettings, PreparedBackground, color_change_from_image
from gelform.image.markers import MarkerFinder
from gelform.simulate import Ball, Pose, simulate_background, simulate_ball_presses, simulate_sequence
from made.images import grid, image_of_dots

SHAPE, RADIUS = (120, 160), 14.0
CIRCLES = [(40.0, 35.0), (110.0, 80.0), (75.0, 50.0), (120.0, 30.0)]


def even_press(name, x, y, rng, strength=0.3):
    """A press that is brighter all around in red, and odd by a little in blue, in noise."""
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]]
    rho = np.hypot(cols - x, rows - y) / RADIUS
    inside = np.clip((1 - rho) / 0.1, 0, 1)
    change = np.zeros((*SHAPE, 3), np.float32)
    change[..., 0] = strength * inside * rho**2
    change[..., 2] = 0.2 * strength * inside * (cols - x) / RADIUS
    change += rng.normal(0, 0.01, change.shape).astype(np.float32)
    return PreparedPress(name, change, np.linalg.norm(change, axis=-1).astype(np.float32), 30.0)


@pytest.fixture(scope="module")
def even():
    rng = np.random.default_rng(4)
    return [even_press(f"{k}.png", *center, rng) for k, center in enumerate(CIRCLES)]


def test_a_press_that_is_brighter_all_around_is_found(even):
    found = find_contacts(even)
    for contact, (x, y) in zip(found, CIRCLES):
        assert contact.antisymmetry < 0.3, "the first finder does not see it"
        assert (contact.x_px, contact.y_px) == pytest.approx((x, y), abs=0.15 * RADIUS)
        assert contact.radius_px == pytest.approx(RADIUS, rel=0.2)
        assert contact.evidence > 3 * MIN_EVIDENCE
        assert why_no_contact(contact) is None


def test_a_circle_that_is_known_stays_and_noise_is_no_ball(even):
    rng = np.random.default_rng(5)
    nothing = even_press("nothing", 0.0, 0.0, rng, strength=0.0)
    known = [(*center, RADIUS) for center in CIRCLES]
    assert find_by_templates(even, known) == {}
    ((index, (_, evidence)),) = find_by_templates([*even, nothing], [*known, None]).items()
    assert index == 4
    assert evidence < MIN_EVIDENCE
    (last,) = find_contacts([nothing])
    assert why_no_contact(last) is not None


def test_what_most_frames_show_is_no_ball(monkeypatch):
    """A disc at one place of every frame, beside three firm presses and a light one."""
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]]
    speck = 0.05 * np.clip((1 - np.hypot(cols - 20, rows - 95) / RADIUS) / 0.1, 0, 1)[..., None]
    rng = np.random.default_rng(4)
    strengths = (0.4, 0.4, 0.4, 0.08)
    presses = [even_press("a", *center, rng, strength) for center, strength in zip(CIRCLES, strengths)]
    framed = [replace(press, color_change=press.color_change + np.float32(speck)) for press in presses]

    def places():
        found = find_by_templates(framed, [None] * 4)
        return [np.hypot(*np.subtract(found[k][0][:2], center)) < 4 for k, center in enumerate(CIRCLES)]

    assert places() == [True] * 4
    monkeypatch.setattr(templates, "COMMON", 0.0)
    assert not places()[3], "without the noise of the place, the light press is taken for the disc"


def test_a_stage_s_center_stays_and_templates_give_its_radius(even):
    """About the center alone, another press's edge would be taken for the rim."""
    x, y = CIRCLES[0]
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]]
    ring = (np.hypot(cols - x, rows - y) < 45)[..., None] * np.float32([0.0, 0.35, 0.0])
    first = even[0].color_change + ring.astype(np.float32)
    size = np.linalg.norm(first - np.median(first, axis=(0, 1)), axis=-1).astype(np.float32)
    staged = replace(even[0], color_change=first, size=size, mark=(x + 1, y - 1, None))
    contact = find_contacts([staged, *even[1:]])[0]
    assert contact.marked
    assert (contact.x_px, contact.y_px) == (x + 1, y - 1)
    assert contact.radius_px == pytest.approx(RADIUS, rel=0.25)


@pytest.mark.parametrize(
    ("antisymmetry", "apart", "taken"), [(0.1, 40.0, True), (0.6, 3.0, True), (0.6, 40.0, False)]
)
def test_a_circle_by_hand_is_taken_unless_a_clear_ball_is_elsewhere(even, antisymmetry, apart, taken):
    press, (x, y) = even[0], CIRCLES[0]
    clear = ContactCircle(x + apart, y, RADIUS, antisymmetry, 5.0)
    contact = marked_contact(clear, press.size, x, y, RADIUS)
    assert contact.marked == taken
    assert (contact.x_px, contact.y_px) == ((x, y) if taken else (x + apart, y))
    if taken:
        assert contact.radius_px == pytest.approx(RADIUS, rel=0.15)
        assert why_no_contact(contact) is None


@pytest.mark.slow
def test_presses_of_home_made_sensors_are_found_without_their_circles(data):
    folder = data / "homemade-even" / "a"
    presses = gelform.read_presses(folder)
    with (folder / "presses.csv").open(encoding="utf-8") as file:
        circles = {row["image"]: [float(v) for v in list(row.values())[2:5]] for row in csv.DictReader(file)}
    bare = tuple(replace(press, label=None) for press in presses.presses)
    for press, contact in zip(bare, find_contacts(prepare(replace(presses, presses=bare)))):
        x, y, radius = circles[press.name]
        assert np.hypot(contact.x_px - x, contact.y_px - y) < 0.2 * radius  # the circles are by eye


@pytest.fixture(scope="module")
def few(presses):
    return presses.subset([0, 3])


def test_the_change_is_that_of_the_path(few):
    settings = change_settings(few)
    change, clear = ColorChanges(few.background, settings)(few.presses[0].image)
    rest = PreparedBackground(few.background, settings)
    exposure, _ = rest.compare(few.presses[0].image)
    np.testing.assert_array_equal(change, rest.change(few.presses[0].image, exposure))
    calls = []
    (one,) = prepare(few.subset([0]), progress=lambda *call: calls.append(call[:2]))
    assert calls == [(1, 1)]
    assert one.ball_radius_px == few.presses[0].ball_diameter_mm / 2 / few.mm_per_px
    np.testing.assert_array_equal(one.color_change, change)
    np.testing.assert_allclose(
        one.size, np.linalg.norm(change - np.median(change, (0, 1)), axis=-1), atol=1e-6
    )
    assert clear is None, "a gel without markers has no pixel to leave out"


def test_the_blur_grows_with_the_image(few):
    assert change_settings(few).blur_px == pytest.approx(1.25 * few.image_shape[0] / 240)
    taller = replace(few, background=np.repeat(np.repeat(few.background, 2, 0), 2, 1))
    assert change_settings(taller).blur_px == pytest.approx(2 * change_settings(few).blur_px)


def test_another_offset_has_the_edge_of_the_contacts(few):
    """It is measured once, in what circles are found in."""
    usual = [replace(press, contact_radius_ratio=0.7) for press in prepare(few, USUAL_OFFSET)]
    assert prepared_with(few, usual, USUAL_OFFSET) is usual
    found = prepared_with(few, usual, 0.0)
    assert [(press.name, press.contact_radius_ratio) for press in found] == [
        (press.name, 0.7) for press in usual
    ]
    assert not np.array_equal(found[0].color_change, usual[0].color_change)


def test_a_circle_for_each_press_and_progress_for_each(few):
    calls = []
    found = find_contacts(prepare(few, USUAL_OFFSET), progress=lambda *call: calls.append(call[:2]))
    assert len(found) == 2
    assert calls == [(1, 2), (2, 2)]


@pytest.mark.parametrize("marked", [False, True])
def test_nothing_is_learnt_where_a_background_of_0_divides(few, marked, monkeypatch):
    """Of the offset 0 those pixels are not usable, beside those on markers; of others all are."""
    black = few.background.copy()
    black[5, 7, 1] = 0
    free = np.ones(few.image_shape, dtype=bool)
    free[20, 30] = not marked
    usual, plain = prepare(few), ColorChanges.__call__
    if marked:
        monkeypatch.setattr(ColorChanges, "__call__", lambda self, image: (plain(self, image)[0], free))
    divided, other = (prepared_with(replace(few, background=black), usual, offset) for offset in (0.0, 0.5))
    for press in divided:
        assert np.argwhere(~press.usable).tolist() == [[5, 7], *([[20, 30]] if marked else [])]
        assert np.isfinite(press.color_change).all()
        assert press.color_change[5, 7, 1] == pytest.approx(0, abs=0.05), "its neighbors', by the blur"
    for press in other:
        assert press.usable is None if not marked else not press.usable[20, 30]


def test_the_press_that_is_of_another_sensor_is_named(few):
    turned = replace(few.presses[1], image=np.ascontiguousarray(few.presses[1].image[::-1, ::-1]))
    with pytest.raises(gelform.CalibrationError, match=f"1 of 2 presses do not fit .* {few.presses[1].name}"):
        prepare(replace(few, presses=(few.presses[0], turned)))


def test_one_frame_of_another_light_is_one_rejected_press(presses):
    """It had ended the calibration of all others."""
    dark = replace(presses.presses[1], image=(presses.presses[1].image * 0.4).astype(np.uint8))
    some = replace(presses, presses=(presses.presses[0], dark, *presses.presses[2:6]))
    prepared = prepare(some)
    assert [one.refused is None for one in prepared] == [True, False, True, True, True, True]
    located = locate(some)
    assert "times as bright as in the background" in located.refined.reasons[1]
    assert located.refined.accepted == [0, 2, 3, 4, 5]


SETTINGS = ChangeSettings("divide", 10, 0.7)


def marked(sensor, pitch_mm):
    """The sensor with dots at that pitch; 0: none."""
    return replace(sensor, coating=replace(sensor.coating, marker_pitch_mm=pitch_mm, marker_radius_mm=0.25))


def presses_of(sensor, pitch_mm):
    gel = replace(sensor.gel, bulge=0.5)  # a bulge moves the dots
    made = simulate_ball_presses(
        replace(marked(sensor, pitch_mm), gel=gel),
        ball_diameters_mm=[5.0],
        count=20,
        rng=np.random.default_rng(3),
        oversample=1,
    )
    return made, presses_from_simulated(made)


def unmarked(image, background, settings=SETTINGS):
    """Its color change without markers, and which pixels are usable."""
    rest = PreparedBackground(background, settings)
    return change_without_markers(image, rest, None, MarkerFinder(background))


def spoilt_by_dots(image, background, clean, clean_background):
    """How far the color change is from that without dots."""
    raw = color_change_from_image(image, background, SETTINGS)
    return np.abs(raw - color_change_from_image(clean, clean_background, SETTINGS)).mean(axis=-1)


@pytest.fixture(scope="module")
def plain(sensor):
    return presses_of(sensor, 0.0)


@pytest.fixture(scope="module")
def dotted(sensor):
    return presses_of(sensor, 2.2)


def test_the_change_is_that_of_the_unmarked_gel(plain, dotted):
    background, rest = dotted[1].background, plain[1].background
    spoilt, errors, left_out = [], [], []
    for clean, press in zip(plain[0].presses, dotted[0].presses):
        change, usable = unmarked(press.image, background)
        wanted = color_change_from_image(clean.image, rest, SETTINGS)
        spoilt.append(spoilt_by_dots(press.image, background, clean.image, rest))
        errors.append(np.abs(change - wanted).mean(axis=-1))
        left_out.append(~usable)
    spoilt, errors, left_out = (np.stack(maps) for maps in (spoilt, errors, left_out))
    assert np.count_nonzero(spoilt > 0.2) > 40  # dots that moved
    assert left_out[spoilt > 0.2].mean() > 0.95
    assert left_out.mean() < 0.4
    assert np.mean(errors[spoilt > 0.2]) < 0.5 * np.mean(spoilt[spoilt > 0.2])


def test_dots_that_were_dragged_are_left_out_where_they_are_and_where_they_were(sensor):
    images = []
    for pitch_mm in (0.0, 2.2):
        gel = replace(marked(sensor, pitch_mm), noise_sd=0, noise_gain=0)
        poses = [Pose(0.8, (-3 + 0.25 * k, 0.0)) for k in range(8)]
        *_, last = simulate_sequence(gel, Ball(4), poses, rng=None)
        images.append((simulate_background(gel, None).astype(np.float32), last))
    (clean_rest, clean), (rest, press) = images
    assert np.abs(press.markers_shift_mm).max() > 0.3  # more than a dot's radius
    change, usable = unmarked(press.image, rest)
    spoilt = spoilt_by_dots(press.image, rest, clean.image, clean_rest)
    assert np.count_nonzero(spoilt > 0.2) > 50
    assert np.mean(usable[spoilt > 0.2]) < 0.1
    assert np.mean(usable) > 0.75
    errors = np.abs(change - color_change_from_image(clean.image, clean_rest, SETTINGS)).mean(axis=-1)
    assert errors[usable].max() < 0.6 * spoilt[usable].max()
    assert np.percentile(errors[usable], 99) < 0.7 * np.percentile(spoilt[usable], 99)
    assert np.mean(MarkerFinder(rest).mask(press.image)[spoilt > 0.2]) > 0.9  # the fast way sees them too


def test_an_unmarked_gel_is_left_as_it_is(plain):
    image, background = plain[0].presses[0].image, plain[1].background
    change, usable = unmarked(image, background)
    assert usable is None
    np.testing.assert_array_equal(change, color_change_from_image(image, background, SETTINGS))


@pytest.mark.parametrize("blur_px", [0.0, 0.7, 2.0])
def test_only_dots_are_left_out_and_a_blur_carries_nothing_of_them(blur_px):
    background = image_of_dots(grid(), noise=1.0)
    press = image_of_dots(np.add(grid(), [1.5, 0.5]), noise=3.0, seed=1)
    settings, finder = ChangeSettings("divide", 10, blur_px), MarkerFinder(background)
    change, usable = unmarked(press, background, settings)
    np.testing.assert_array_equal(~usable, finder.untouched.mask | finder(press).mask)
    plain = PreparedBackground(background, settings).change(press)
    far = cv2.erode(usable.view(np.uint8), np.ones((11, 11), np.uint8)) > 0
    assert np.count_nonzero(far) > 50
    np.testing.assert_allclose(change[far], plain[far], atol=2e-3)
    assert (
        np.sqrt(np.mean(change[usable] ** 2)) < 0.045
    )  # nothing changed but the noise, 3 levels of some 130
    if blur_px > 1:
        assert np.sqrt(np.mean(plain[usable] ** 2)) > 0.06


def test_samples_leave_the_dots_out(dotted):
    made, presses = dotted
    for true, press in zip(made.presses, prepare(presses, 10.0)):
        contact = ContactCircle(*true.center_px, true.contact_radius_px, 1.0, 9.0)
        rows, cols = press.pixels(contact, 0.8)
        assert len(rows) > 30
        assert np.mean(true.albedo[rows, cols] < 0.9) < 0.02  # a few pixels of the rims
        assert (true.albedo < 0.5).any()


def slope_error(calibration, made, presses):
    """Median slope error in the contacts against the exact truth, on the pixels without dots."""
    errors = []
    for true, press in zip(made.presses, prepare(presses, calibration.change.offset)):
        usable = np.ones(true.contact.shape, bool) if press.usable is None else press.usable
        inside = np.argwhere(true.contact & usable)
        found = press.gradients(calibration.color_model, inside[:, 0], inside[:, 1])
        errors.append(np.linalg.norm(found - true.gradients[inside[:, 0], inside[:, 1]], axis=1))
    return float(np.median(np.concatenate(errors)))


@pytest.mark.slow
def test_calibration_and_evaluation_of_a_marked_gel(dotted):
    """Slopes as good as without dots: there the median error is 0.038."""
    made, presses = dotted
    calibration = gelform.calibrate(presses.subset(range(0, 20, 2)), color_model="polynomial")
    assert sum(row.accepted for row in calibration.report.presses) >= 9
    for row, true in zip(calibration.report.presses, made.presses[::2]):
        if row.accepted:
            off = np.hypot(row.center_x_px - true.center_px[0], row.center_y_px - true.center_px[1])
            assert off < 4
    others, unseen = replace(made, presses=made.presses[1::2]), presses.subset(range(1, 20, 2))
    assert slope_error(calibration, others, unseen) < 1.5 * 0.038
    circles = np.array([row["circle_px"] for row in gelform.evaluate(calibration, unseen).rows])
    true = np.array([press.center_px for press in others.presses])
    assert np.median(np.linalg.norm(circles[:, :2] - true, axis=1)) < 1.5
