"""Color changes of presses, contact circles found in one image, by templates too, and samples of known slopes.

They are held to simulated truth and to real labels.
"""

import os
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import gelform
from gelform.calibration.circles import find as module
from gelform.calibration.circles.find import (
    MIN_EVIDENCE,
    USUAL_OFFSET,
    ColorChanges,
    ContactCircle,
    PreparedPress,
    _signal,
    about_median,
    change_settings,
    contact_radius,
    contact_samples,
    find_by_templates,
    find_contact,
    magnitude,
    marked_contact,
    parabola_offset,
    prepare,
    prepared_with,
    ring_mean,
    scale_of,
    training_samples,
    why_no_contact,
    with_contacts,
    with_rest_samples,
)
from gelform.calibration.circles.locate import locate
from gelform.calibration.presses.press_set import presses_from_simulated
from gelform.image.background import ChangeSettings, PreparedBackground, color_change_from_image
from gelform.image.markers import MarkerFinder
from gelform.result.metrics import followed_radius
from gelform.simulate import Ball, Pose, simulate_background, simulate_ball_presses, simulate_sequence
from made.images import grid, image_of_dots


def change_of(image, background):
    settings = ChangeSettings(blur_px=1.25 * scale_of(background.shape[:2]))
    return color_change_from_image(image, background, settings)


@pytest.fixture(scope="module")
def whole(simulated):
    """The presses that the border does not cut, with their color changes."""
    height, width = simulated.sensor.shape
    pairs = [(press, change_of(press.image, simulated.background)) for press in simulated.presses]
    margins = [1.2 * press.contact_radius_px for press, _ in pairs]
    return [
        (press, change)
        for (press, change), margin in zip(pairs, margins)
        if all(margin < at < n - margin for at, n in zip(press.center_px, (width, height)))
    ]


def test_whole_contacts_are_found_and_circles_move_with_the_image(whole):
    """Every constant in pixels scales, and nothing depends on the place but the light."""
    assert len(whole) >= 6
    for press, change in whole:
        found = find_contact(change)
        assert why_no_contact(found) is None
        assert np.hypot(found.x_px - press.center_px[0], found.y_px - press.center_px[1]) < 1.5
        assert 0.9 < found.radius_px / press.contact_radius_px < 1.35
    change = whole[0][1]
    plain, shifted = find_contact(change), find_contact(np.roll(change, (3, -5), axis=(0, 1)))
    np.testing.assert_allclose((shifted.x_px - plain.x_px, shifted.y_px - plain.y_px), (-5, 3), atol=0.3)
    turned = find_contact(np.ascontiguousarray(change[:, ::-1]))
    mirrored = (change.shape[1] - 1 - plain.x_px, plain.y_px)
    assert (turned.x_px, turned.y_px) == pytest.approx(mirrored, abs=1e-3)


def test_untouched_gel_has_no_contact(simulated):
    noise = np.random.default_rng(0).normal(0, 1.5, simulated.background.shape)
    image = np.clip(simulated.background + noise, 0, 255).astype(np.uint8)
    assert why_no_contact(find_contact(change_of(image, simulated.background))) is not None


def test_radius_is_where_a_disc_ends_and_of_two_rims_the_one_near_a_known_radius():
    """Of the whole, the outer rim, which is steeper."""
    y, x = np.mgrid[:120, :160]
    away = np.hypot(x - 70.4, y - 61.7)
    disc = (away < 24).astype(np.float32)
    assert contact_radius(disc, 70.4, 61.7) == pytest.approx(24, abs=0.5)
    np.testing.assert_allclose(ring_mean(disc, 70.4, 61.7)[1:22], 1)
    np.testing.assert_allclose(ring_mean(disc, 70.4, 61.7)[27:], 0)
    discs = (away < 22).astype(np.float32) + 2 * (away < 45)
    assert contact_radius(discs, 70.4, 61.7) == pytest.approx(45, abs=0.5)
    assert contact_radius(discs, 70.4, 61.7, near_px=20) == pytest.approx(22, abs=0.5)


def test_the_signal_of_a_circle_that_leaves_nothing_beside_it():
    size = np.ones((40, 60), np.float32)
    assert _signal(size, 30, 20, 40.0) == np.inf
    assert _signal(size, 300, 20, 10.0) == 0
    size[15:25, 25:35] = 5
    assert _signal(size, 29.5, 19.5, 5.0) == pytest.approx(5)


def test_the_offset_is_the_vertex_of_a_parabola():
    at = np.arange(9)
    assert parabola_offset((at - 4.3) ** 2, 4) == pytest.approx(0.3)
    assert parabola_offset((at - 4.3) ** 2, 0) == 0
    assert parabola_offset(0.0 * at, 4) == 0


def off_labels(presses):
    """Found centers minus those of the labels (N, 2), px."""
    found = [find_contact(change_of(press.image, presses.background)) for press in presses.presses]
    return np.array([(c.x_px, c.y_px) for c in found]) - [press.label[:2] for press in presses.presses]


def test_low_resolution_real_presses(data):
    """Human labels of another sensor at 120x160: the median distance stays under 2 px."""
    how = {"mm_per_px": 0.1, "ball_diameter_mm": 4}
    distance = np.hypot(*off_labels(gelform.read_presses(data / "taxim-ball-lowres", **how)).T)
    assert np.median(distance) < 1.8  # recorded: 1.76
    assert distance.max() < 5  # no gross failure among 49


@pytest.mark.slow
def test_very_deep_real_presses(data):
    offset = off_labels(gelform.read_presses(data / "gelsight-ball-deep"))
    scatter = np.hypot(*(offset - np.median(offset, axis=0)).T)
    assert np.median(scatter) < 3.03  # recorded: 3.00, about what the labels themselves scatter
    assert scatter.max() < 10


SMALL = (60, 80)


def press_of(usable=None, ball_radius_px=40.0, ratio=1.0):
    """A press whose gel follows the ball up to the visible rim, before a background of 90."""
    change, circle = np.zeros((*SMALL, 3), np.float32), ContactCircle(40.0, 30.0, 20.0, 1.0, 9.0)
    return PreparedPress("one", change, change[..., 0], ball_radius_px, circle, usable, change + 90, ratio)


def within(contact, radius_px):
    y, x = np.mgrid[: SMALL[0], : SMALL[1]]
    return np.hypot(x - contact.x_px, y - contact.y_px) < radius_px


@pytest.mark.parametrize(
    "center", [(40.0, 30.0), (40.3, 29.6), (2.0, 30.0), (78.0, 58.5), (0.0, 0.0), (40.0, 59.0)]
)
@pytest.mark.parametrize("marked", [False, True])
def test_every_usable_pixel_of_the_zone_is_taken_up_to_the_border(center, marked):
    usable = np.random.default_rng(0).uniform(size=SMALL) > 0.3 if marked else None
    contact = ContactCircle(*center, 15.0, 1.0, 9.0)
    taken = np.zeros(SMALL, dtype=bool)
    taken[press_of(usable).pixels(contact, 0.8)] = True
    np.testing.assert_array_equal(taken, within(contact, 12.0) & (True if usable is None else usable))


def test_a_count_thins_the_pixels_evenly_and_the_steepest_rim_of_a_ball_is_left_out():
    contact = ContactCircle(40.0, 30.0, 25.0, 1.0, 9.0)
    rows, cols = press_of().pixels(contact, 1.0, 300)
    assert 250 < len(rows) < 400
    assert np.mean(cols < 40) == pytest.approx(0.5, abs=0.05)
    assert np.mean(rows < 30) == pytest.approx(0.5, abs=0.05)
    rows, cols = press_of(ball_radius_px=12.0).pixels(contact, 1.0)
    assert np.hypot(cols - 40, rows - 30).max() < 12.0


def test_presses_share_the_samples_and_rest_gives_half_as_many():
    """All carry the untouched image; at rest slopes are 0, in a contact they are the ball's."""
    contacts = [ContactCircle(20.0, 30.0, 15.0, 1.0, 9.0), ContactCircle(55.0, 30.0, 20.0, 1.0, 9.0)]
    presses = [press_of(np.arange(80)[None, :].repeat(60, axis=0) != 70), press_of()]
    samples = contact_samples(presses, contacts, 1.0, total=800)
    assert 700 < len(samples.x_px) < 900
    first = within(contacts[0], 15.0)[samples.y_px, samples.x_px]
    assert 0.35 < first.mean() < 0.65
    rested = with_rest_samples(samples, presses, contacts)
    assert samples.background is rested.background is presses[0].background
    count = len(samples.x_px)
    assert 0.1 * count < len(rested.x_px) - count <= 0.5 * count
    assert (rested.weight[:count] == 1).all()
    assert (rested.weight[count:] < 1).all()
    assert not rested.gradients[count:].any()
    x, y = rested.x_px[count:], rested.y_px[count:]
    distance = [np.hypot(x - c.x_px, y - c.y_px) / c.radius_px for c in contacts]
    assert np.maximum(*distance).min() > 2


def test_depths_come_with_the_pixels_that_they_belong_to():
    depth = np.arange(SMALL[0] * SMALL[1], dtype=np.float32).reshape(SMALL)
    contacts = [ContactCircle(20.0, 30.0, 10.0, 1.0, 9.0), ContactCircle(55.0, 30.0, 10.0, 1.0, 9.0)]
    presses = [replace(press_of(), depth_px=one) for one in (depth, -depth)]
    inside, samples = contact_samples(presses, contacts), training_samples(presses, contacts)
    assert len(samples.depth_px) == len(samples.x_px) > len(inside.x_px)
    at = samples.y_px.astype(int), samples.x_px.astype(int)
    np.testing.assert_array_equal(np.abs(samples.depth_px), depth[at])
    own = within(contacts[1], 10.0)[at]  # of the second press, but for what both leave untouched
    assert (samples.depth_px[: len(inside.x_px)] < 0).tolist() == own[: len(inside.x_px)].tolist()
    assert training_samples([press_of()], contacts).depth_px is None


@pytest.mark.parametrize("ratio", [0.5, 0.85, 1.0])
def test_nothing_trains_beyond_the_edge_of_the_contact(ratio):
    """Of a press too deep for its visible circle, the edge is that share of what the gel certainly follows."""
    press = press_of(ratio=ratio)
    contact = press.found
    assert press.contact_radius(contact) == ratio * 20
    samples = contact_samples([press], [contact], total=10**6)
    u, v = samples.x_px - 40, samples.y_px - 30
    assert 0.95 * ratio * 20 - 1 < np.hypot(u, v).max() < 0.95 * ratio * 20
    slopes = -np.stack([u, v], 1) / np.sqrt(1600 - u**2 - v**2)[:, None]
    np.testing.assert_allclose(samples.gradients, slopes, rtol=1e-6)
    deep = replace(press, ball_radius_px=15.0)
    assert deep.contact_radius(contact) == ratio * followed_radius(20.0, 15.0) < ratio * 15


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
    return PreparedPress(name, change, magnitude(change), 30.0, find_contact(change))


@pytest.fixture(scope="module")
def even():
    rng = np.random.default_rng(4)
    return [even_press(f"{k}.png", *center, rng) for k, center in enumerate(CIRCLES)]


def test_a_press_that_is_brighter_all_around_is_found(even):
    for press, (x, y) in zip(with_contacts(even), CIRCLES):
        contact = press.found
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
    (last,) = with_contacts([nothing])
    assert why_no_contact(last.found) is not None


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
    monkeypatch.setattr(module, "COMMON", 0.0)
    assert not places()[3], "without the noise of the place, the light press is taken for the disc"


def test_a_stage_s_center_stays_and_templates_give_its_radius(even):
    """About the center alone, another press's edge would be taken for the rim."""
    x, y = CIRCLES[0]
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]]
    ring = (np.hypot(cols - x, rows - y) < 45)[..., None] * np.float32([0.0, 0.35, 0.0])
    first = even[0].color_change + ring.astype(np.float32)
    size = magnitude(about_median(first))
    staged = replace(even[0], color_change=first, size=size, mark=(x + 1, y - 1, None))
    contact = with_contacts([staged, *even[1:]])[0].found
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
    presses = gelform.read_presses(data / "homemade-even" / "a")
    presses = presses.subset(range(0, len(presses.presses), 2))  # of 798x750 px
    bare = tuple(replace(press, label=None) for press in presses.presses)
    for labeled, press in zip(presses.presses, prepare(replace(presses, presses=bare))):
        x, y, radius = labeled.label
        assert np.hypot(press.found.x_px - x, press.found.y_px - y) < 0.2 * radius  # the circles are by eye


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
    one, _ = prepare(few, progress=lambda *call: calls.append(call[:2]))
    assert calls == [(1, 2), (2, 2)] * 2
    assert one.ball_radius_px == few.presses[0].ball_diameter_mm / 2 / few.mm_per_px
    np.testing.assert_array_equal(one.color_change, change)
    np.testing.assert_allclose(
        one.size, np.linalg.norm(change - np.median(change, (0, 1)), axis=-1), atol=1e-6
    )
    assert clear is None, "a gel without markers has no pixel to leave out"
    assert settings.blur_px == pytest.approx(1.25 * few.image_shape[0] / 240)
    taller = replace(few, background=np.repeat(np.repeat(few.background, 2, 0), 2, 1))
    assert change_settings(taller).blur_px == pytest.approx(2 * settings.blur_px)


def test_another_offset_has_the_edge_of_the_contacts(few):
    """It is measured once, in what circles are found in."""
    usual = [replace(press, contact_radius_ratio=0.7) for press in prepare(few)]
    assert prepared_with(few, usual, USUAL_OFFSET) is usual
    found = prepared_with(few, usual, 0.0)
    assert [(one.name, one.contact_radius_ratio) for one in found] == [(one.name, 0.7) for one in usual]
    assert not np.array_equal(found[0].color_change, usual[0].color_change)


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


def test_presses_of_another_sensor_are_named_and_one_of_another_light_is_rejected(presses, few):
    """The one had ended the calibration of all others."""
    turned = replace(few.presses[1], image=np.ascontiguousarray(few.presses[1].image[::-1, ::-1]))
    with pytest.raises(gelform.CalibrationError, match=f"1 of 2 presses do not fit .* {few.presses[1].name}"):
        prepare(replace(few, presses=(few.presses[0], turned)))
    dark = replace(presses.presses[1], image=(presses.presses[1].image * 0.4).astype(np.uint8))
    located = locate(replace(presses, presses=(presses.presses[0], dark, *presses.presses[2:6])))
    assert [one.refused is None for one in located.prepared] == [True, False, True, True, True, True]
    assert "times as bright as in the background" in located.refined.reasons[1]
    assert located.refined.accepted == [0, 2, 3, 4, 5]


def marked(sensor, pitch_mm):
    """The sensor with dots at that pitch; 0: none."""
    return replace(sensor, coating=replace(sensor.coating, marker_pitch_mm=pitch_mm, marker_radius_mm=0.25))


@pytest.fixture(scope="module")
def dotted(sensor):
    """Presses of a gel with markers, as simulated and as read."""
    bulging = replace(marked(sensor, 2.2), gel=replace(sensor.gel, bulge=0.5))  # it moves the dots
    how = {"ball_diameters_mm": [5.0], "count": 20, "rng": np.random.default_rng(3), "oversample": 1}
    made = simulate_ball_presses(bulging, **how)
    return made, presses_from_simulated(made)


def test_dots_that_were_dragged_are_left_out_where_they_are_and_where_they_were(sensor):
    images = []
    for pitch_mm in (0.0, 2.2):
        gel = replace(marked(sensor, pitch_mm), noise_sd=0, noise_gain=0)
        poses = [Pose(0.8, (-3 + 0.25 * k, 0.0)) for k in range(8)]
        *_, last = simulate_sequence(gel, Ball(4), poses, rng=None)
        images.append((simulate_background(gel, None).astype(np.float32), last))
    (clean_rest, clean), (rest, press) = images
    assert np.abs(press.markers_shift_mm).max() > 0.3  # more than a dot's radius
    settings = ChangeSettings("divide", 10, 0.7)
    change, usable = ColorChanges(rest, settings)(press.image)
    wanted = color_change_from_image(clean.image, clean_rest, settings)
    raw = color_change_from_image(press.image, rest, settings)
    spoilt = np.abs(raw - wanted).mean(axis=-1)
    assert np.count_nonzero(spoilt > 0.2) > 50
    assert np.mean(usable[spoilt > 0.2]) < 0.1
    assert np.mean(usable) > 0.75
    errors = np.abs(change - wanted).mean(axis=-1)
    assert errors[usable].max() < 0.6 * spoilt[usable].max()
    assert np.percentile(errors[usable], 99) < 0.7 * np.percentile(spoilt[usable], 99)
    assert np.mean(MarkerFinder(rest).mask(press.image)[spoilt > 0.2]) > 0.9  # the fast way sees them too


@pytest.mark.parametrize("blur_px", [0.0, 0.7, 2.0])
def test_only_dots_are_left_out_and_a_blur_carries_nothing_of_them(blur_px):
    background = image_of_dots(grid(), noise=1.0)
    press = image_of_dots(np.add(grid(), [1.5, 0.5]), noise=3.0, seed=1)
    settings, finder = ChangeSettings("divide", 10, blur_px), MarkerFinder(background)
    change, usable = ColorChanges(background, settings)(press)
    np.testing.assert_array_equal(~usable, finder.untouched.mask | finder(press).mask)
    rest = PreparedBackground(background, settings)
    plain = rest.change(press, rest.compare(press)[0])
    far = cv2.erode(usable.view(np.uint8), np.ones((11, 11), np.uint8)) > 0
    assert np.count_nonzero(far) > 50
    np.testing.assert_allclose(change[far], plain[far], atol=2e-3)
    assert np.sqrt(np.mean(change[usable] ** 2)) < 0.045, "but the noise of 3 levels in 130, nothing changed"
    if blur_px > 1:
        assert np.sqrt(np.mean(plain[usable] ** 2)) > 0.06


def test_samples_leave_the_dots_out(dotted):
    made, presses = dotted
    for true, press in zip(made.presses, prepare(presses)):
        contact = ContactCircle(*true.center_px, true.contact_radius_px, 1.0, 9.0)
        rows, cols = press.pixels(contact, 0.8)
        assert len(rows) > 30
        assert np.mean(true.albedo[rows, cols] < 0.9) < 0.02  # a few pixels of the rims
        assert (true.albedo < 0.5).any()


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
    unseen, errors = presses.subset(range(1, 20, 2)), []
    for true, press in zip(made.presses[1::2], prepare(unseen)):
        at = np.nonzero(true.contact & (True if press.usable is None else press.usable))
        found = press.gradients(calibration.color_model, *at)
        errors.append(np.linalg.norm(found - true.gradients[at], axis=1))
    assert np.median(np.concatenate(errors)) < 1.5 * 0.038
    circles = np.array([row["circle_px"] for row in gelform.evaluate(calibration, unseen).rows])
    true = np.array([press.center_px for press in made.presses[1::2]])
    assert np.median(np.linalg.norm(circles[:, :2] - true, axis=1)) < 1.5


def test_kept_circles_rest_on_all_code_that_finds_them(monkeypatch):
    code = module._digest_of_code()
    assert code == module._digest_of_code()
    monkeypatch.setattr(
        Path, "read_bytes", lambda path, read=Path.read_bytes: read(path) + b"#" * (path.name == "filters.py")
    )
    assert code != module._digest_of_code()


def test_a_next_try_takes_the_circles_that_an_interrupted_one_found(presses, monkeypatch, tmp_path):
    """The same to the bit; of another image, or of a damaged file, they are found anew."""
    few, find, count = presses.subset(range(4)), module.find_contact, [0]
    alone = [press.found for press in prepare(few)]

    def interrupted(change):
        count[0] += 1
        if count[0] == 3:
            raise KeyboardInterrupt
        return find(change)

    monkeypatch.setattr(module, "find_contact", interrupted)
    with module.circles_kept(tmp_path), pytest.raises(KeyboardInterrupt):
        prepare(few)
    kept = sorted(tmp_path.iterdir())
    assert (len(kept), count[0]) == (2, 3)
    kept[0].write_bytes(b'{"x_px": 1}')
    with module.circles_kept(tmp_path):
        assert [press.found for press in prepare(few)] == alone
        assert count[0] == 6, "the damaged one and two more"
        prepare(few)
        brighter = replace(few.presses[0], image=np.minimum(few.presses[0].image, 250) + 1)
        prepare(replace(few, presses=(brighter, *few.presses[1:])))
        assert count[0] == 7
    monkeypatch.setattr(module, "_digest_of_code", lambda: b"other code")
    with module.circles_kept(tmp_path):
        prepare(few)
        assert count[0] == 11, "other code may find another circle"
        os.utime(kept[0], (0, 0))
    with module.circles_kept(tmp_path):
        assert not kept[0].exists(), "old"
    prepare(few)
    assert count[0] == 15, "nothing is kept unasked"
